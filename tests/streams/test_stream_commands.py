"""The commands video and batch, as a user runs them."""

import re
import sys
import threading
from importlib import import_module

import cv2
import numpy as np
import pytest
from noise_pairs import centre, make_pair
from PIL import Image

from extras import need_extra
from mobilestereonet.cli.main import main
from mobilestereonet.engines.sgbm import StereoSGBM

video = import_module("mobilestereonet.cli.video")


@pytest.fixture
def msnet(monkeypatch, capfd):
    """Runs the command line; gives exit code, stdout and stderr."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["msnet", *map(str, arguments), "--model", "sgbm"])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code or 0, *capfd.readouterr()

    return run


def tree(folder):
    return {path: path.is_file() and path.read_bytes() for path in folder.rglob("*")}


def test_video_of_a_sequence_with_depth(msnet, sequence):
    maps = sequence / "maps"
    calibration = ("--focal", 100, "--baseline", 0.2)
    views = sequence / "left", sequence / "right"
    (sequence / "left" / "view_5.png").write_bytes(b"")
    code, out, err = msnet("video", *views, "--frames", maps, *calibration)
    assert code == 0
    assert re.fullmatch(
        rf"{maps}: 10 frames, \d+\.\d\d per second, sgbm on sgbm int16\n1 broken .* skipped\n", out
    )
    assert re.fullmatch(r"msnet: frame view_5 skipped: .*view_5.png: not an image.*\n", err)
    depth = cv2.imread(str(maps / "view_0_depth.png"), -1)
    assert np.median(centre(depth)) == pytest.approx(2000, rel=0.02)
    assert len(list(maps.iterdir())) == 20


def test_a_rate_chooses_the_network(monkeypatch, capfd, sequence):
    monkeypatch.setattr(
        "mobilestereonet.inference.rate.choose_quality",
        lambda pair, hz, open_level: (open_level("fast", 0.35), 0.5),
    )
    views = [str(sequence / "left"), str(sequence / "right")]
    arguments = ["video", *views, "--frames", str(sequence / "maps"), "--hz", "10"]
    monkeypatch.setattr(sys, "argv", ["msnet", *arguments, "--precision", "fp32"])
    with pytest.raises(SystemExit) as ended:
        main()
    out, _ = capfd.readouterr()
    assert not ended.value.code
    assert "at 0.35 of the size on torch fp32: 2.0 frames per second, the fastest here" in out
    assert len(list((sequence / "maps").iterdir())) == 11  # the first frame, too
    monkeypatch.setattr(sys, "argv", ["msnet", *arguments, "--quality", "fast"])
    with pytest.raises(SystemExit):
        main()
    assert "--hz 10 chooses the network" in capfd.readouterr().err


def test_ctrl_c_keeps_what_there_is_and_resume_goes_on(msnet, sequence, monkeypatch):
    # A real signal may end the process that runs the tests: the event is set as Ctrl-C sets it.
    calls, match, pressed = [], StereoSGBM.__call__, threading.Event()

    def counted(self, left, right, confidence=False):
        calls.append(1)
        if len(calls) == 3:
            pressed.set()
        return match(self, left, right, confidence)

    monkeypatch.setattr(StereoSGBM, "__call__", counted)
    monkeypatch.setattr(video, "Event", lambda: pressed)
    command = "video", sequence / "left", sequence / "right", "--frames", sequence / "maps"
    code, out, _ = msnet(*command)
    finished = len(list((sequence / "maps").iterdir()))
    assert code == 0
    assert f"{finished} frames" in out
    assert out.endswith("stopped; --resume goes on from here\n")
    assert 1 <= finished < 11
    pressed.clear()
    calls[:] = [1] * 5
    code, out, _ = msnet(*command, "--resume")
    assert (code, len(calls) - 5) == (0, 11 - finished)
    assert "11 frames" in out


def test_batch_skips_what_exists_and_counts_what_failed(msnet, sequence):
    command = "batch", sequence / "left", sequence / "right", "-o", sequence / "maps"
    (sequence / "left" / "view_5.png").write_bytes(b"")
    code, out, err = msnet(*command)
    assert (code, out) == (
        1,
        f"{sequence / 'maps'}: 10 pairs matched, 0 kept, 1 failed (sgbm on sgbm int16)\n",
    )
    assert re.fullmatch(r"msnet: view_5 skipped: [^:]*view_5.png: not an image.*\n", err)
    cv2.imwrite(str(sequence / "left" / "view_5.png"), make_pair(15, 5)[0][..., ::-1])
    before = tree(sequence)
    code, out, err = msnet(*command, "--skip-existing")
    assert (code, err) == (0, "")
    assert out == f"{sequence / 'maps'}: 1 pairs matched, 10 kept, 0 failed (sgbm on sgbm int16)\n"
    new = sequence / "maps" / "view_5_disparity.png"
    assert {**before, new: new.read_bytes()} == tree(sequence)
    assert np.median(centre(cv2.imread(str(new), -1) / 256)) == pytest.approx(15, abs=0.1)


@pytest.mark.parametrize("output", ["a.mp4", "new/../a.mp4"])
@pytest.mark.parametrize("sources", [("a.mp4",), ("b.mp4", "a.mp4"), ("file://a.mp4",)])
def test_a_video_does_not_replace_its_source(msnet, tmp_path, monkeypatch, sources, output):
    need_extra("av")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.mp4").write_bytes(b"precious")
    code, out, err = msnet("video", *sources, "-o", output)
    assert (code, out) == (2, "")
    assert err.startswith(f"msnet: {output}: this call reads it, and would write over it")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("video", "absent.mp4", "--frames", "new"), "absent.mp4: no such file, folder or"),
        (("video", "left/view_1.png", "--frames", "new"), "view_1.png: a picture, not a video: "),
        (
            ("video", "left/view_1.png", "right/view_1.png", "-o", "a.mp4"),
            "left/view_1.png: a picture, not a video: `msnet predict` matches one pair",
        ),
        (("video", "left", "absent", "--frames", "new"), "absent: no such file, folder or"),
        (("video", "left", "fewer", "--frames", "new"), "its right view .*view_9.png is missing"),
        (("video", "fewer", "right", "--frames", "new"), "10 left views, but 11 right ones"),
        (("video", "77", "--frames", "new"), "77: OpenCV cannot open this capture"),
        (("video", "file://text.avi", "--frames", "new"), "text.avi: OpenCV cannot open"),
        (("video", "left", "right", "--resume", "-o", "v.mp4"), "--resume needs --frames"),
        (
            ("video", "left", "right", "-o", "v.mp4", "--focal", "9", "--baseline", "1"),
            "depth needs --frames FOLDER, --bag or --rerun",
        ),
        (("video", "left", "right", "--frames", "new", "--beside"), "--beside needs --output"),
        (("video", "left", "right", "-o", "v.gif"), "v.gif: videos are written as .mp4"),
        (
            ("video", "left", "right", "--frames", "new", "--focal", "9"),
            "--focal needs --baseline METRES, too",
        ),
        (("video", "left", "right", "--frames", "text.avi/new"), "Not a directory"),
        (
            ("batch", "left/view_1.png", "right/view_1.png", "-o", "new"),
            "left/view_1.png: one image, not .* `msnet predict LEFT RIGHT`",
        ),
        (("batch", ".", "-o", "new"), "no sequences/.* or a folder of pictures that have both"),
        (("batch", "left", "fewer", "-o", "new"), "its right view .*view_9.png is missing"),
        (("batch", "left", "right", "-o", "new", "--write", "depth.png"), "depth needs --rig"),
        (
            ("batch", "left", "right", "-o", "new", "--write", "x.png"),
            "--write x.png: there are disparity.png",
        ),
        (("batch", "left", "right", "-o", "text.avi"), "text.avi/.*: cannot be written"),
    ],
)
def test_bad_input_ends_with_one_line_and_writes_nothing(
    msnet, sequence, monkeypatch, arguments, message
):
    monkeypatch.chdir(sequence)
    (sequence / "text.avi").write_text("no video\n")
    (sequence / "fewer").mkdir()
    for path in (sequence / "right").iterdir():
        (sequence / "fewer" / path.name).write_bytes(path.read_bytes())
    (sequence / "fewer" / "view_9.png").unlink()
    before = tree(sequence)
    code, out, err = msnet(*arguments)
    assert (code, out) == (2, "")
    assert re.fullmatch(rf"msnet: .*{message}.*\n", err)
    assert tree(sequence) == before


def swap(sequence):
    for name in ("left", "right"):
        (sequence / name).rename(sequence / f"{name}_")
    (sequence / "left_").rename(sequence / "right")
    (sequence / "right_").rename(sequence / "left")


@pytest.mark.parametrize("command", ["batch", "video"])
def test_the_first_look_holds_for_all_pairs(msnet, sequence, command):
    swap(sequence)
    maps = sequence / "maps"
    place = ("-o", maps) if command == "batch" else ("--frames", maps)
    code, _, err = msnet(command, sequence / "left", sequence / "right", *place)
    assert code == 0
    assert "order: " in err and "have been exchanged" in err
    for index in (0, 7):
        disparity = cv2.imread(str(maps / f"view_{index}_disparity.png"), -1) / 256
        assert np.median(centre(disparity)) == pytest.approx(10 + index, abs=0.2)


@pytest.fixture(params=["beside", "above", "mpo"])
def stills(request, tmp_path):
    """Folder of three pictures with both views each; pair i has disparity 10 + i."""
    folder = tmp_path / "stills"
    folder.mkdir()
    for index in range(3):
        left, right = make_pair(10 + index, index)
        if request.param == "mpo":
            views = [Image.fromarray(view) for view in (left, right)]
            path = folder / f"{index}.mpo"
            views[0].save(path, save_all=True, append_images=views[1:], quality=95)
        else:
            axis = int(request.param == "beside")
            joined = np.concatenate((left, right), axis)[..., ::-1]
            assert cv2.imwrite(str(folder / f"{index}.png"), joined)
    return folder


@pytest.mark.parametrize("command", ["batch", "video"])
def test_a_folder_of_pictures_with_both_views(msnet, stills, tmp_path, command):
    maps = tmp_path / "maps"
    code, _, err = msnet(command, stills, "-o" if command == "batch" else "--frames", maps)
    assert code == 0
    assert err.startswith("msnet: layout: the picture has one view above the other") or not err
    for index in range(3):
        disparity = cv2.imread(str(maps / f"{index}_disparity.png"), -1) / 256
        assert np.median(centre(disparity)) == pytest.approx(10 + index, abs=0.3)


@pytest.mark.parametrize("command", ["batch", "video"])
def test_left_views_alone_are_not_taken_for_pairs(msnet, tmp_path, command):
    noise = np.random.default_rng(0).integers(0, 256, (200, 640, 3), dtype=np.uint8)
    scene = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2), None, 0, 255, cv2.NORM_MINMAX)
    assert cv2.imwrite(str(tmp_path / "0.png"), scene)
    maps = tmp_path / "maps"
    place = ("-o" if command == "batch" else "--frames", maps)
    code, _, err = msnet(command, tmp_path, *place)
    assert code == 2
    assert err.startswith("msnet: 0: the picture's halves are not two views of one scene")
    assert "give the right view, too" in err
    assert not maps.exists()
    assert msnet(command, tmp_path, *place, "--layout", "side-by-side")[0] == 0


def test_an_odd_width_of_views_above_each_other(msnet, tmp_path):
    for index in range(2):
        views = [view[:, :159] for view in make_pair(10, index)]
        assert cv2.imwrite(str(tmp_path / f"{index}.png"), np.concatenate(views)[..., ::-1])
    for words in (("batch", "-o"), ("video", "--frames")):
        command, place = words
        maps = tmp_path / command
        code, _, _ = msnet(command, tmp_path, place, maps, "--layout", "top-bottom")
        assert code == 0
        assert len(list(maps.iterdir())) == 2


@pytest.mark.parametrize("command", ["batch", "video"])
def test_depth_of_views_that_cannot_give_it_is_refused(msnet, sequence, command):
    path = sequence / "right" / "view_0.png"
    assert cv2.imwrite(str(path), np.roll(cv2.imread(str(path)), 6, axis=0))
    maps = sequence / "maps"
    views = sequence / "left", sequence / "right"
    place = ("-o", maps, "--write", "depth.png") if command == "batch" else ("--frames", maps)
    depth = ("--focal", 100, "--baseline", 0.2)
    code, _, err = msnet(command, *views, *place, *depth)
    assert code == 2
    assert "rectified: " in err and "say --force" in err
    assert not any(maps.rglob("*"))
    code, _, _ = msnet(command, *views, *place, *depth, "--force")
    assert code == 0
    assert len(list(maps.iterdir())) == (11 if command == "batch" else 22)


def test_a_look_stops_only_what_writes_depth(msnet, sequence):
    need_extra("av")
    need_extra("rosbags")
    for path in (sequence / "right").iterdir():
        assert cv2.imwrite(str(path), np.roll(cv2.imread(str(path)), 6, axis=0))
    matrix = "[100 0 80; 0 100 24; 0 0 1]"
    (sequence / "calib.txt").write_text(f"cam0={matrix}\ncam1={matrix}\nbaseline=200\n")
    views, rig = (sequence / "left", sequence / "right"), ("--rig", sequence / "calib.txt")
    assert msnet("video", *views, "-o", sequence / "out.mp4", *rig)[0] == 0
    bag = ("-o", sequence / "maps", "--bag", sequence / "out.mcap")
    code, _, err = msnet("batch", *views, *bag, *rig)
    assert code == 2
    assert "say --force" in err
    assert msnet("batch", *views, *bag)[0] == 0


def test_an_output_that_is_a_folder_is_told_before_the_work(msnet, sequence):
    (sequence / "b.mcap").mkdir()
    views = sequence / "left", sequence / "right"
    code, _, err = msnet("batch", *views, "-o", sequence / "a", "--bag", sequence / "b.mcap")
    assert code == 2
    assert "b.mcap" in err
    assert not (sequence / "a").exists()
