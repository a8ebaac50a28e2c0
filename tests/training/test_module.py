from copy import deepcopy
from dataclasses import replace

import lightning as L
import pytest
import torch
from lightning.pytorch.plugins.precision import MixedPrecision

from mobilestereonet.data.sample import StereoSample
from mobilestereonet.errors import InputError
from mobilestereonet.inference import StereoMatcher
from mobilestereonet.training.module import StereoModule
from mobilestereonet.training.objective import volume_loss_sum
from mobilestereonet.training.pool import TrainingBatch
from mobilestereonet.training.recipe import Recipe, override
from short_run import fit

RECIPE = Recipe(
    model="table3a-v1-v1",
    net={"max_disparity": 32},
    steps=10,
    full_heads=2,
    cross_entropy=1.0,
    clip=1.0,
)


def _batch(seed: int) -> StereoSample:
    generator = torch.Generator().manual_seed(seed)
    left, right = torch.rand(2, 1, 3, 32, 48, generator=generator)
    disparity = torch.rand(1, 32, 48, generator=generator) * 20 + 1
    return StereoSample(left, right, disparity, disparity > 0, name=str(seed))


def _without_truth(batch: StereoSample) -> StereoSample:
    return replace(batch, valid=torch.zeros_like(batch.valid))


def _out_of_range(batch: StereoSample) -> StereoSample:
    return replace(batch, disparity=batch.disparity + 32)


def _with_nan(batch: StereoSample) -> StereoSample:
    left = batch.left.clone()
    left[0, 0, 5, 5] = torch.nan
    return replace(batch, left=left)


class Recorder(L.Callback):
    """Weights, buffers and optimizer after every step."""

    def __init__(self) -> None:
        self.states: list[tuple[dict, dict]] = []

    def on_train_batch_end(self, trainer, pl_module, *_) -> None:
        optimizer = deepcopy(trainer.optimizers[0].state_dict()["state"])
        self.states.append((deepcopy(pl_module.net.state_dict()), optimizer))


def _fit(batches, recipe=RECIPE, **options) -> tuple[StereoModule, Recorder]:
    recorder = Recorder()
    return fit([TrainingBatch(pair) for pair in batches], recipe, [recorder], **options), recorder


def _same(a: dict, b: dict) -> bool:
    if a.keys() != b.keys():
        return False
    return all(
        _same(a[key], b[key]) if isinstance(a[key], dict) else torch.equal(a[key], b[key])
        for key in a
    )


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("target", ["planes", "disparity", "surfaces"])
@pytest.mark.parametrize("full_heads", [1, None])
def test_every_target_of_the_cross_entropy_trains_all_heads(target, full_heads):
    recipe = replace(RECIPE, cross_entropy_target=target, full_heads=full_heads)
    module, recorder = _fit([_batch(1), _batch(2)], recipe)
    first, second = (state for state, _ in recorder.states)
    assert int(module.skipped) == 0
    for name, _ in module.net.named_parameters():
        assert not torch.equal(first[name], second[name]), name


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("spoil", [_without_truth, _out_of_range, _with_nan])
def test_a_bad_batch_changes_nothing_and_is_counted(spoil):
    module, recorder = _fit([_batch(1), spoil(_batch(2)), spoil(_batch(3)), _batch(4)])
    first, second, third, last = recorder.states
    assert int(module.skipped) == 2
    for before, after in ((first, second), (second, third)):
        assert _same(before[0], after[0]) and _same(before[1], after[1])
    assert not _same(third[0], last[0]) and not _same(third[1], last[1])
    assert all(value.isfinite().all() for value in last[0].values())


@pytest.mark.filterwarnings("ignore")
def test_a_bad_first_batch():
    fresh = deepcopy(StereoModule(RECIPE, 10, 8).net.state_dict())
    _, recorder = _fit([_with_nan(_batch(1)), _batch(2)])
    assert _same(recorder.states[0][0], fresh) and recorder.states[0][1] == {}
    assert not _same(recorder.states[1][0], fresh)


@pytest.mark.filterwarnings("ignore")
def test_steps_that_the_gradient_scaler_skips():
    """In half precision the scale starts too high: infinite gradients are no fault of the data."""
    scaler = torch.amp.GradScaler("cpu", init_scale=2.0**120, growth_interval=1)
    precision = MixedPrecision("16-mixed", "cpu", scaler)
    module, recorder = _fit([_batch(i) for i in range(3)], plugins=[precision])
    assert int(module.skipped) == 3 and scaler.get_scale() == 2.0**117
    fresh = StereoModule(RECIPE, 10, 8).net.state_dict()
    assert _same(recorder.states[-1][0], fresh)
    scaler = torch.amp.GradScaler("cpu", init_scale=2.0**4, growth_interval=1)
    precision = MixedPrecision("16-mixed", "cpu", scaler)
    module, recorder = _fit([_batch(0), _with_nan(_batch(1)), _batch(2)], plugins=[precision])
    assert int(module.skipped) == 1 and scaler.get_scale() == 2.0**5
    states = recorder.states
    assert not _same(states[0][0], fresh) and not _same(states[1][0], states[2][0])
    assert _same(states[0][0], states[1][0]) and _same(states[0][1], states[1][1])


@pytest.mark.filterwarnings("ignore")
def test_the_gradient_is_clipped():
    norms = []

    class Norm(L.Callback):
        def on_before_zero_grad(self, trainer, pl_module, optimizer) -> None:
            grads = [p.grad for p in pl_module.net.parameters() if p.grad is not None]
            if grads:
                norms.append(float(torch.nn.utils.get_total_norm(grads)))

    for clip in (None, 0.5):
        norms.clear()
        fit([TrainingBatch(_batch(i)) for i in (1, 2)], replace(RECIPE, clip=clip), [Norm()])
        assert len(norms) == 1  # of the first batch, before the second one's backward pass
        assert norms[0] == pytest.approx(0.5, rel=1e-3) if clip else norms[0] > 5


def test_learning_rate_grows_with_the_global_batch():
    recipe = replace(RECIPE, lr=1e-3, lr_batch=8, schedule=((0.0, 0.5), (1.0, 1.0)))
    for global_batch, lr in ((8, 1e-3), (32, 4e-3), (1, 1.25e-4)):
        made = StereoModule(recipe, 10, global_batch).configure_optimizers()
        optimizer, schedule = made["optimizer"], made["lr_scheduler"]["scheduler"]
        assert optimizer.param_groups[0]["lr"] == pytest.approx(lr / 2)
        for _ in range(5):
            optimizer.step()
            schedule.step()
        assert optimizer.param_groups[0]["lr"] == pytest.approx(lr * 0.75)
        assert made["lr_scheduler"]["interval"] == "step"


def test_same_seed_same_fresh_weights():
    modules = [StereoModule(replace(RECIPE, seed=seed), 10, 8) for seed in (1, 1, 2)]
    weights = [module.net.state_dict() for module in modules]
    assert _same(weights[0], weights[1]) and not _same(weights[0], weights[2])


def test_views_of_any_size():
    module = StereoModule(RECIPE, 10, 8).eval()
    left, right = torch.rand(2, 1, 3, 50, 75)
    with torch.no_grad():
        ours = module(left, right)
    theirs = StereoMatcher(module.net).disparity(left, right)
    assert ours.shape == (1, 50, 75)
    assert torch.allclose(ours, theirs, atol=1e-3)


@pytest.mark.filterwarnings("ignore")
def test_one_step_in_four_is_without_guidance():
    guided = []

    class Guided(L.Callback):
        def on_before_optimizer_step(self, trainer, pl_module, optimizer) -> None:
            guided.append(bool(pl_module.net.guide.weight.grad.any()))

    recipe = override(RECIPE, {"model": "table3b-v1-v2", "net.coarse_pass": True})
    generator = torch.Generator().manual_seed(0)
    left, right = torch.rand(2, 1, 3, 32, 64, generator=generator)
    truth = torch.full((1, 32, 64), 9.0)
    pair = StereoSample(left, right, truth, truth > 0, name="pair")
    module = fit([TrainingBatch(pair)] * 6, recipe, [Guided()])
    assert guided == [False, True, True, True, False, True]
    assert module.net.guide.weight.any()


@pytest.mark.filterwarnings("ignore")
def test_values_of_the_config_and_one_set_of_weights():
    """What trains is another form of the network, of which neither state nor checkpoint knows."""
    seen = []

    class Look(L.Callback):
        def on_train_batch_end(self, trainer, pl_module, *_) -> None:
            fast = dict(pl_module.accelerated.named_parameters())
            own = dict(pl_module.net.named_parameters())
            assert fast.keys() == own.keys()
            assert all(fast[name] is own[name] for name in own)
            seen.append({key.split(".")[0] for key in pl_module.state_dict()})

    recipe = override(RECIPE, {"net.cost_volume": "correlation", "net.hourglasses": 2})
    module, fresh = fit([TrainingBatch(_batch(1))], recipe, [Look()]), StereoModule(recipe, 10, 8)
    assert seen == [{"net", "skipped"}] and not [*module.net.volume.parameters()]
    assert len(module.net.heads) == 3
    pairs = zip(module.net.parameters(), fresh.net.parameters(), strict=True)
    assert any(not after.equal(before) for after, before in pairs)
    with pytest.raises(IndexError):
        module.accelerated  # noqa: B018


def test_data_without_ground_truth():
    batch = replace(_batch(1), disparity=None, valid=None)
    with pytest.raises(InputError, match="1 has no ground truth"):
        _fit([batch])


@pytest.mark.filterwarnings("ignore")
def test_volume_loss_by_hand():
    """Plane k of a volume compares columns at disparity 4 k."""
    volume = torch.tensor([0.5, 2.0, 1.0]).view(1, 1, 3, 1, 1)
    mask = torch.ones(1, 4, 4, dtype=torch.bool)
    log_p = torch.log_softmax(4 * volume.flatten(), dim=0)
    for disparity, expected in ((4.0, log_p[1]), (6.0, (log_p[1] + log_p[2]) / 2)):
        loss = volume_loss_sum(volume, torch.full((1, 4, 4), disparity), mask)
        assert loss.item() == pytest.approx(-16 * expected.item(), rel=1e-5)


def test_frozen_parts_stay_as_they_are():
    _, recorder = _fit([_batch(0), _batch(1)], replace(RECIPE, frozen=("features",)))
    before = StereoModule(RECIPE, 2, 1).net.state_dict()
    after = recorder.states[-1][0]
    changed = {name for name, value in after.items() if not value.equal(before[name])}
    assert not any(name.startswith("features.") for name in changed)
    assert {"heads.1.score.weight", "hourglasses.0.up6.1.running_mean"} <= changed
    recipe = replace(RECIPE, frozen_norms=True)
    after = _fit([_batch(0), _batch(1)], recipe)[1].states[-1][0]
    changed = {name for name, value in after.items() if not value.equal(before[name])}
    assert not any("running" in name for name in changed)
    assert {"heads.1.score.weight", "hourglasses.0.up6.1.weight"} <= changed
    with pytest.raises(InputError, match=r"frozen names 'heads\.9', which table3a-v1-v1 does not"):
        _fit([_batch(0)], replace(RECIPE, frozen=("heads.9",)))
