"""The commands doctor and rectify, as a user runs them."""

import json

import cv2
import numpy as np
import pytest

from mobilestereonet.data import read_calibration


@pytest.fixture
def folder(tmp_path):
    noise = np.random.default_rng(0).integers(0, 256, (200, 340, 3), dtype=np.uint8)
    wide = cv2.GaussianBlur(noise, (0, 0), 2)
    wide = cv2.normalize(wide, None, 0, 255, cv2.NORM_MINMAX)
    cv2.imwrite(str(tmp_path / "left.png"), wide[:, :320])
    cv2.imwrite(str(tmp_path / "right.png"), wide[:, 20:])
    cv2.imwrite(str(tmp_path / "small.png"), wide[:, 40:])
    return tmp_path


def test_doctor(msnet, folder):
    left, right = folder / "left.png", folder / "right.png"
    code, out, err = msnet("doctor", left, right)
    assert (code, err) == (0, "")
    assert "disparities go from 20 to 20 px" in out
    assert out.count("good") >= 5
    code, out, _ = msnet("doctor", right, left, "--json")
    assert code == 1
    levels = {finding["check"]: finding["level"] for finding in json.loads(out)}
    assert levels["order"] == "problem"
    assert levels["rectified"] == "good"
    code, out, err = msnet("doctor", left, folder / "small.png")
    assert (code, out) == (2, "")
    assert "left.png has 320x200" in err


def test_doctor_hears_how_the_views_lie(msnet, folder):
    views = [cv2.imread(str(folder / f"{side}.png")) for side in ("left", "right")]
    cv2.imwrite(str(folder / "both.png"), np.vstack(views)[:, 1:])
    cv2.imwrite(str(folder / "turned.png"), np.rot90(np.vstack(views), 2))
    stacked = ("--layout", "top-bottom")
    assert msnet("doctor", folder / "both.png", *stacked)[0] == 0
    assert msnet("doctor", folder / "both.png", *stacked, "--order", "right-left")[0] == 1
    assert msnet("doctor", folder / "turned.png", *stacked, "--rotate", 180)[0] == 1
    options = (*stacked, "--rotate", 180, "--order", "right-left")
    assert msnet("doctor", folder / "turned.png", *options)[0] == 0
    code, out, _ = msnet("doctor", folder / "left.png")
    assert code == 1
    assert "layout: the picture's halves are not two views" in out
    code, out, err = msnet("predict", folder / "left.png", "-o", folder / "a", "--model", "sgbm")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "halves are not two views" in err and not (folder / "a").exists()


def write_rig(path, **values):
    camera = np.array([[300.0, 0, 160], [0, 300, 100], [0, 0, 1]])
    rotation = cv2.Rodrigues(np.array([0.0, 0.02, 0.03]))[0]
    whole = {"M1": camera, "D1": np.zeros(5), "M2": camera, "D2": np.zeros(5), "R": rotation}
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in (whole | {"T": np.array([-60.0, 0, 0])} | values).items():
        storage.write(name, value)
    storage.release()


def test_rectify(msnet, folder):
    write_rig(folder / "stereo.yml")
    views = folder / "left.png", folder / "right.png"
    command = ("rectify", *views, "--calib", folder / "stereo.yml", "-o", folder / "out")
    code, out, err = msnet(*command, "--unit", "mm")
    assert (code, err) == (0, "")
    names = ["left.png", "right.png", "calib.txt"]
    assert out.splitlines() == [str(folder / "out" / name) for name in names]
    calibration = read_calibration(folder / "out" / "calib.txt")
    assert calibration.baseline == pytest.approx(0.06)
    assert calibration.doffs == pytest.approx(0)
    assert 250 < calibration.focal < 400
    assert cv2.imread(str(folder / "out" / "left.png")).shape == (200, 320, 3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ((), "60 m is implausible"),
        (("--unit", "inch"), "--unit inch: there are m, cm, mm"),
        (("--unit", "mm", "--calib", "left.png"), "left.png: unknown calibration format"),
        (("--unit", "mm", "--calib", "none.yml"), "none.yml: no such file"),
        (("--unit", "mm", "--calib", "swapped.yml"), "are the cameras swapped"),
    ],
)
def test_rectify_refuses_and_writes_nothing(msnet, folder, options, message):
    write_rig(folder / "stereo.yml")
    write_rig(folder / "swapped.yml", T=np.array([60.0, 0, 0]))
    before = sorted(folder.rglob("*"))
    views = folder / "left.png", folder / "right.png"
    named = [folder / option if "." in option else option for option in options]
    command = ("rectify", *views, "--calib", folder / "stereo.yml", "-o", folder / "out")
    code, out, err = msnet(*command, *named)
    assert (code, out) == (2, "")
    assert err.startswith("msnet: ") and err.count("\n") == 1
    assert message in err
    assert sorted(folder.rglob("*")) == before


def test_rectify_folders_and_videos(msnet, folder):
    write_rig(folder / "stereo.yml")
    rig = ("--rig", folder / "stereo.yml", "--unit", "mm")
    for side in ("left", "right"):
        (folder / "run" / side).mkdir(parents=True)
        view = cv2.imread(str(folder / f"{side}.png"))
        code = cv2.VideoWriter.fourcc(*"mp4v")
        video = cv2.VideoWriter(str(folder / f"{side}.mp4"), code, 10, view.shape[1::-1])
        for index in range(2):
            cv2.imwrite(str(folder / "run" / side / f"{index}.png"), view)
            video.write(view)
        video.release()
    assert (
        msnet("rectify", folder / "left.png", folder / "right.png", *rig, "-o", folder / "a")[0]
        == 0
    )
    single = cv2.imread(str(folder / "a" / "left.png"))
    views = folder / "run" / "left", folder / "run" / "right"
    code, out, err = msnet("rectify", *views, *rig, "-o", folder / "b")
    assert (code, err, len(out.splitlines())) == (0, "", 5)
    np.testing.assert_array_equal(cv2.imread(str(folder / "b/left/1.png")), single)
    calibration = read_calibration(folder / "b" / "calib.txt")
    assert calibration == read_calibration(folder / "a" / "calib.txt")
    (views[0] / "1.png").write_bytes(b"")
    code, out, err = msnet("rectify", *views, *rig, "-o", folder / "c")
    assert (code, len(out.splitlines())) == (1, 3)
    assert err.startswith("msnet: 1 skipped: ")


def test_rectify_pictures_with_both_views(msnet, folder):
    write_rig(folder / "stereo.yml")
    rig = ("--rig", folder / "stereo.yml", "--unit", "mm")
    views = [
        cv2.imread(str(folder / f"{side}.png")).astype(np.uint16) * 257
        for side in ("left", "right")
    ]
    (folder / "joined").mkdir()
    cv2.imwrite(str(folder / "joined/0.png"), np.concatenate(views, axis=1))
    assert msnet("rectify", folder / "joined/0.png", *rig, "-o", folder / "a")[0] == 0
    assert msnet("rectify", folder / "joined", *rig, "-o", folder / "b")[0] == 0
    for path in ("a/left.png", "b/left/0.png"):
        found = cv2.imread(str(folder / path), -1)
        assert (found.shape, found.dtype) == ((200, 320, 3), np.uint16)
    cv2.imwrite(str(folder / "joined/1.png"), views[0][:, :319])
    code, _, err = msnet("rectify", folder / "joined", *rig, "-o", folder / "c")
    assert code == 1
    assert "1 skipped: " in err and "319 px wide" in err


def test_rectify_looks_how_one_picture_has_both_views(msnet, folder):
    write_rig(folder / "stereo.yml")
    rig = ("--rig", folder / "stereo.yml", "--unit", "mm")
    paths = folder / "left.png", folder / "right.png"
    views = [cv2.imread(str(path)) for path in paths]
    assert msnet("rectify", *paths, *rig, "-o", folder / "a")[0] == 0
    expected = [cv2.imread(str(folder / "a" / path.name)) for path in paths]
    (folder / "stacked").mkdir()
    cv2.imwrite(str(folder / "stacked/0.png"), np.vstack(views))
    for source, options, told in (
        ("stacked/0.png", (), "one view above the other: it was split so"),
        ("stacked", ("--layout", "top-bottom"), ""),
    ):
        code, out, err = msnet("rectify", folder / source, *rig, *options, "-o", folder / "b")
        assert code == 0 and told in err and err.count("\n") == bool(told)
        found = [cv2.imread(path) for path in out.splitlines() if path.endswith("png")]
        np.testing.assert_array_equal(found[:2], expected)
    code, out, err = msnet("rectify", paths[0], *rig, "-o", folder / "c")
    assert (code, out) == (2, "") and "halves are not two views" in err
    assert not (folder / "c").exists()
    side_by_side = ("--layout", "side-by-side")
    _, _, err = msnet("rectify", folder / "left.png", *rig, *side_by_side, "-o", folder / "c")
    assert "halves are" not in err and "outside of its pictures of 160x200" in err


def test_doctor_looks_at_what_the_rig_rectifies(msnet, folder):
    write_rig(folder / "stereo.yml", T=np.array([-0.06, 0, 0]))
    views = folder / "left.png", folder / "right.png"
    _, out, _ = msnet("doctor", *views, "--rig", folder / "stereo.yml", "--json")
    levels = {finding["check"]: finding["level"] for finding in json.loads(out)}
    assert levels["rectified"] != "good"  # the pair was rectified before
