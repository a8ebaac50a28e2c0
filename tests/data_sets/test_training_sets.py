"""Scanners of the sets that present networks are trained on, on trees as their releases have."""

import json

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
    put_npy,
    put_text,
)

from extras import need_extra
from mobilestereonet.data import data_sets, open_data_set
from mobilestereonet.errors import InputError

pytestmark = pytest.mark.filterwarnings("ignore:.*expected .* frames:UserWarning")

COLUMNS = torch.arange(W)
ROWS = torch.arange(H)[:, None]
SETTINGS = {"camera_settings": [{"intrinsic_settings": {"fx": 768.16, "cx": 480, "cy": 270}}]}


def levels(known, dtype=np.uint16):
    """A map of one level, unknown in the first row."""
    found = flat(known, dtype)
    found[0] = 0
    return found


def put_views(root, left, right):
    put_image(root / left, LEFT)
    put_image(root / right, RIGHT)


def put_crestereo(root, truth=True):
    put_views(root, "tree/0000/7_left.jpg", "tree/0000/7_right.jpg")
    for side in ("left", "right"):
        put_image(root / f"tree/0000/7_{side}.disp.png", levels(3 * 32 + 16))


def put_fallingthings(root):
    folder = root / "fat/single/002_master_chef_can_16k/kitchen_0"
    put_views(folder, "000000.left.jpg", "000000.right.jpg")
    depth = flat(20000, np.uint16)  # 2 m
    depth[0] = 65535
    for side in ("left", "right"):
        put_image(folder / f"000000.{side}.depth.png", depth)
    put_text(folder / "_camera_settings.json", json.dumps(SETTINGS))


def put_tartanair(root):
    folder = root / "abandonedfactory/Easy/P001"
    for side, level in (("left", LEFT), ("right", RIGHT)):
        put_image(folder / f"image_{side}/000003_{side}.png", level)
        depth = flat(16, np.float16)
        depth[0] = np.inf
        put_npy(folder / f"depth_{side}/000003_{side}_depth.npy", depth)


def put_irs(root):
    exr = need_extra("OpenEXR")
    folder = root / "IRSDataset/Restaurant/SCLRestaurant001_NightFall"
    put_views(folder, "l_377.png", "r_377.png")
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    exr.File(header, {"G": levels(6.25, np.float32)}).write(str(folder / "d_377.exr"))


def put_spring(root, step=2):
    h5py = need_extra("h5py")
    folder = root / "spring/train/0001"
    for side, level in (("left", LEFT), ("right", RIGHT)):
        put_image(folder / f"frame_{side}/frame_{side}_0002.png", level)
        (folder / f"disp1_{side}").mkdir()
        # The values between those of the views' pixels are others.
        fine = np.full((step * H, step * W), 99, np.float32)
        fine[::2, ::2] = levels(7.5, np.float32)
        fine[0] = np.nan
        with h5py.File(folder / f"disp1_{side}/disp1_{side}_0002.dsp5", "w") as file:
            file.create_dataset("disparity", data=fine, compression="gzip")
    put_text(folder / "cam_data/intrinsics.txt", "1 1 1 1\n2133.3 2133.3 960 540\n")


def put_unrealstereo4k(root):
    put_views(root, "00003/Image0/00000.png", "00003/Image1/00000.png")
    for side in (0, 1):
        put_npy(root / f"00003/Disp{side}/00000.npy", levels(5.5, np.float32))


def put_fsd(root):
    folder = root / "kitchen_1/dataset/data"
    put_views(folder, "left/rgb/0004.jpg", "right/rgb/0004.jpg")
    # 4.111 px are 4111 thousandths: 16 * 255 + 31.
    packed = np.zeros((H, W, 3), np.uint8)
    packed[1:] = (0, 16, 31)
    put_image(folder / "left/disparity/0004.png", packed)


def put_instereo2k(root):
    folder = root / "train/part2/000040"
    put_views(folder, "left.png", "right.png")
    for side in ("left", "right"):
        put_image(folder / f"{side}_disp.png", levels(275))


def put_booster(root):
    scene = root / "train/balanced/Bathroom"
    put_views(scene, "camera_00/im2.png", "camera_02/im2.png")
    for side in ("00", "02"):
        put_npy(scene / f"disp_{side}.npy", levels(9.25, np.float32))


def put_argoverse(root):
    drive = root / "argoverse_stereo_v1.1/rectified_stereo_images_v1.1/train/273c"
    maps = root / "argoverse_stereo_v1.1/disparity_maps_v1.1/train/273c"
    for gap, level in ((0, 0), (200_000_000, LEFT)):
        time = 315978406032859416 + gap
        put_image(drive / f"stereo_front_left_rect/stereo_front_left_rect_{time}.jpg", level)
        for kind in ("disparity", "objects_disparity"):
            folder = maps / f"stereo_front_left_rect_{kind}"
            values = levels(8 * 256 + gap // 200_000_000 * 128)
            if kind.startswith("objects"):
                values[:, 5:] = 0
            put_image(folder / f"{folder.name}_{time}.png", values)
        right = drive / f"stereo_front_right_rect/stereo_front_right_rect_{time - 70_000}.jpg"
        put_image(right, RIGHT if level else 0)


SETS = {
    "crestereo": (put_crestereo, "tree/0000/7_left", 3.5),
    "fallingthings": (
        put_fallingthings,
        "single/002_master_chef_can_16k/kitchen_0/000000.left",
        768.16 * 0.06 / 2,
    ),
    "tartanair": (put_tartanair, "abandonedfactory/Easy/P001/image_left/000003_left", 5),
    "irs": (put_irs, "Restaurant/SCLRestaurant001_NightFall/l_377", 6.25),
    "spring": (put_spring, "train/0001/frame_left/frame_left_0002", 7.5),
    "unrealstereo4k": (put_unrealstereo4k, "00003/Image0/00000", 5.5),
    "fsd": (put_fsd, "kitchen_1/dataset/data/left/rgb/0004", 4.111),
    "instereo2k": (put_instereo2k, "train/part2/000040/left", 2.75),
    "booster": (put_booster, "train/balanced/Bathroom/camera_00/im2", 9.25),
    "argoverse": (put_argoverse, "273c/315978406232859416", 8.5),
}
"""The tree, the frame's name and its disparity below the first row, which is unknown."""

WITHOUT_RIGHT_TRUTH = {"irs", "fsd", "argoverse"}


@pytest.mark.parametrize("name", SETS)
def test_a_frame_as_the_release_has_it(tmp_path, name):
    put, frame, disparity = SETS[name]
    put(tmp_path)
    data = open_data_set(name, tmp_path)
    sample = data[len(data) - 1]
    assert sample.name == frame
    check_views(sample)
    check_disparity(sample, (ROWS > 0) * disparity)
    if name in WITHOUT_RIGHT_TRUTH:
        assert sample.occluded is None
    else:  # a plane: what would match left of the right view is hidden
        hidden = (ROWS > 0) & (disparity - COLUMNS > 0.5)
        torch.testing.assert_close(sample.occluded, hidden)
    # The root may be the archives' own folder.
    archive = tmp_path / data.archive if getattr(data, "archive", "") else tmp_path
    assert [f.name for f in open_data_set(name, archive).frames] == [f.name for f in data.frames]


def test_geometry(tmp_path):
    for name, focal, baseline in (
        ("fallingthings", 768.16, 0.06),
        ("tartanair", 320, 0.25),
        ("spring", 2133.3, 0.065),
    ):
        SETS[name][0](tmp_path / name)
        found = open_data_set(name, tmp_path / name)[0].calibration
        assert (found.focal, found.baseline) == (focal, baseline)
    settings = next((tmp_path / "fallingthings").rglob("_camera_settings.json"))
    settings.write_text("{}")
    with pytest.raises(InputError, match=r"_camera_settings\.json: no camera settings of Falling"):
        open_data_set("fallingthings", tmp_path / "fallingthings")[0]
    intrinsics = next((tmp_path / "spring").rglob("intrinsics.txt"))
    intrinsics.write_text("1 1 1 1\n")
    with pytest.raises(InputError, match=r"intrinsics\.txt: line 2 must hold fx, fy, cx and cy"):
        open_data_set("spring", tmp_path / "spring")[0]


def test_argoverse_pairs_by_time_and_knows_foreground(tmp_path):
    put_argoverse(tmp_path)
    sample = open_data_set("argoverse", tmp_path)[1]
    torch.testing.assert_close(sample.foreground & sample.valid, (ROWS > 0) & (COLUMNS < 5))
    for right in tmp_path.rglob("stereo_front_right_rect_*6232*.jpg"):
        right.unlink()  # the other one is 0.2 s away
    with pytest.raises(FileNotFoundError, match=r"6232859416\.jpg: its right view .* is missing"):
        open_data_set("argoverse", tmp_path)


def test_splits_of_falling_things(tmp_path):
    put_fallingthings(tmp_path)
    assert len(open_data_set("fallingthings", tmp_path, split="single")) == 1
    with pytest.raises(FileNotFoundError, match=r"no mixed/\*\*/\*\.left\.jpg"):
        open_data_set("fallingthings", tmp_path, split="mixed")


@pytest.mark.parametrize(
    ("name", "left", "right"),
    [
        ("spring", "test/0003/frame_left/frame_left_1.png", "frame_right/frame_right_1.png"),
        ("booster", "test/balanced/Sofa/camera_00/im0.png", "camera_02/im0.png"),
        (
            "argoverse",
            "rectified_stereo_images_v1.1/test/a/stereo_front_left_rect/l_5.jpg",
            "stereo_front_right_rect/r_6.jpg",
        ),
    ],
)
def test_splits_without_ground_truth(tmp_path, name, left, right):
    put_image(tmp_path / left, LEFT)
    put_image((tmp_path / left).parents[1] / right, RIGHT)
    sample = open_data_set(name, tmp_path, split="test")[0]
    check_views(sample)
    assert sample.disparity is None


def test_a_map_of_another_size_is_refused(tmp_path):
    put_unrealstereo4k(tmp_path)
    put_npy(tmp_path / "00003/Disp0/00000.npy", np.ones((2 * H, 2 * W), np.float32))
    with pytest.raises(InputError, match=f"left view is {W}x{H}, but disparity is {2 * W}x{2 * H}"):
        open_data_set("unrealstereo4k", tmp_path)[0]
    put_unrealstereo4k(tmp_path)
    put_npy(tmp_path / "00003/Disp1/00000.npy", np.ones((H, 2), np.float32))
    with pytest.raises(
        InputError, match=r"Image0/00000\.png: the ground truth of the right view is"
    ):
        open_data_set("unrealstereo4k", tmp_path)[0]


def test_every_set_says_what_it_is_and_where_that_is_told():
    for name in SETS:
        text = data_sets()[name].__doc__
        assert "Source:" in text, name
        assert "    root" in text, name


def test_views_of_a_jpeg_are_not_swapped(tmp_path):
    """Names that differ in one letter, as FSD's folders do."""
    put_fsd(tmp_path)
    frame = open_data_set("fsd", tmp_path).frames[0]
    assert cv2.imread(str(frame.left)).mean() < cv2.imread(str(frame.right)).mean()
