from dataclasses import replace

import lightning as L
import numpy as np
import pytest
import torch
from torch.utils.data import Dataset

from mobilestereonet import InputError, create_model
from mobilestereonet.data.augment import AugmentConfig
from mobilestereonet.data.files import write_png
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.nets import IMAGENET
from mobilestereonet.nets.coarse_pass import spread_band
from mobilestereonet.nets.volume_model import Band, VolumeOutputs
from mobilestereonet.scenes import ProceduralScenes, SceneConfig
from mobilestereonet.training.batches import Request, TrainingPairs
from mobilestereonet.training.losses import distillation_sum
from mobilestereonet.training.module import StereoModule
from mobilestereonet.training.objective import Objective
from mobilestereonet.training.pool import PairPool, TrainingBatch
from mobilestereonet.training.recipe import Recipe
from mobilestereonet.training.run import train
from mobilestereonet.training.teacher import Teacher
from short_run import fit, save_teacher

RECIPE = Recipe(
    model="table3a-v1-v1",
    net={"max_disparity": 32},
    steps=3,
    full_heads=1,
    cross_entropy=5.0,
    clip=1.0,
)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("teacher") / "teacher.safetensors"
    save_teacher(path, RECIPE.model)
    return path


def pair(seed=0, height=32, width=48):
    left, right = torch.rand(2, 1, 3, height, width, generator=torch.Generator().manual_seed(seed))
    return StereoSample(left, right, name="pair")


class Losses(L.Callback):
    def __init__(self):
        self.values = []

    def on_train_batch_end(self, trainer, pl_module, outputs, *_):
        self.values.append(float(outputs["loss"]))


def step(recipe, batch):
    """The module after one step, and its loss."""
    losses = Losses()
    return fit([batch], recipe, [losses]), losses.values[0]


def test_what_it_says_is_what_its_network_says(weights):
    views = pair()
    teacher = Teacher(str(weights), create_model(RECIPE.model, max_disparity=32))
    scores, disparity, confidence = teacher(views)
    with torch.no_grad():
        expected = teacher.net(IMAGENET(views.left), IMAGENET(views.right)).disparity
    assert scores.shape == (1, 8, 8, 12)
    assert (disparity - expected).abs().mean() < 0.3  # bfloat16 where the processor has it
    assert 0 <= confidence.min() < confidence.max() <= 1
    assert not scores.is_inference()


def test_another_range_of_disparities_is_refused(weights):
    with pytest.raises(InputError, match="searches 32 disparities, the network in training 192"):
        Teacher(str(weights), create_model("msnet2d"))


def test_what_is_no_weights_is_named():
    with pytest.raises(FileNotFoundError, match=r"teacher no\.pth: no such file"):
        Teacher("no.pth", create_model("msnet2d"))
    with pytest.raises(InputError, match="unknown model 'msnet2D': did you mean msnet2d"):
        Teacher("msnet2D", create_model("msnet2d"))
    with pytest.raises(InputError, match=r"a teacher needs cross_entropy > 0, .* got 0\.0"):
        Recipe(steps=1, teacher="msnet2d")


@pytest.mark.filterwarnings("ignore")
def test_a_pair_without_ground_truth_teaches(weights):
    batch = TrainingBatch(pair(0), pair(1))
    module, loss = step(replace(RECIPE, teacher=str(weights)), batch)
    assert module.skipped == 0
    assert loss > 0.1
    fresh = StereoModule(RECIPE, 10, 8).net
    moved = zip(module.net.parameters(), fresh.parameters(), strict=True)
    assert all(not parameter.equal(before) for parameter, before in moved if parameter.ndim > 1)
    assert not [key for key in module.state_dict() if "teacher" in key]
    with pytest.raises(InputError, match="pair has no ground truth"):
        step(RECIPE, batch)


@pytest.mark.filterwarnings("ignore")
def test_beside_the_ground_truth_both_count(weights):
    disparity = torch.full((1, 32, 48), 9.0)
    labelled = TrainingBatch(replace(pair(0), disparity=disparity, valid=disparity > 0), pair(1))
    truth = step(RECIPE, labelled)[1]
    teacher = step(replace(RECIPE, teacher=str(weights)), TrainingBatch(pair(0), pair(1)))[1]
    both = step(replace(RECIPE, teacher=str(weights), distil=0.5), labelled)[1]
    assert both == pytest.approx(truth + 0.5 * teacher, rel=1e-4)


def test_loss_of_an_equal_is_zero_and_far_disparities_count_by_distribution_only():
    torch.manual_seed(0)
    scores, weight = torch.randn(1, 8, 4, 6), torch.rand(1, 16, 24)
    disparity = torch.rand(1, 16, 24) * 30

    def loss(student, student_disparity):
        return float(
            distillation_sum(
                [student], [1.0], student_disparity, scores, disparity, weight, cross_entropy=2.0
            )
        )

    assert loss(scores, disparity) == pytest.approx(0, abs=1e-4)
    assert loss(scores, disparity + 1) == pytest.approx(0.5 * weight.sum().item(), rel=1e-4)
    assert loss(scores, disparity + 9) == pytest.approx(0, abs=1e-4)
    other = torch.randn_like(scores)
    target, found = scores.softmax(1), other.log_softmax(1)
    divergence = (target * (target.log() - found)).sum(1)
    expected = 2 * 16 * (divergence * weight[:, 2::4, 2::4]).sum()
    assert loss(other, disparity) == pytest.approx(float(expected), rel=1e-4)


def test_of_a_cascade_only_what_was_searched_learns():
    net = create_model("msnet3d-cascade", max_disparity=128)
    scores = torch.randn(1, 16, 8, 12, requires_grad=True)
    start = torch.zeros(1, 8, 12, dtype=torch.int64)
    spread = spread_band(scores, start, 32)
    outputs = VolumeOutputs([spread], None, net.regression, Band(start, 16))
    disparity = torch.full((1, 32, 48), 20.0)
    disparity[:, :, 24:] = 100
    objective = Objective(replace(RECIPE, model="msnet3d-cascade"), net)
    teacher = torch.zeros(1, 32, 8, 12)
    teacher[:, 31] = 5  # what it sees outside of the band teaches nothing
    part = objective.taught(net, outputs, teacher, disparity, disparity / 100)
    part.total.backward()
    assert scores.grad[..., :6].abs().amin() > 0
    assert not scores.grad[..., 7:].any()  # upsampling reaches one pixel further


class Numbers(Dataset):
    def __len__(self):
        return 3

    def __getitem__(self, index):
        image = torch.rand(3, 40, 60, generator=torch.Generator().manual_seed(index))
        return StereoSample(image, image.flip(0), name=str(index))


@pytest.mark.parametrize("kind", ["files", "procedural"])
def test_clean_views_have_the_same_geometry(kind):
    source = Numbers()
    if kind == "procedural":
        source = ProceduralScenes(SceneConfig(height=40, width=60, length=3, noise_textures=2))
    crop = AugmentConfig(
        height=32, width=48, scale=(-0.1, 0.3), stretch=0.2, vertical_shift=2.0, rotation=3.0
    )
    pairs = TrainingPairs(source, 3)[Request([1, 2], [1, 2], [1, 2], 0)]
    plain = PairPool(crop, 3).batch(pairs).augmented
    changed = replace(crop, noise=0.2, exposure=(0.2, 0.3))
    batch = PairPool(changed, 3, clean=True).batch(pairs)
    assert batch.clean.left.equal(plain.left) and batch.clean.right.equal(plain.right)
    assert batch.clean.name == batch.augmented.name
    assert (batch.augmented.left - plain.left).abs().mean() > 0.02


@pytest.mark.filterwarnings("ignore")
def test_a_run_on_files_without_ground_truth(weights, tmp_path):
    for view in ("left", "right"):
        for index in range(2):
            image = np.random.default_rng(index).integers(0, 255, (48, 80, 3), np.uint8)
            (tmp_path / view).mkdir(exist_ok=True)
            write_png(tmp_path / view / f"{index}.png", image)
    recipe = replace(
        RECIPE,
        data="folder",
        root=str(tmp_path),
        teacher=str(weights),
        batch_size=2,
        val_scenes=1,
        scenes=SceneConfig(height=48, width=80, noise_textures=2, max_disparity=31.0),
        augment=AugmentConfig(height=32, width=64, noise=0.02),
    )
    module = train(recipe, tmp_path / "run", accelerator="cpu", progress=False)
    assert module.skipped == 0
    assert (tmp_path / "run" / "weights.safetensors").is_file()
    with pytest.raises(InputError, match="ground truth"):
        train(
            replace(recipe, teacher=None),
            tmp_path / "other",
            accelerator="cpu",
            progress=False,
        )
