"""Outputs: whole files or none; never over an input, a folder, a device or another output."""

import os
import stat
from pathlib import Path

import numpy as np
import pytest

from mobilestereonet.atomic import (
    check_outputs,
    note_inputs,
    one_call,
    unused_path,
    write_atomically,
    write_text,
)
from mobilestereonet.data.calibration import write_calibration
from mobilestereonet.data.files import is_whole, read_bytes, write_npy, write_pfm, write_png
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError

GREY = np.arange(12, dtype=np.uint8).reshape(3, 4)


def write(path, text="new"):
    write_atomically(path, lambda temporary: temporary.write_text(text))


def test_a_link_stays_and_its_target_is_written(tmp_path):
    target, link = tmp_path / "target.txt", tmp_path / "folder" / "link.txt"
    link.parent.mkdir()
    link.symlink_to(target)
    for text in ("made", "replaced"):
        write(link, text)
        assert link.is_symlink()
        assert target.read_text() == text
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["folder", "link.txt", "target.txt"]


def test_devices_pipes_folders_and_loops_are_refused_and_stay(tmp_path):
    pipe, loop, folder = tmp_path / "pipe", tmp_path / "loop", tmp_path / "folder"
    os.mkfifo(pipe)
    loop.symlink_to(loop)
    folder.mkdir()
    for path, told in (
        (pipe, "is a device or a pipe, and stays"),
        (os.devnull, "is a device or a pipe, and stays"),
        (folder, "is a folder"),
        (loop, "cannot be written"),
        (tmp_path / "a\0b", "cannot be written"),
        (tmp_path / ("x" * 300), "cannot be written"),
    ):
        with pytest.raises(InputError, match=told):
            write(path)
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert stat.S_ISCHR(Path(os.devnull).stat().st_mode)


def test_what_fails_leaves_the_file_as_it_was(tmp_path):
    path = tmp_path / "map.txt"
    path.write_text("old")

    def fail(temporary):
        temporary.write_text("half")
        raise OSError(28, "No space left on device", str(temporary))

    with pytest.raises(OSError, match=r"map\.txt"):
        write_atomically(path, fail)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_long_names_and_modes_are_kept(tmp_path):
    path = tmp_path / ("x" * 251 + ".txt")
    write(path)
    path.chmod(0o640)
    write(path, "again")
    assert path.read_text() == "again"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_inputs_of_a_call_are_not_written_over(tmp_path):
    picture, hard, soft = tmp_path / "left.png", tmp_path / "hard.png", tmp_path / "soft.png"
    write_png(picture, GREY)
    hard.hardlink_to(picture)
    soft.symlink_to(picture)
    before = picture.read_bytes()
    with one_call():
        read_bytes(picture)
        for path in (picture, hard, soft):
            with pytest.raises(InputError, match="this call reads it"):
                write_png(path, GREY + 1)
        with pytest.raises(InputError, match="this call reads it"):
            check_outputs(tmp_path / "other.png", soft)
        write_png(tmp_path / "other.png", GREY)
    assert picture.read_bytes() == before
    note_inputs(picture)  # outside of a call nothing is protected
    write_png(picture, GREY + 1)


def test_two_outputs_are_two_files(tmp_path):
    (tmp_path / "link.npy").symlink_to(tmp_path / "a.npy")
    with pytest.raises(InputError, match=r"one file for two outputs: .*a\.npy, twice"):
        check_outputs(tmp_path / "a.npy", tmp_path / "b.npy", tmp_path / "a.npy")
    for other in ("link.npy", "folder/../a.npy"):
        with pytest.raises(InputError, match="one file for two outputs"):
            check_outputs(tmp_path / "a.npy", tmp_path / other)
    check_outputs(tmp_path / "a.npy", tmp_path / "b.npy")


def test_text_with_bytes_that_are_none(tmp_path):
    odd = os.fsdecode(b"a\xff")
    write_text(tmp_path / "a.json", f'"{odd} \u00fc"')
    assert (tmp_path / "a.json").read_text("utf-8") == '"a\\udcff \u00fc"'


@pytest.mark.parametrize("ending", ["png", "pfm", "npy", "tiff"])
def test_what_is_cut_off_is_not_whole(tmp_path, ending):
    path = tmp_path / f"map.{ending}"
    if ending == "png":
        write_png(path, GREY)
    elif ending == "npy":
        write_npy(path, GREY)
    else:
        write_pfm(path, GREY)
    assert is_whole(path)
    content = path.read_bytes()
    for cut in (0,) if ending == "tiff" else (0, 1, 20, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:cut])
        assert not is_whole(path)
    path.unlink()
    assert not is_whole(path)
    assert not is_whole(tmp_path)


def test_commands_write_over_no_input(msnet, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    for name in ("left.png", "right.png", "left_disparity.png"):
        write_png(tmp_path / name, rng.integers(0, 255, (32, 64, 3), dtype=np.uint8))
    folder = tmp_path / "0" / "left"
    folder.mkdir(parents=True)
    for name in ("a.png", "a_disparity.png"):
        write_png(folder / name, GREY)
    calibration = Calibration(100.0, 0.1, cx=32.0, cy=16.0)
    (tmp_path / "cameras").mkdir()
    for path in (tmp_path / "calib.txt", tmp_path / "cameras/calib.txt"):
        write_calibration(path, calibration, (64, 32))
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*")}
    options = ("--model", "sgbm", "--focal", "100", "--baseline", "1")
    for words in (
        "predict left.png right.png -o out --depth left.png",
        "predict left_disparity.png right.png -o . --depth ./right.png",
        "predict left.png left_disparity.png -o . --depth a.npy",
        "predict left.png right.png -o o --depth a.npy --depth ./a.npy",
        "predict left.png right.png -o o --depth o/left_disparity.png",
        "batch 0/left 0/left/*.png -o 0/left",
        "demo -o .",
        "rectify left.png right.png --calib calib.txt -o .",
        "rectify left.png right.png --calib cameras/calib.txt -o .",
    ):
        command = words.split()
        command += options[: {"demo": 2, "rectify": 0}.get(command[0], 6)]
        code, _, err = msnet(*command)
        assert code == 2, command
        assert "choose another" in err, command
        assert err.count("\n") == 1
    assert {path: path.read_bytes() for path in tmp_path.rglob("*.*")} == before


def test_two_files_of_one_ending_are_both_listed(msnet, tmp_path):
    left, right = tmp_path / "left.png", tmp_path / "right.png"
    for view in (left, right):
        write_png(view, np.random.default_rng(0).integers(0, 255, (32, 64), dtype=np.uint8))
    files = [tmp_path / name for name in ("a.npy", "b.npy", "c.png")]
    depth = [word for file in files for word in ("--depth", file)]
    options = ("--model", "sgbm", "--focal", 100, "--baseline", 1, "--force", *depth)
    code, out, _ = msnet("predict", left, right, "-o", tmp_path, *options)
    assert code == 0
    assert all(str(file) in out.splitlines() for file in files)


def test_a_default_is_a_name_where_nothing_is_yet(tmp_path, monkeypatch, msnet):
    monkeypatch.chdir(tmp_path)
    for name in ("average.safetensors", "average-2.safetensors"):
        Path(name).touch()
    Path("average-3.safetensors").symlink_to("absent")
    assert unused_path(Path("average.safetensors")) == Path("average-4.safetensors")
    for name in ("left.png", "right.png"):
        write_png(name, np.random.default_rng(0).integers(0, 255, (24, 40), dtype=np.uint8))
    for folder in ("out", "out-2"):
        code, out, _ = msnet("predict", "left.png", "right.png", "--model", "sgbm")
        assert code == 0
        assert str(Path(folder, "left_disparity.png")) in out.splitlines()
