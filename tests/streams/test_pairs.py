"""Pairs of folders and patterns."""

import shutil

import cv2
import numpy as np
import pytest

from mobilestereonet.errors import InputError
from mobilestereonet.streams.driving import find_pairs
from mobilestereonet.streams.pairs import PairFiles, read_pairs


def touch(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()


def test_folders_are_paired_by_name_and_10_comes_after_9(sequence):
    (sequence / "left" / "notes.txt").touch()
    pairs = find_pairs(sequence / "left", sequence / "right")
    assert [pair.name for pair in pairs] == [f"view_{index}" for index in range(11)]
    for index, pair in enumerate(pairs):
        assert pair.left == sequence / "left" / f"view_{index}.png"
        assert pair.right == sequence / "right" / f"view_{index}.png"
        assert pair.calibration is None


@pytest.mark.parametrize("sides", [("left",), ("right",), ("left", "right")])
def test_hidden_files_are_no_views(sequence, sides):
    for side in sides:
        for name in ("._view_3.png", ".view_4.png", "._view_3.jpg"):
            (sequence / side / name).write_bytes(b"\0\5\x16\7" + bytes(100))
    for pattern in ("", "*.png"):
        pairs = find_pairs(sequence / "left" / pattern, sequence / "right" / pattern)
        assert [pair.name for pair in pairs] == [f"view_{index}" for index in range(11)]


def test_patterns_are_paired_by_what_their_wildcards_stand_for(tmp_path, monkeypatch):
    for run in ("a", "b"):
        for index in (1, 2):
            touch(tmp_path / run / f"cam0_{index}.jpg")
            touch(tmp_path / run / f"cam1_{index}.jpg")
    monkeypatch.chdir(tmp_path)
    pairs = find_pairs("*/cam0_*.jpg", "*/cam1_*.jpg")
    assert [pair.name for pair in pairs] == ["a/cam0_1", "a/cam0_2", "b/cam0_1", "b/cam0_2"]
    assert pairs[2].right == tmp_path / "b" / "cam1_1.jpg"


def test_a_folder_is_no_pattern_even_if_it_looks_like_one(tmp_path):
    for index in (1, 2):
        touch(tmp_path / "[run1]" / "left [a]" / f"{index}.png")
        touch(tmp_path / "[run1]" / "right" / f"{index}.png")
    left, right = tmp_path / "[run1]" / "left [a]", tmp_path / "[run1]" / "right"
    for first, second in ((left, right), (right, left)):
        expected = [PairFiles(n, first / f"{n}.png", second / f"{n}.png") for n in ("1", "2")]
        assert find_pairs(first, second) == expected
        assert find_pairs(first / "[12].png", second / "[12].png") == expected
    with pytest.raises(FileNotFoundError, match="absent: no such file, folder or pattern"):
        find_pairs(left, left / "absent")


def test_two_pairs_of_one_name_are_an_error(tmp_path):
    for side in ("l", "r"):
        for name in ("x.png", "x.jpg", "y.png"):
            touch(tmp_path / side / name)
    with pytest.raises(InputError, match=r"l/x.jpg and .*l/x.png would both be called x,"):
        find_pairs(tmp_path / "l" / "*", tmp_path / "r" / "*")


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (lambda root: (root / "right/view_3.png").unlink(), FileNotFoundError, "view_3.png"),
        (lambda root: (root / "left/view_3.png").unlink(), InputError, "10 left .* 11 right"),
        (lambda root: (root / "left/x.jpg").touch(), InputError, ".jpg and .png; give a pattern"),
        (lambda root: shutil.rmtree(root / "right"), FileNotFoundError, "right: no such"),
        (
            lambda root: [path.unlink() for path in (root / "left").iterdir()],
            InputError,
            "left: no image",
        ),
    ],
)
def test_what_has_no_partner_is_an_error(sequence, change, error, message):
    change(sequence)
    with pytest.raises(error, match=message):
        find_pairs(sequence / "left", sequence / "right")


def test_kitti_odometry_with_each_sequences_calibration(tmp_path):
    for sequence, focal in (("00", 718.0), ("03", 721.0)):
        for camera in (2, 3):
            for index in range(2):
                touch(tmp_path / "sequences" / sequence / f"image_{camera}" / f"{index:06d}.png")
        rows = {0: 0.0, 1: -386.0, 2: 45.0, 3: -339.0}
        text = "".join(
            f"P{camera}: {focal} 0 607 {shift} 0 {focal} 185 0 0 0 1 0\n"
            for camera, shift in rows.items()
        )
        (tmp_path / "sequences" / sequence / "calib.txt").write_text(text)
    pairs = find_pairs(tmp_path)
    assert [pair.name for pair in pairs] == ["00/000000", "00/000001", "03/000000", "03/000001"]
    assert pairs[3].right == tmp_path / "sequences/03/image_3/000001.png"
    assert pairs[0].calibration.focal == 718
    assert pairs[2].calibration.baseline == pytest.approx(384 / 721)
    with pytest.raises(InputError, match="no sequences"):
        find_pairs(tmp_path / "sequences")


def test_what_cannot_be_read_is_told_not_raised(sequence):
    whole = sequence / "left" / "view_1.png"
    whole.write_bytes(whole.read_bytes()[:200])
    assert cv2.imwrite(str(sequence / "right" / "view_2.png"), np.zeros((9, 9, 3), np.uint8))
    frames = list(read_pairs(find_pairs(sequence / "left", sequence / "right"), fps=4))
    assert [frame.index for frame in frames] == list(range(11))
    assert [frame.seconds for frame in frames[:3]] == [0, 0.25, 0.5]
    assert [frame.pair is None for frame in frames] == [False, True, True] + 8 * [False]
    assert "view_1.png: not an image" in frames[1].problem
    assert "160x48" in frames[2].problem
    assert frames[0].pair.left.shape == (3, 48, 160)


def test_views_named_by_their_time_stamps(tmp_path):
    start = 1403636579763555584  # ns, 50 ms apart
    for index in range(4):
        touch(tmp_path / "l" / f"{start + 50_000_000 * index}.png")
        if index != 1:
            touch(tmp_path / "r" / f"{start + 50_000_000 * index + 3_000_017}.png")
    with pytest.warns(UserWarning, match="1 of 4 left views and 0 of 3 right ones have no partner"):
        pairs = find_pairs(tmp_path / "l", tmp_path / "r")
    assert [pair.name for pair in pairs] == [str(start + 50_000_000 * i) for i in (0, 2, 3)]
    assert all(int(pair.right.stem) - int(pair.left.stem) == 3_000_017 for pair in pairs)


def test_ways_to_pair_views(tmp_path):
    for index, seconds in enumerate((9.9, 10.0, 10.1)):
        touch(tmp_path / "l" / f"cam0_{seconds}.png")
        touch(tmp_path / "r" / f"cam1_{index}_{seconds + 0.02:.2f}.png")
    ordered = find_pairs(tmp_path / "l", tmp_path / "r", "order")
    assert [pair.name for pair in ordered] == ["cam0_9.9", "cam0_10.0", "cam0_10.1"]
    assert find_pairs(tmp_path / "l", tmp_path / "r", "nearest") == ordered
    with pytest.raises(FileNotFoundError, match="right view"):
        find_pairs(tmp_path / "l", tmp_path / "r")
    with pytest.raises(InputError, match="by name, order or nearest; got 'time'"):
        find_pairs(tmp_path / "l", tmp_path / "r", "time")
    touch(tmp_path / "l" / "none.png")
    with pytest.raises(InputError, match="4 left views, but 3 right ones"):
        find_pairs(tmp_path / "l", tmp_path / "r", "order")
    with pytest.raises(InputError, match=r"none.png: no time stamp in its name"):
        find_pairs(tmp_path / "l", tmp_path / "r", "nearest")


@pytest.mark.parametrize("name", ["left_{}_{:09d}", "{}.{:09d}", "{}-{:09d}", "cam0-{}.{:09d}"])
def test_names_of_seconds_and_nanoseconds(tmp_path, name):
    start = 1403636579_963555584  # ns; the third view is in the next second
    for index in range(4):
        for side, late in (("l", 0), ("r", 3_000_017)):
            stamp = divmod(start + 25_000_000 * index + late, 10**9)
            if (side, index) != ("r", 1):
                touch(tmp_path / side / f"{name.format(*stamp)}.png")
    with pytest.warns(UserWarning, match="1 of 4 left views and 0 of 3 right ones have no partner"):
        pairs = find_pairs(tmp_path / "l", tmp_path / "r", "nearest")
    assert [pair.name for pair in pairs] == [
        name.format(*divmod(start + 25_000_000 * index, 10**9)) for index in (0, 2, 3)
    ]
