"""Scanners, on small trees in the official layouts that the tests make."""

import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from scanner_trees import (
    LEFT,
    RIGHT,
    H,
    W,
    check_disparity,
    check_views,
    flat,
    put_image,
    put_pfm,
    put_text,
)
from torch.utils.data import DataLoader

from mobilestereonet.data import (
    PairFolder,
    collate,
    data_sets,
    occlusion_from_right_view,
    open_data_set,
    register_data_set,
)
from mobilestereonet.data.scanners import registry
from mobilestereonet.data.scanners.kitti import KITTI2015
from mobilestereonet.data.scanners.sceneflow import SceneFlow
from mobilestereonet.errors import InputError

pytestmark = pytest.mark.filterwarnings("ignore:.*expected .* frames:UserWarning")


def put_sceneflow(root, subset, inner, level=None):
    """One frame of a subset; its disparity tells it apart."""
    for view, colour in (("left", LEFT), ("right", RIGHT)):
        folder, number = inner.rsplit("/", 1)
        base = root / subset
        image = np.dstack([flat(colour, np.uint8)] * 3 + [flat(255, np.uint8)])
        png = base / "frames_finalpass" / folder / view / f"{number}.png"
        png.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(png), image)
        put_pfm(base / "disparity" / folder / view / f"{number}.pfm", flat(level))


@pytest.mark.parametrize("in_root", [True, False])
def test_sceneflow_finds_every_subset(tmp_path, in_root):
    subsets = ("", "", "", "") if in_root else ("FlyingThings3D", "monkaa", "Driving", "Driving")
    inners = (
        "TRAIN/A/0000/0006",
        "a_rain_of_stones_x2/0000",
        "15mm_focallength/scene_forwards/fast/0001",
        "35mm_focallength/scene_backwards/slow/0002",
    )
    for level, (subset, inner) in enumerate(zip(subsets, inners, strict=True), start=1):
        put_sceneflow(tmp_path, subset, inner, level)
    put_sceneflow(tmp_path, subsets[0], "TEST/C/0149/0015", -7)

    train = open_data_set("sceneflow", tmp_path)
    found = {sample.name: sample for sample in (train[i] for i in range(len(train)))}
    assert set(found) == set(inners)
    for level, inner in enumerate(inners, start=1):
        check_views(found[inner])
        check_disparity(found[inner], level)
        assert found[inner].calibration.focal == (450 if "15mm" in inner else 1050)
        # A plane: exactly the pixels whose match lies left of the right view are hidden.
        torch.testing.assert_close(found[inner].occluded, (torch.arange(W) < level).expand(H, W))
    test = open_data_set("sceneflow", tmp_path, split="test")
    assert [frame.name for frame in test.frames] == ["TEST/C/0149/0015"]
    check_disparity(test[0], 7)  # the other release's sign

    driving = open_data_set("sceneflow", tmp_path, subset="Driving")
    assert [frame.name for frame in driving.frames] == list(inners[2:])


def test_what_a_mac_leaves_beside_the_files_is_not_a_view(tmp_path):
    put_sceneflow(tmp_path, "", "TEST/C/0149/0015", 7)
    for path in list(tmp_path.rglob("*.p*")):
        path.with_name(f"._{path.name}").write_bytes(b"\0\5\x16\7" + bytes(100))
    put_sceneflow(tmp_path, "", "TEST/C/.trash/0015", 7)
    for options in ({"split": "test"}, {"left": "frames_finalpass/**/left/*.png"}):
        name = "sceneflow" if "split" in options else "folder"
        right = options.get("left", "").replace("left", "right")
        found = open_data_set(name, tmp_path, **options, **({"right": right} if right else {}))
        assert [frame.left.parts[-5:] for frame in found.frames] == [
            ("TEST", "C", "0149", "left", "0015.png")
        ]


def test_sceneflow_options_and_counts(tmp_path):
    put_sceneflow(tmp_path, "Monkaa", "lonetree_x2/0000", 2)
    for options, count in (({}, 35454), ({"subset": "Monkaa"}, 8664)):
        with pytest.warns(UserWarning, match=f"expected {count} frames, found 1 in"):
            SceneFlow(tmp_path, **options)
    with pytest.raises(InputError, match="expected 8664 frames, found 1"):
        SceneFlow(tmp_path, subset="Monkaa", strict=True)
    assert sum(SceneFlow._counts["train"].values()) == SceneFlow.splits["train"] == 35454
    with pytest.raises(FileNotFoundError, match=r"\[Mm\]onkaa/frames_cleanpass/\*/left"):
        SceneFlow(tmp_path, render="cleanpass")
    with pytest.raises(FileNotFoundError, match=r"frames_finalpass_webp/.*\.webp"):
        SceneFlow(tmp_path, webp=True)
    for options in ({"render": "final"}, {"subset": "Sintel"}, {"split": "val"}):
        with pytest.raises(InputError, match=f"(?i)sceneflow.*{next(iter(options.values()))}"):
            SceneFlow(tmp_path, **options)
    with pytest.raises(InputError, match="only FlyingThings3D has a test split"):
        SceneFlow(tmp_path, split="test", subset="Monkaa")

    shutil.rmtree(tmp_path / "Monkaa" / "disparity" / "lonetree_x2" / "right")
    assert SceneFlow(tmp_path)[0].occluded is None


P_COLOUR = "7.2e+02 0 6.1e+02 {} 0 7.2e+02 1.7e+02 0 0 0 1 0"
KITTI_CALIBRATION = "".join(
    f"{{prefix}}{camera}: {P_COLOUR.format(value)}\n"
    for camera, value in enumerate((0, -396, 36, -324))
)


def put_kitti(root, number, year, level=10):
    """A frame with ground truth in columns 4 to 11, of which the first four are occluded."""
    views = ("colored_0", "colored_1") if year == 2012 else ("image_2", "image_3")
    suffix = "" if year == 2012 else "_0"
    name = f"{number:06d}_10.png"
    truth = flat(0, np.uint16)
    truth[:, 4:] = level * 256
    put_image(root / views[0] / name, LEFT)
    put_image(root / views[1] / name, RIGHT)
    put_image(root / views[0] / f"{number:06d}_11.png", 0)  # the second time step
    put_image(root / f"disp_occ{suffix}" / name, truth)
    visible = truth.copy()
    visible[:, :8] = 0
    put_image(root / f"disp_noc{suffix}" / name, visible)
    return name


def test_kitti2012(tmp_path):
    training = tmp_path / "training"
    put_kitti(training, 0, 2012)
    name = put_kitti(training, 193, 2012)
    put_text(training / "calib" / "000193.txt", KITTI_CALIBRATION.format(prefix="P"))
    with pytest.warns(UserWarning, match=r"kitti2012 \(training\): expected 194 frames, found 2"):
        data = open_data_set("kitti2012", tmp_path)
    sample = data[1]
    assert sample.name == "000193_10"
    check_views(sample)
    columns = torch.arange(W)
    check_disparity(sample, (columns >= 4) * 10)
    torch.testing.assert_close(sample.occluded, ((columns >= 4) & (columns < 8)).expand(H, W))
    assert sample.foreground is None
    assert sample.calibration.baseline == pytest.approx(0.5)  # (36 + 324) / 720
    assert data[0].calibration is None

    put_image(training / "image_0" / name, flat(RIGHT, np.uint8))
    put_image(training / "image_1" / name, flat(LEFT, np.uint8))
    grey = open_data_set("kitti2012", tmp_path, grey=True)
    assert len(grey) == 1
    torch.testing.assert_close(grey[0].left, torch.full((3, H, W), 0.4))
    assert grey[0].calibration.baseline == pytest.approx(0.55)  # 396 / 720

    for folder, level in (("colored_0", LEFT), ("colored_1", RIGHT)):
        put_image(tmp_path / "testing" / folder / "000000_10.png", level)
    testing = open_data_set("kitti2012", tmp_path, split="testing")[0]
    check_views(testing)
    assert testing.disparity is testing.valid is testing.occluded is None


def test_kitti2015_masks_and_testing(tmp_path):
    name = put_kitti(tmp_path / "training", 46, 2015, level=20)
    objects = flat(0, np.uint8)
    objects[1, 5:7] = 3
    put_image(tmp_path / "training" / "obj_map" / name, objects)
    put_text(
        tmp_path / "training" / "calib_cam_to_cam" / "000046.txt",
        KITTI_CALIBRATION.format(prefix="P_rect_0"),
    )
    sample = KITTI2015(tmp_path)[0]
    columns = torch.arange(W)
    check_views(sample)
    check_disparity(sample, (columns >= 4) * 20)
    torch.testing.assert_close(sample.occluded, ((columns >= 4) & (columns < 8)).expand(H, W))
    assert sample.foreground.nonzero().tolist() == [[1, 5], [1, 6]]
    assert sample.calibration.focal == 720

    for folder in ("disp_noc_0", "obj_map", "calib_cam_to_cam"):
        shutil.rmtree(tmp_path / "training" / folder)
    sample = KITTI2015(tmp_path)[0]
    assert sample.occluded is sample.foreground is sample.calibration is None

    for folder in ("image_2", "image_3"):
        put_image(tmp_path / "testing" / folder / "000199_10.png", LEFT)
    assert KITTI2015(tmp_path, "testing")[0].disparity is None


def test_kitti2015_split_of_the_paper(tmp_path):
    names = [f"{number:06d}_10.png" for number in range(200)]
    for folder in ("image_2", "image_3", "disp_occ_0"):
        (tmp_path / "training" / folder).mkdir(parents=True)
        for name in names:
            (tmp_path / "training" / folder / name).touch()
    train = KITTI2015(tmp_path, "train", strict=True)
    validation = KITTI2015(tmp_path, "val", strict=True)
    assert (len(train), len(validation)) == (160, 40)
    numbers = [int(frame.name[:6]) for frame in validation.frames]
    # Of the list in the authors' release: its ends, its sum, its sum of squares.
    squares = sum(number**2 for number in numbers)
    assert (numbers[0], numbers[-1], sum(numbers), squares) == (2, 198, 3578, 462378)
    assert not {frame.name for frame in train.frames} & {frame.name for frame in validation.frames}
    assert len(KITTI2015(tmp_path, strict=True)) == 200


def test_vkitti2(tmp_path):
    frames = tmp_path / "Scene01" / "clone" / "frames"
    for camera, level in ((0, LEFT), (1, RIGHT)):
        put_image(frames / "rgb" / f"Camera_{camera}" / "rgb_00003.jpg", level)
        depth = flat(5000, np.uint16)
        depth[0] = 65535  # sky
        put_image(frames / "depth" / f"Camera_{camera}" / "depth_00003.png", depth)
    data = open_data_set("vkitti2", tmp_path, variation="clone")
    assert data.official_count() == 2126
    sample = data[0]
    assert sample.name == "Scene01/clone/00003"
    check_views(sample)
    rows = torch.arange(H)[:, None]
    check_disparity(sample, (rows > 0) * 7.7246052)  # 725.0087 * 0.532725 / 50 m
    hidden = (rows > 0) & (torch.arange(W) < 8)  # x - 7.72 rounds below column 0
    torch.testing.assert_close(sample.occluded, hidden)
    assert sample.calibration.focal * sample.calibration.baseline == pytest.approx(386.23026)
    with pytest.raises(FileNotFoundError, match=r"Scene.*/fog/frames/rgb/Camera_0"):
        open_data_set("vkitti2", tmp_path, variation="fog")
    with pytest.raises(InputError, match=r"variation must be one of .*got 'snow'"):
        open_data_set("vkitti2", tmp_path, variation="snow")


@pytest.mark.parametrize(
    ("options", "left", "divisor"),
    [
        ({}, "train-left-image/2018-07-09-16-11-56/a.jpg", 256),
        ({"split": "test"}, "test-left-image/left-image-half-size/2018-07-11/a.jpg", 256),
        ({"split": "test", "size": "full"}, "test-left-image/left-image-full-size/a.jpg", 128),
        ({"split": "foggy"}, "foggy/left-image-half-size/a.jpg", 256),
        ({"split": "rainy", "size": "full"}, "rainy/left-image-full-size/a.jpg", 128),
    ],
)
def test_drivingstereo(tmp_path, options, left, divisor):
    put_image(tmp_path / left, LEFT)
    put_image(tmp_path / left.replace("left-", "right-"), RIGHT)
    truth = flat(2560, np.uint16)
    truth[2] = 0
    put_image(tmp_path / left.replace("left-image", "disparity-map").replace(".jpg", ".png"), truth)
    data = open_data_set("drivingstereo", tmp_path, **options)
    assert len(data) == 1
    check_views(data[0])
    check_disparity(data[0], (torch.arange(H)[:, None] != 2) * (2560 / divisor))
    assert Path(data[0].name).name == "a"


def test_drivingstereo_refuses_full_size_training(tmp_path):
    with pytest.raises(InputError, match="half size only"):
        open_data_set("drivingstereo", tmp_path, size="full")


@pytest.mark.parametrize(
    ("name", "scene", "files", "count"),
    [
        ("middlebury2003", "cones", ("im2", "im6", "disp2", "disp6"), 2),
        ("middlebury2005", "Art", ("view1", "view5", "disp1", "disp5"), 6),
        ("middlebury2006", "Aloe", ("view1", "view5", "disp1", "disp5"), 21),
    ],
)
def test_middlebury_grey(tmp_path, name, scene, files, count):
    left, right, truth, right_truth = (tmp_path / scene / f"{file}.png" for file in files)
    put_image(left, LEFT)
    put_image(right, RIGHT)
    levels = flat(10, np.uint8)
    levels[0, 0] = 0
    put_image(truth, levels)
    with pytest.warns(UserWarning, match=f"expected {count} frames, found 1"):
        data = open_data_set(name, tmp_path, scale=4)
    sample = data[0]
    assert sample.name == scene
    check_views(sample)
    expected = torch.full((H, W), 2.5)
    expected[0, 0] = 0
    check_disparity(sample, expected)
    assert sample.occluded is None

    # The right view shows something nearer in column 5, the match of column 7 (4.5, rounded).
    levels = flat(10, np.uint8)
    levels[:, 5] = 40
    put_image(right_truth, levels)
    occluded = data[0].occluded[1]
    assert occluded.nonzero().flatten().tolist() == [0, 1, 7]

    with pytest.raises(InputError, match=f"{H} rows, the official sizes.*scale="):
        open_data_set(name, tmp_path)[0]


@pytest.mark.parametrize(
    ("name", "scene", "files", "scales"),
    [
        ("middlebury2003", "teddy", ("im2", "im6", "disp2"), {375: 4, 750: 2, 1500: 1}),
        ("middlebury2006", "Wood1", ("view1", "view5", "disp1"), {370: 3, 555: 2, 1110: 1}),
    ],
)
def test_middlebury_grey_scale_follows_the_size(tmp_path, name, scene, files, scales):
    for height, scale in scales.items():
        for file in files:
            put_image(tmp_path / scene / f"{file}.png", np.full((height, 2), 12, np.uint8))
        assert open_data_set(name, tmp_path)[0].disparity[0, 0] == pytest.approx(12 / scale)


def test_middlebury2005_scenes_without_ground_truth(tmp_path):
    for scene in ("Art", "Computer"):
        put_image(tmp_path / scene / "view1.png", LEFT)
        put_image(tmp_path / scene / "view5.png", RIGHT)
    put_image(tmp_path / "Art" / "disp1.png", flat(9, np.uint8))
    assert [frame.name for frame in open_data_set("middlebury2005", tmp_path).frames] == ["Art"]
    test = open_data_set("middlebury2005", tmp_path, split="test")
    assert [frame.name for frame in test.frames] == ["Computer"]
    check_views(test[0])
    assert test[0].disparity is None


CALIB = """cam0=[1000 0 300; 0 1000 250; 0 0 1]
cam1=[1000 0 320; 0 1000 250; 0 0 1]
doffs=20
baseline=200
"""


def put_scene(folder, truth_folder, truth_name):
    put_image(folder / "im0.png", LEFT)
    put_image(folder / "im1.png", RIGHT)
    put_text(folder / "calib.txt", CALIB)
    values = flat(3)
    values[:, 11] = np.inf
    put_pfm(truth_folder / truth_name, values)


@pytest.mark.parametrize(
    ("name", "options", "folder", "truth_folder", "truth_name", "count"),
    [
        ("middlebury2014", {}, "Piano-perfect", "Piano-perfect", "disp0.pfm", 23),
        (
            "middlebury2014",
            {"rectification": "imperfect"},
            "Piano-imperfect",
            "Piano-imperfect",
            "disp0.pfm",
            23,
        ),
        ("middlebury2021", {}, "artroom1", "artroom1", "disp0.pfm", 24),
        ("middlebury2021", {}, "data/artroom1", "data/artroom1", "disp0.pfm", 24),
        ("middeval3", {}, "trainingQ/Piano", "trainingQ/Piano", "disp0GT.pfm", 15),
        (
            "middeval3",
            {"size": "F"},
            "MiddEval3/trainingF/Piano",
            "MiddEval3/trainingF/Piano",
            "disp0GT.pfm",
            15,
        ),
        (
            "eth3d",
            {},
            "two_view_training/forest_1s",
            "two_view_training_gt/forest_1s",
            "disp0GT.pfm",
            27,
        ),
    ],
)
def test_calibrated_scenes(tmp_path, name, options, folder, truth_folder, truth_name, count):
    put_scene(tmp_path / folder, tmp_path / truth_folder, truth_name)
    with pytest.warns(UserWarning, match=f"expected {count} frames, found 1"):
        data = open_data_set(name, tmp_path, **options)
    sample = data[0]
    assert sample.name == Path(folder).name
    check_views(sample)
    columns = torch.arange(W)
    check_disparity(sample, (columns < 11) * 3.0)
    calibration = sample.calibration
    assert (calibration.focal, calibration.baseline, calibration.doffs) == (1000, 0.2, 20)
    assert sample.occluded is None

    if truth_name == "disp0.pfm":
        put_pfm(tmp_path / truth_folder / "disp1.pfm", flat(3))
        torch.testing.assert_close(data[0].occluded, (columns < 3).expand(H, W))
    mask = flat(255, np.uint8)
    mask[:, :2] = 128
    mask[:, 11] = 0
    put_image(tmp_path / truth_folder / "mask0nocc.png", mask)
    torch.testing.assert_close(data[0].occluded, (columns < 2).expand(H, W))

    # The benchmarks' non-occluded pixels are those of 255 alone.
    mask[:, 4] = 0
    put_image(tmp_path / truth_folder / "mask0nocc.png", mask)
    hidden = ((columns < 2) | (columns == 4)).expand(H, W)
    torch.testing.assert_close(data[0].occluded, hidden)


@pytest.mark.parametrize(
    ("name", "folder", "count"),
    [("middeval3", "testQ/Plants", 15), ("eth3d", "two_view_test/lakeside_1l", 20)],
)
def test_scenes_without_ground_truth(tmp_path, name, folder, count):
    put_image(tmp_path / folder / "im0.png", LEFT)
    put_image(tmp_path / folder / "im1.png", RIGHT)
    with pytest.warns(UserWarning, match=f"expected {count} frames"):
        sample = open_data_set(name, tmp_path, split="test")[0]
    check_views(sample)
    assert sample.disparity is sample.calibration is None


def test_middlebury2014_other_exposure(tmp_path):
    put_scene(tmp_path / "Piano-perfect", tmp_path / "Piano-perfect", "disp0.pfm")
    put_image(tmp_path / "Piano-perfect" / "im1E.png", 255)
    assert open_data_set("middlebury2014", tmp_path, right="im1E")[0].right.min() == 1
    with pytest.raises(FileNotFoundError, match=r"im0\.png: its right view .*im1L\.png is missing"):
        open_data_set("middlebury2014", tmp_path, right="im1L")
    for options in ({"right": "im2"}, {"rectification": "good"}):
        with pytest.raises(InputError, match=f"Middlebury2014.*{next(iter(options.values()))}"):
            open_data_set("middlebury2014", tmp_path, **options)
    with pytest.raises(InputError, match="size must be Q, H or F, got 'X'"):
        open_data_set("middeval3", tmp_path, size="X")


@pytest.mark.parametrize("render", ["final", "clean"])
def test_sintel(tmp_path, render):
    root = tmp_path / "training"
    name = Path("alley_1") / "frame_0001.png"
    put_image(root / f"{render}_left" / name, LEFT)
    put_image(root / f"{render}_right" / name, RIGHT)
    packed = np.zeros((H, W, 3), np.uint8) + np.array([2, 32, 0], np.uint8)
    put_image(root / "disparities" / name, packed)
    data = open_data_set("sintel", tmp_path, render=render)
    assert data.official_count() == 1064
    sample = data[0]
    assert sample.name == "alley_1/frame_0001"
    check_views(sample)
    check_disparity(sample, 8.5)
    assert sample.occluded is None
    for folder, columns in (("occlusions", slice(5, 7)), ("outofframe", slice(0, 3))):
        mask = flat(0, np.uint8)
        mask[:, columns] = 255
        put_image(root / folder / name, mask)
    hidden = torch.tensor([column in (0, 1, 2, 5, 6) for column in range(W)])
    torch.testing.assert_close(data[0].occluded, hidden.expand(H, W))
    with pytest.raises(InputError, match="render"):
        open_data_set("sintel", tmp_path, render="albedo")


def test_pair_folder(tmp_path):
    for scene, number in (("day", 1), ("night", 22)):
        put_image(tmp_path / scene / "cam_l" / f"f{number:03d}.png", LEFT)
        put_image(tmp_path / scene / "cam_r" / f"f{number:03d}_right.jpg", RIGHT)
        put_pfm(tmp_path / "gt" / f"{scene}-{number:03d}.pfm", flat(number))
    put_text(tmp_path / "calib.txt", CALIB)
    data = open_data_set(
        "folder",
        tmp_path,
        left="*/cam_l/f*.png",
        right="*/cam_r/f*_right.jpg",
        disparity="gt/*-*.pfm",
        calibration="calib.txt",
    )
    assert [sample.name for sample in data] == ["day/cam_l/f001", "night/cam_l/f022"]
    for sample, level in zip(data, (1, 22), strict=True):
        check_views(sample)
        check_disparity(sample, level)
        assert sample.calibration.doffs == 20
    with pytest.raises(InputError, match=r"'right\.png' needs as many wildcards as 'left/\*\.png'"):
        open_data_set("folder", tmp_path, right="right.png")
    with pytest.raises(InputError, match="cannot look for"):
        open_data_set("folder", tmp_path, left="/*.png", right="*.png")
    with pytest.raises(FileNotFoundError, match=r"nothing found in .*left/\*\.png"):
        open_data_set("folder", tmp_path)


def test_pair_folder_wildcards_and_scale(tmp_path):
    put_image(tmp_path / "a" / "b" / "L1.png", LEFT)
    put_image(tmp_path / "L1.png", LEFT)
    put_image(tmp_path / "right" / "a" / "b" / "R1.png", RIGHT)
    put_image(tmp_path / "right" / "R1.png", RIGHT)
    data = open_data_set("folder", tmp_path, left="**/L[0-9].png", right="right/**/R?.png")
    assert [frame.right.relative_to(tmp_path).as_posix() for frame in data.frames] == [
        "right/R1.png",
        "right/a/b/R1.png",
    ]
    put_image(tmp_path / "D1.png", flat(30, np.uint8))
    options = {"left": "L?.png", "right": "right/R?.png", "disparity": "D?.png"}
    check_disparity(open_data_set("folder", tmp_path, scale=4, **options)[0], 7.5)
    with pytest.raises(InputError, match="needs its scale"):
        open_data_set("folder", tmp_path, **options)[0]
    with pytest.raises(InputError, match="scale must be a number or null, got nan"):
        open_data_set("folder", tmp_path, scale=float("nan"), **options)
    for wrong in (0, -4):
        with pytest.raises(InputError, match=r"D1\.png: its scale .* must be positive"):
            open_data_set("folder", tmp_path, scale=wrong, **options)[0]


def test_missing_files_are_named(tmp_path):
    name = put_kitti(tmp_path / "training", 7, 2015)
    with pytest.raises(FileNotFoundError, match=r"1 frames found .* none of this split: .*train"):
        KITTI2015(tmp_path, "val")
    (tmp_path / "training" / "disp_occ_0" / name).unlink()
    with pytest.raises(FileNotFoundError, match=r"image_2/000007_10.*disp_occ_0/000007_10"):
        KITTI2015(tmp_path)
    (tmp_path / "training" / "image_3" / name).unlink()
    with pytest.raises(FileNotFoundError, match=r"image_2/000007_10.*image_3/000007_10"):
        KITTI2015(tmp_path)
    with pytest.raises(
        FileNotFoundError, match=r"nothing found in .*nowhere: no training/image_2.*no such folder"
    ):
        KITTI2015(tmp_path / "nowhere")
    for folder in "hgfedcba":
        (tmp_path / "other" / folder).mkdir(parents=True)
    with pytest.raises(FileNotFoundError, match=r"it holds a, b, c, d, e, f, \.\.\.$"):
        KITTI2015(tmp_path / "other")


def test_pairs_without_ground_truth_are_refused(tmp_path):
    name = put_kitti(tmp_path / "training", 7, 2015)
    put_kitti(tmp_path / "testing", 7, 2015)
    KITTI2015(tmp_path).require_truth()
    with pytest.raises(InputError, match=r"\(testing\) has no .*: training, train, val$"):
        KITTI2015(tmp_path, split="testing").require_truth()
    options = {"left": "training/image_2/*_10.png", "right": "training/image_3/*_10.png"}
    with pytest.raises(InputError, match='--set "disparity=disparity/'):
        open_data_set("folder", tmp_path, **options).require_truth()
    pairs = open_data_set("folder", tmp_path, disparity="training/disp_occ_0/*_10.png", **options)
    pairs.require_truth()
    assert pairs.frames[0].disparity == tmp_path / "training" / "disp_occ_0" / name


@pytest.mark.parametrize(("folder", "map_"), [("occ", "disparity"), ("noc", "occluded")])
def test_sizes_must_agree(tmp_path, folder, map_):
    name = put_kitti(tmp_path / "training", 7, 2015)
    put_image(tmp_path / "training" / f"disp_{folder}_0" / name, np.ones((H, W + 1), np.uint16))
    with pytest.raises(InputError, match=f"left view is {W}x{H}, but {map_} is {W + 1}x{H}"):
        KITTI2015(tmp_path)[0]


def test_strict_names_both_counts(tmp_path):
    put_kitti(tmp_path / "training", 7, 2015)
    with pytest.raises(InputError, match=r"kitti2015 \(training\): expected 200 frames, found 1"):
        KITTI2015(tmp_path, strict=True)


def test_registry(tmp_path):
    assert set(data_sets()) >= {
        *("sceneflow", "kitti2012", "kitti2015", "vkitti2", "drivingstereo", "sintel", "eth3d"),
        *("middlebury2003", "middlebury2005", "middlebury2006", "middlebury2014"),
        *("middlebury2021", "middeval3", "folder"),
    }
    with pytest.raises(InputError, match=r"unknown data set 'kitti': did you mean .*kitti2015"):
        open_data_set("kitti", tmp_path)
    with pytest.raises(InputError, match="kitti2015 has no option 'size', only split, strict"):
        open_data_set("kitti2015", tmp_path, size=3)
    for name, options, word in (
        ("folder", {"scale": "four"}, "folder: scale must be a number or null, got 'four'"),
        ("folder", {"scale": True}, "scale must be"),
        ("folder", {"disparity": 7}, "disparity must be text or null, got 7"),
        ("kitti2012", {"grey": "no"}, "kitti2012: grey must be true or false, got 'no'"),
        ("kitti2012", {"grey": 1}, "grey must be true or false"),
    ):
        with pytest.raises(InputError, match=word):
            open_data_set(name, tmp_path, **options)
    for name in data_sets():
        with pytest.raises(InputError, match="unknown split, there are"):
            open_data_set(name, tmp_path, split="nonsense")
        with pytest.raises(
            FileNotFoundError, match=rf"nothing found in {tmp_path}: no \S+\.\S*g\b"
        ):
            open_data_set(name, tmp_path)


def test_a_data_set_is_registered_by_its_decorator(tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "_REGISTRY", dict(registry._REGISTRY))

    for _ in range(2):  # as a notebook's cell that is run again

        @register_data_set("own")
        class Own(PairFolder):
            pass

        assert data_sets()["own"] is Own
    with pytest.raises(FileNotFoundError, match=r"own \(all\): nothing found"):
        open_data_set("own", tmp_path)
    with pytest.raises(InputError, match="data set 'own' is Own already"):
        register_data_set("own")(KITTI2015)


def test_occlusion_from_right_view():
    # A wall at disparity 2 and, in the left view's columns 6 to 8, a post at disparity 4, which
    # the right view shows in columns 2 to 4. There the wall of the left view's columns 4 to 6
    # would be; column 6 is the post.
    disparity = np.full((1, 12), 2, np.float32)
    disparity[0, 6:9] = 4
    right = np.full((1, 12), 2, np.float32)
    right[0, 2:5] = 4
    known = np.ones((1, 12), bool)
    hidden = occlusion_from_right_view(disparity, known, right, known)
    assert hidden[0].nonzero()[0].tolist() == [0, 1, 4, 5]
    # Unknown on the right: taken for visible. Unknown on the left: not an occlusion.
    nothing = np.zeros_like(known)
    assert occlusion_from_right_view(disparity, known, right, nothing)[0].nonzero()[0].tolist() == [
        0,
        1,
    ]
    assert not occlusion_from_right_view(disparity, nothing, right, known).any()
    with pytest.raises(InputError, match="right view is 12x2, that of the left view 12x1"):
        occlusion_from_right_view(disparity, known, np.vstack([right] * 2), known)


def test_loads_in_worker_processes(tmp_path):
    for number in range(4):
        put_kitti(tmp_path / "training", number, 2015, level=number + 1)
    loader = DataLoader(KITTI2015(tmp_path), batch_size=2, num_workers=1, collate_fn=collate)
    batches = list(loader)
    assert [batch.name for batch in batches] == ["000000_10,000001_10", "000002_10,000003_10"]
    assert batches[1].disparity.amax(dim=(1, 2)).tolist() == [3, 4]


SHARED = Path(os.environ.get("MSNET_SHARED", Path(__file__).parents[3] / "shared")) / "data"


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the samples of public data sets")
@pytest.mark.parametrize(
    ("name", "folder", "options", "size"),
    [
        ("kitti2015", "kitti2015", {"split": "train"}, (375, 1242)),
        ("sceneflow", "sceneflow", {"split": "test", "render": "cleanpass"}, (540, 960)),
        ("middeval3", "middeval3", {}, (497, 741)),
        ("eth3d", "eth3d", {}, (490, 941)),
        ("middlebury2003", "middlebury2003", {}, (375, 450)),
        ("middlebury2005", "middlebury2005", {}, (555, 671)),
    ],
)
def test_real_samples_match_photometrically(name, folder, options, size):
    """Right pixels at x - d look like the left ones: sign, scale, row order and views are right."""
    sample = open_data_set(name, SHARED / folder, **options)[0]
    assert sample.left.shape[1:] == size
    column = torch.arange(size[1]) - sample.disparity.round().long()
    known = sample.valid & (column >= 0)
    if sample.occluded is not None:
        known &= ~sample.occluded
    left, right = sample.left.mean(0), sample.right.mean(0)
    error = (left - right.gather(1, column.clamp(0))).abs()[known].mean()
    unmoved = (left - right).abs()[known].mean()
    assert known.float().mean() > 0.1
    assert error < 0.7 * unmoved
    if name == "sceneflow":  # what is marked as hidden does not match
        hidden = sample.occluded & (column >= 0)
        assert (left - right.gather(1, column.clamp(0))).abs()[hidden].mean() > 10 * error
