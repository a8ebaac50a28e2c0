"""Bad inputs through every command: how many are refused, told, silently wrong, or worse.

    python benchmarks/bad_inputs.py [WORD ...]

Each case runs in this process, in a folder of its own with a small pair, and with a time limit.
WORD limits the cases to those whose command line holds it. Prints a table by kind of input and
every case that was not clean. A case is clean if it is refused in one line (exit code 2), or if it
says what is wrong beside its result; those marked as good must pass. A file that was there before
must be as it was, and none that is new may be cut off.
"""

from __future__ import annotations

import io
import json
import os
import pickle
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from safetensors.torch import save_file

from mobilestereonet import create_model
from mobilestereonet.cli.main import main
from mobilestereonet.data.files import is_whole, write_pfm, write_png
from mobilestereonet.weights import save_weights

LIMIT_S = 60
"""Seconds after which a case hangs."""

MEMORY_BYTES = 16 << 30
"""Address space of the trial: a bomb ends it, not the machine."""

PREDICT = "predict left.png right.png -o out --model sgbm"
CAMERA = "--focal 100 --baseline 0.1"
SCENES = "--set steps=1 --set batch_size=1 --set val_scenes=1 --set scenes.height=48 --set scenes."
SCENES += "width=64 --set scenes.max_disparity=20 --set augment.height=32 --set augment.width=48"

Make = Callable[[Path], object]


@dataclass(frozen=True)
class Case:
    """One bad input.

    Attributes:
        kind: What it is about, for the table.
        words: The command line.
        make: Makes the input in the folder in which the command is run.
        good: Whether it is to be taken: nothing is wrong with it.
        name: What tells cases of one command line apart.
    """

    kind: str
    words: list[str]
    make: Make = lambda folder: None
    good: bool = False
    name: str = ""


def png(width: int, height: int) -> bytes:
    """The beginning of a PNG whose header says a size."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"x" * 99))


def encoded(ending: str, *options: int) -> bytes:
    """A sound picture of the size of the pair."""
    noise = np.random.default_rng(0).integers(0, 255, (48, 96, 3), dtype=np.uint8)
    return cv2.imencode(ending, noise, options)[1].tobytes()


def huge_jpeg() -> bytes:
    """A JPEG whose header says 65,500 x 65,500."""
    content = bytearray(encoded(".jpg"))
    at = content.find(b"\xff\xc0")
    content[at + 5 : at + 9] = struct.pack(">HH", 65500, 65500)
    return bytes(content)


PICTURES: dict[str, bytes] = {
    "empty.png": b"",
    "text.png": b"hello",
    "cut.png": encoded(".png")[:-400],
    "checksum.png": encoded(".png")[:200] + b"\0\0\0\0" + encoded(".png")[204:],
    "huge.png": png(100_000, 100_000),
    "wide.png": png(2**31 - 1, 1),
    "nothing.png": png(0, 0),
    "cut.jpg": encoded(".jpg")[:2000],
    "hole.jpg": encoded(".jpg")[:3000] + encoded(".jpg")[4500:],
    "huge.jpg": huge_jpeg(),
    "cut.bmp": encoded(".bmp")[:500],
    "huge.bmp": b"BM"
    + struct.pack("<IIIIiiHHIIiiII", 99, 0, 54, 40, 60000, 60000, 1, 24, *[0] * 6),
    "huge.pgm": b"P5 99999 99999 255\n" + bytes(99),
    "maxval.pgm": b"P5 96 48 0\n" + bytes(96 * 48),
    "cut.ppm": b"P6 96 48 255\n" + bytes(500),
    "huge.pfm": b"Pf\n99999 99999\n-1\n" + bytes(99),
    "cut.tiff": encoded(".tiff")[:600],
    "cut.webp": encoded(".webp")[:300],
    "small.png": cv2.imencode(".png", np.zeros((1, 1, 3), np.uint8))[1].tobytes(),
    "other.png": cv2.imencode(".png", np.zeros((50, 96, 3), np.uint8))[1].tobytes(),
    "nan.tiff": cv2.imencode(".tiff", np.full((48, 96), np.nan, np.float32))[1].tobytes(),
    "range.tiff": cv2.imencode(".tiff", np.full((48, 96), 300.0, np.float32))[1].tobytes(),
    "gif.png": b"GIF89a" + bytes(50),
    "zip.png": b"PK\x03\x04" + bytes(50),
}

MIDDLEBURY = "cam0=[100 0 48; 0 100 24; 0 0 1]\ncam1=[100 0 48; 0 100 24; 0 0 1]\ndoffs=0\n"
MIDDLEBURY += "baseline=100\nwidth=96\nheight=48\n"
LAUGHS = "a0: &a0 [1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"a{n}: &a{n} [{','.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 10)
)
ENTITIES = "<!DOCTYPE a [<!ENTITY a0 'aaaaaaaaaa'>" + "".join(
    f"<!ENTITY a{n} '{f'&a{n - 1};' * 10}'>" for n in range(1, 9)
)

CALIBRATIONS: dict[str, str] = {
    "empty.txt": "",
    "words.txt": "hello world",
    "comments.yaml": "# nothing\n",
    "nul.txt": "\0" * 500,
    "twice.txt": MIDDLEBURY + "baseline=300\n",
    "twice-cam.txt": MIDDLEBURY + "cam0=[200 0 48; 0 200 24; 0 0 1]\n",
    **{
        f"{name}-{value[:5]}.txt": MIDDLEBURY.replace(old, f"{name}={value}")
        for name, old in (("baseline", "baseline=100"), ("doffs", "doffs=0"), ("width", "width=96"))
        for value in ("nan", "inf", "x", "", "[1 2]", "1e308", "9" * 400)
    },
    "baseline-0.txt": MIDDLEBURY.replace("baseline=100", "baseline=0"),
    "baseline-minus.txt": MIDDLEBURY.replace("baseline=100", "baseline=-100"),
    "focal-0.txt": MIDDLEBURY.replace("[100 0", "[0 0"),
    "focal-nan.txt": MIDDLEBURY.replace("[100 0", "[nan 0"),
    "short.txt": MIDDLEBURY.replace("; 0 0 1", ""),
    "size.txt": MIDDLEBURY.replace("96", "960"),
    "laughs.yaml": LAUGHS,
    "laughs-q.yaml": LAUGHS + "Q: *a9\n",
    "self.yaml": "P1: &a [*a]\nP2: *a\n",
    "deep.yaml": "P1: " + "[" * 500 + "]" * 500,
    "keys.yaml": "1: 2\nnull: 3\n? [1]\n: 4\n",
    "python.yaml": "P1: !!python/object/apply:os.system ['touch evil']\n",
    "dates.yaml": "P1: 2020-01-01\nP2: 2020-01-01\n",
    "text.yaml": "P1: {data: [a, b]}\nP2: 3\n",
    "null.yaml": "P1:\nP2:\n",
    "digits.yaml": f"P1: [{'9' * 5000}]\n",
    "deep.json": '{"P1": ' + "[" * 3000 + "]" * 3000 + "}",
    "twice.json": '{"P1": [1], "P1": [2]}',
    "cut.json": '{"P1": [1, 2',
    "list.json": "[1, 2, 3]",
    "cut.xml": '<?xml version="1.0"?><opencv_storage><P1>',
    "entities.xml": f'<?xml version="1.0"?>{ENTITIES}]><opencv_storage>&a8;</opencv_storage>',
    "cut.yml": "%YAML:1.0\n---\nP1: !!opencv-matrix\n   rows: 3\n   cols: 99999999\n   dt: d\n",
    "huge.yml": "%YAML:1.0\n---\nP1: !!opencv-matrix\n   rows: 99999\n   cols: 99999\n   dt: d\n"
    "   data: [ 1. ]\n",
    "kitti.txt": "P0: 1 2 3\nP1: 1 2 3\n",
}

NUMBERS = ("nan", "inf", "-inf", "-1", "0", "1e308", "1e-320", "x", "", "9" * 400)


def values() -> Iterator[Case]:
    """Options with numbers that are none, or make no sense."""
    for number in NUMBERS:
        depth = ["--depth", "d.npy"]
        for option, other in (("--focal", "--baseline"), ("--baseline", "--focal")):
            words = [*PREDICT.split(), *depth, other, "100" if other == "--focal" else "0.1"]
            yield Case("numbers", [*words, option, number])
        good = number == "0"
        words = [*PREDICT.split(), *depth, *CAMERA.split()]
        yield Case("numbers", [*words, "--doffs", number], good=number in ("0", "-1", "1e-320"))
        yield Case(
            "numbers", [*words, "--max-depth", number], good=number in ("inf", "1e308", NUMBERS[-1])
        )
        yield Case("numbers", [*words, "--min-confidence", number], good=good)
        for option in ("--threads", "--max-disparity"):
            yield Case("numbers", [*words, option, number])
    for text in (
        "--tile 1 1",
        "--tile -5 5",
        "--tile 0 0",
        "--device cuda:9999999999",
        "--device x",
    ):
        yield Case("numbers", [*PREDICT.split(), *text.split()])
    for text in ("--fps 0", "--fps nan", "--hz 0", "--hz nan", "--hz -1"):
        yield Case("numbers", f"video l r --frames maps {text}".split())
    for text in ("--height 0", "--height -16", "--width 17", "--width 99999999", "--height x"):
        yield Case("numbers", f"export pt2 -o a.pt2 {text}".split())
    for text in ("--size 0 0", "--size -1 5", "--size 17 33", "--repeats 0", "--threads 1000000"):
        yield Case("numbers", f"bench {text}".split())
    for text in ("--devices -1", "--devices 0", "--workers -1", "--num-nodes 0", "--max-time 3h"):
        yield Case("numbers", f"train run {SCENES} {text}".split())


def settings() -> Iterator[Case]:
    """Values of networks, recipes and scenes."""
    for value in (
        *("hourglasses=100000", "hourglasses=-1", "hourglasses=1.5", "hourglasses=x", "width=0"),
        *("max_disparity=-1", "max_disparity=1000000000", "max_disparity=17", "estimator=x"),
        *("estimator=", "estimator=null", "=3", "colour=red", "hourglasses=NaN", "planes=[1,2]"),
        *(f"hourglasses={'9' * 5000}", f"hourglasses={'[' * 5000}", "hourglasses={}"),
        *("width=1e9", "width=100000000", "expansion=1000000", "dims=4", "cost_volume=none"),
    ):
        yield Case("networks", ["cost", "--model", "msnet2d", "--set", f"net.{value}"])
        yield Case("networks", ["predict", *PAIR, "-o", "out", "--set", f"net.{value}"])
    for value in (
        *(
            "lr=NaN",
            "lr=0",
            "lr=-1",
            "lr=1e999",
            "lr=fast",
            f"lr={'9' * 5000}",
            "lr=[1]",
            "steps=0",
        ),
        *("batch_size=0", "batch_size=-1", "batch_size=1.5", "batch_size=1000000", "seed=-1"),
        *("seed=18446744073709551616", "steps=-5", "ema=1", "ema=NaN", "schedule=[]", "uses=0"),
        *("schedule=[[1,1],[0,1]]", "schedule=[[NaN,1]]", "optimizer=x", "loss=none", "data=x"),
        *("loss=absent.py:f", "model=absent.py:Net", "model=x", "net=3", "net.x=3", "scenes=3"),
        *("scenes.height=1", "scenes.height=10000000", "scenes.max_disparity=-1", "clip=-1"),
        *("scenes.kinds={}", "augment.height=1", "augment.height=10000000", "augment.patch=[9,1]"),
        *("augment.noise=NaN", "val_scenes=0", "pool=0", "duration=3x", "duration=-3s", "root=x"),
        *("textures=absent", "teacher=absent.ckpt", "weights=absent.ckpt", "cross_entropy=-1"),
    ):
        yield Case("recipes", ["train", "run", *SCENES.split(), "--set", value])
    for name, text in {
        "empty": "",
        "text": "hello",
        "list": "[]",
        "null": "null",
        "deep": '{"net": ' + "[" * 5000 + "]" * 5000 + "}",
        "twice": '{"steps": 1, "steps": 2}',
        "nan": '{"steps": 1, "lr": NaN}',
        "digits": '{"steps": ' + "9" * 5000 + "}",
        "unknown": '{"steps": 1, "colour": 3}',
        "code": '{"steps": 1, "model": "evil.py:Net"}',
        "latin": "\xff\xfe\x00",
    }.items():
        yield Case(
            "recipes",
            ["train", "run", "--recipe", "a/recipe.json"],
            lambda folder, text=text: _put(folder / "a/recipe.json", text.encode("latin-1")),
            name=name,
        )


PAIR = ("left.png", "right.png")


def pictures() -> Iterator[Case]:
    """Pictures that are damaged, huge or none."""
    for name, content in PICTURES.items():

        def put(folder: Path, name: str = name, content: bytes = content) -> None:
            _put(folder / name, content)

        yield Case("pictures", f"predict {name} right.png -o out --model sgbm".split(), put)
        yield Case("pictures", f"predict left.png {name} -o out --model sgbm".split(), put)
        yield Case("pictures", f"doctor {name} right.png".split(), put)
        yield Case("pictures", f"batch {name} right.png -o out --model sgbm".split(), put)
    for name, make in PLACES.items():
        yield Case("pictures", f"predict {name} right.png -o out --model sgbm".split(), make)
        yield Case("pictures", f"doctor left.png {name}".split(), make)


PLACES: dict[str, Make] = {
    "folder.png": lambda folder: (folder / "folder.png").mkdir(),
    "pipe.png": lambda folder: os.mkfifo(folder / "pipe.png"),
    "loop.png": lambda folder: (folder / "loop.png").symlink_to("loop.png"),
    "broken.png": lambda folder: (folder / "broken.png").symlink_to("absent.png"),
    "absent.png": lambda folder: None,
    "a\0b.png": lambda folder: None,
    "x" * 300: lambda folder: None,
    "/dev/zero": lambda folder: None,
}


def calibrations() -> Iterator[Case]:
    """Calibration files."""
    for name, text in CALIBRATIONS.items():

        def put(folder: Path, name: str = name, text: str = text) -> None:
            _put(folder / name, text.encode())

        predict = [*PREDICT.split(), "--depth", "d.npy", "--calib", name]
        yield Case("calibrations", predict, put)
        yield Case("calibrations", ["rectify", *PAIR, "-o", "out", "--calib", name], put)
    for name in ("pipe.png", "folder.png", "loop.png"):
        yield Case(
            "calibrations", [*PREDICT.split(), "--depth", "d.npy", "--calib", name], PLACES[name]
        )


def outputs() -> Iterator[Case]:
    """Places where nothing can, or must, be written."""
    depth = [*PREDICT.split(), *CAMERA.split(), "--depth"]
    for name in (
        "left.png",
        "./right.png",
        "out/left_disparity.png",
        "out/left_disparity.npy",
        ".",
    ):
        yield Case("outputs", [*depth, name])
    for name in (
        "pipe.npy",
        "folder.npy",
        "loop.npy",
        "left.png/a.npy",
        "x" * 300 + ".npy",
        "a.exr",
    ):
        yield Case("outputs", [*depth, name], _places(".npy"))
    yield Case("outputs", [*depth, "a.npy", "--depth", "../" + "{here}" + "/a.npy"])
    yield Case("outputs", [*depth, "link.npy"], _places(".npy"), good=True)
    yield Case("outputs", ["predict", *PAIR, "-o", "left.png", "--model", "sgbm"])
    yield Case("outputs", ["predict", *PAIR, "-o", "pipe.png", "--model", "sgbm"], _places(".png"))
    yield Case("outputs", ["predict", *PAIR, "-o", "/dev/null", "--model", "sgbm"])
    yield Case(
        "outputs", ["predict", *PAIR, "-o", "loop.png/a", "--model", "sgbm"], _places(".png")
    )
    yield Case("outputs", ["batch", "v/l", "v/r", "-o", "left.png", "--model", "sgbm"], _views)
    yield Case("outputs", ["demo", "-o", ".", "--model", "sgbm"])
    yield Case("outputs", ["demo", "-o", "left.png", "--model", "sgbm"])
    for name in ("folder.png", "pipe.png", "/dev/full", "loop.png", "absent\0.png"):
        yield Case(
            "outputs",
            ["data", "preview", "procedural", "--count", "1", "-o", name],
            _places(".png"),
        )
        yield Case("outputs", ["plot-run", "run", "-o", name], _run)
    for name in ("f.onnx", "f.xml", "f.pt2", "f.mlpackage", "left.png", "/dev/null"):
        kind = {"f.xml": "openvino", "f.pt2": "pt2", "f.mlpackage": "coreml"}.get(name, "onnx")
        yield Case(
            "outputs",
            ["export", kind, "-o", name],
            lambda folder, n=name: _put(folder / n / "kept", b"1") if n[0] == "f" else None,
        )
    for name in ("w.safetensors", "folder.safetensors", "pipe.safetensors", "a.bin"):
        yield Case("outputs", ["average", "w.safetensors", "w.safetensors", "-o", name], _weights)
    for name in ("left.png", "folder.json", "folder.csv", "pipe.csv", "v/l/a.png"):
        for option in ("--json", "--csv", "--per-pair"):
            words = "evaluate --data folder --root v --set left=l/*.png --set right=r/*.png --set "
            words += f"disparity=d/*.pfm --model sgbm {option} {name}"
            yield Case(
                "outputs",
                words.split(),
                lambda folder, n=name: (_views(folder), _places(Path(n).suffix)(folder)),
            )


def weights() -> Iterator[Case]:
    """Weights files and checkpoints."""
    made: dict[str, Make] = {
        "empty.safetensors": lambda f: _put(f / "empty.safetensors", b""),
        "text.safetensors": lambda f: _put(f / "text.safetensors", b"hello" * 9),
        "long.safetensors": lambda f: _put(f / "long.safetensors", b"\xff" * 99),
        "cut.safetensors": lambda f: (
            _weights(f),
            _put(f / "cut.safetensors", (f / "w.safetensors").read_bytes()[:9999]),
        ),
        "nan.safetensors": lambda f: _changed(f, "nan", lambda v: v * float("nan")),
        "int8.safetensors": lambda f: _changed(f, "int8", lambda v: v.to(torch.int8)),
        "zero.safetensors": lambda f: _changed(f, "zero", torch.zeros_like),
        "minus.safetensors": lambda f: _changed(f, "minus", lambda v: -v.abs() - 1),
        "empty.ckpt": lambda f: _put(f / "empty.ckpt", b""),
        "text.ckpt": lambda f: _put(f / "text.ckpt", b"hello"),
        "evil.ckpt": lambda f: _put(f / "evil.ckpt", pickle.dumps(Evil())),
        "list.ckpt": lambda f: torch.save([1, 2], f / "list.ckpt"),
        "none.ckpt": lambda f: torch.save(None, f / "none.ckpt"),
        "tensor.ckpt": lambda f: torch.save(torch.zeros(3), f / "tensor.ckpt"),
        "other.ckpt": lambda f: torch.save({"a": torch.zeros(3)}, f / "other.ckpt"),
        "numbers.ckpt": lambda f: torch.save({1: torch.zeros(3)}, f / "numbers.ckpt"),
        "empty.npz": lambda f: _put(f / "empty.npz", b""),
        "objects.npz": lambda f: np.savez(f / "objects.npz", a=np.array([{}], object)),
        "text.caffemodel": lambda f: _put(f / "text.caffemodel", b"hello"),
        "graph.t7": lambda f: _put(f / "graph.t7", b"hello"),
        "pipe.ckpt": lambda f: os.mkfifo(f / "pipe.ckpt"),
    }
    for config in (
        *(
            '{"width": 100000000}',
            '{"hourglasses": 100000}',
            "[",
            "[]",
            '{"a": NaN}',
            '{"a":1,"a":2}',
        ),
        *("[" * 5000, '{"max_disparity": 1e99}', '{"max_disparity": 19200000}', '{"dims": "x"}'),
    ):
        name = f"config{len(made)}.safetensors"
        made[name] = lambda f, n=name, c=config: save_file(
            {"a": torch.zeros(2)}, f / n, {"model": "msnet2d", "config": c}
        )
    for name, make in made.items():
        yield Case("weights", ["predict", *PAIR, "-o", "out", "--weights", name], make)
        if name.endswith("ckpt"):
            yield Case(
                "resuming",
                ["train", "run", "--resume"],
                lambda folder, n=name, m=make: _resume(folder, n, m),
                name=name,
            )
    yield Case("weights", ["predict", *PAIR, "-o", "out", "--model", "onnx:left.png"])
    yield Case("weights", ["predict", *PAIR, "-o", "out", "--model", "onnx:absent.onnx"])
    yield Case("weights", ["predict", *PAIR, "-o", "out", "--model", "\udcff"])


class Evil:
    """Writes a file when it is unpickled."""

    def __reduce__(self) -> tuple[object, tuple[str, str]]:
        return open, ("evil", "w")


def truths() -> Iterator[Case]:
    """Ground truth, logs, scores and videos."""
    header = "{'descr': '<f4', 'fortran_order': False, 'shape': (%s), }"
    arrays: dict[str, bytes] = {
        "empty": b"",
        "text": b"hello",
        "terabytes": _npy(header % "99999999, 99999999"),
        "minus": _npy(header % "-1, 96"),
        "syntax": _npy("{'descr': [" * 500),
        "words": _array(np.full((48, 96), "a")),
        "dates": _array(np.zeros((48, 96), "datetime64[s]")),
        "complex": _array(np.zeros((48, 96), complex)),
        "structures": _array(np.zeros((48, 96), [("a", "f4")])),
        "flat": _array(np.zeros(96, np.float32)),
        "size": _array(np.ones((5, 5), np.float32)),
        "unknown": _array(np.full((48, 96), np.nan, np.float32)),
        "zip": b"PK\x03\x04" + bytes(99),
        "cut": _array(np.ones((48, 96), np.float32))[:-9],
    }
    for ending, contents in (
        ("npy", arrays),
        (
            "pfm",
            {
                n: b"Pf\n96 48\n%s\n" % n.encode() + bytes(4 * 96 * 48)
                for n in ("0", "nan", "x", "1e99", "-1e-99")
            },
        ),
        ("png", {n: PICTURES[n] for n in ("cut.png", "huge.png", "text.png", "small.png")}),
    ):
        for name, content in contents.items():
            words = "evaluate --data folder --root v --set left=l/*.png --set right=r/*.png --set "
            words += f"disparity=d/*.{ending} --model sgbm"
            yield Case(
                "ground truth",
                words.split(),
                lambda folder, e=ending, c=content: (
                    _views(folder),
                    _put(folder / f"v/d/a.{e}", c),
                ),
                name=name,
            )
    for name, log in {
        "empty": b"",
        "words": b"step,loss\n1,many\n",
        "bytes": b"step,loss\n1,\xff\xfe\n",
        "dollar": b"step,$loss$,a$\n1,2,3\n",
        "steps": b"step,loss\nx,1\n",
        "columns": b"step,"
        + b",".join(b"c%d" % n for n in range(20_000))
        + b"\n"
        + b"1," * 20_000
        + b"1\n",
        "field": b"step,loss\n1," + b"9" * 200_000 + b"\n",
        "infinite": b"step,loss\n1,inf\n2,nan\n",
        "nul": b"step,loss\n1,\0\n",
        "no step": b"a,b\n1,2\n",
    }.items():
        yield Case(
            "logs",
            ["plot-run", "run"],
            lambda folder, b=log: _run(folder, b),
            name=name,
            good=name in ("dollar", "infinite"),
        )
    for name in (
        "text.mp4",
        "cut.mkv",
        "12:30.mp4",
        "absent.mp4",
        "99999999999999999999",
        "rtsp://127.0.0.1:1/x",
    ):
        yield Case(
            "videos",
            ["video", name, "--frames", "maps", "--model", "sgbm"],
            lambda folder, n=name: (
                _put(folder / n, b"\x1aE\xdf\xa3" + bytes(200))
                if "." in n and "/" not in n and "absent" not in n
                else None
            ),
        )


def sources() -> Iterator[Case]:
    """One view in place of two, calibrations of no camera, bags and tables of nothing."""
    for words in (
        "predict right.png -o out --model sgbm",
        "predict left.png -o out --model sgbm --layout top-bottom --rotate 45",
        "doctor left.png",
        "batch alone -o out --model sgbm",
        "video alone --frames out --model sgbm",
    ):
        yield Case(
            "sources",
            words.split(),
            lambda folder: (
                (folder / "alone").mkdir(),
                shutil.copy(folder / "left.png", folder / "alone/a.png"),
            ),
        )
    for name, text in {
        "wide": MIDDLEBURY.replace("100 0 48", "5 0 48").replace("0 100 24", "0 5 24"),
        "telephoto": MIDDLEBURY.replace("100 0 48", "9000 0 48").replace("0 100 24", "0 9000 24"),
        "corner": MIDDLEBURY.replace(" 48;", " 2;"),
        "squeezed": MIDDLEBURY.replace("0 100 24", "0 9000 24"),
        "double": MIDDLEBURY.replace(" 48;", " 96;").replace(" 24;", " 48;").partition("width")[0],
        "half": MIDDLEBURY.replace(" 48;", " 24;")
        .replace(" 24; 0", " 12; 0")
        .partition("width")[0],
    }.items():
        words = [*PREDICT.split(), "--depth", "d.npy", "--rig", f"{name}.txt"]
        yield Case(
            "sources", words, lambda folder, n=name, t=text: _put(folder / f"{n}.txt", t.encode())
        )
    for name, content in {"empty": b"", "text": b"hello", "magic": b"\x89MCAP0\r\n" * 2}.items():
        for ending in ("mcap", "bag", "db3"):
            for command in ("video", "rectify"):
                place = "--frames maps" if command == "video" else "-o out --rig absent.yml"
                words = f"{command} {name}.{ending} {place}".split()
                yield Case(
                    "bags",
                    words,
                    lambda folder, n=f"{name}.{ending}", c=content: _put(folder / n, c),
                )
    for words in (
        *(
            "live absent --model sgbm --show x",
            "live left.png right.png --hz 0",
            "web --rig left.png",
        ),
        *("compare sgbm absent.safetensors --data folder --root .", "compare sgbm"),
        *(
            "compare sgbm msnet4d --data folder --root .",
            "evaluate --data folder --root . --rig x.yml",
        ),
        "evaluate --data folder --root . --rig left.png --model sgbm",
    ):
        yield Case("commands", words.split())


def _npy(header: str) -> bytes:
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text) % 65536) + text


def _array(values: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, values)
    return file.getvalue()


def _put(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def _places(ending: str) -> Make:
    def make(folder: Path) -> None:
        (folder / f"folder{ending}").mkdir()
        (folder / f"folder{ending}" / "kept").write_text("mine")
        os.mkfifo(folder / f"pipe{ending}")
        (folder / f"loop{ending}").symlink_to(f"loop{ending}")
        (folder / f"link{ending}").symlink_to(f"new{ending}")

    return make


def _views(folder: Path) -> None:
    for side, name in zip("lr", PAIR, strict=True):
        (folder / "v" / side).mkdir(parents=True, exist_ok=True)
        shutil.copy(folder / name, folder / "v" / side / "a.png")
        shutil.copy(folder / name, folder / "v" / side / "a_disparity.png")
    (folder / "v/l/a_disparity.png").unlink()
    (folder / "v/r/a_disparity.png").unlink()
    (folder / "v/d").mkdir()
    write_pfm(folder / "v/d/a.pfm", np.full((48, 96), 4, np.float32))


def _run(folder: Path, log: bytes = b"step,loss\n1,2\n") -> None:
    _put(folder / "run/csv/version_0/metrics.csv", log)
    _places(".png")(folder)


def _weights(folder: Path) -> None:
    shutil.copy(_NETWORK, folder / "w.safetensors")
    _places(".safetensors")(folder)


def _changed(folder: Path, name: str, change: Callable[[torch.Tensor], torch.Tensor]) -> None:
    net = create_model("msnet2d", max_disparity=32)
    state = {
        key: change(value).contiguous() for key, value in net.state_dict().items() if value.ndim
    }
    config = json.dumps({"max_disparity": 32})
    save_file(state, folder / f"{name}.safetensors", {"model": "msnet2d", "config": config})


def _resume(folder: Path, name: str, make: Make) -> None:
    make(folder)
    (folder / "run").mkdir()
    (folder / name).rename(folder / "run/last.ckpt")
    (folder / "run/recipe.json").write_text('{"steps": 3, "model": "msnet2d"}')


_NETWORK = Path(tempfile.gettempdir()) / "bad_inputs.safetensors"


def run(case: Case, pair: Path) -> tuple[str, str]:
    """Run a case; what became of it, and what it said."""
    with tempfile.TemporaryDirectory() as name, chdir(name):
        folder = Path(name)
        for side in PAIR:
            shutil.copy(pair / side, folder / side)
        case.make(folder)
        before = _state(folder)
        out, err, code = io.StringIO(), io.StringIO(), 0
        sys.argv = ["msnet", *(word.replace("{here}", folder.name) for word in case.words)]
        signal.signal(signal.SIGALRM, _hang)
        signal.alarm(LIMIT_S)
        try:
            with redirect_stdout(out), redirect_stderr(err), warnings.catch_warnings():
                main()
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 1
        except _Hang:
            return "hangs", ""
        except BaseException as error:  # what main lets through
            return "tracebacks", repr(error)
        finally:
            signal.alarm(0)
        said = err.getvalue().strip()
        after = _state(folder)
        lost = [path for path, state in before.items() if after.get(path) != state]
        new = [path for path in after if path not in before and path.is_file()]
        if lost or any(path.name.startswith(".") or not is_whole(path) for path in new):
            return "half-written or lost", f"{lost} {said}"
        if code == 70 or "Traceback" in said or (folder / "evil").exists():
            return "tracebacks", said
        if case.good:
            return ("taken" if code == 0 else "refused wrongly"), said
        if code:
            return "refused", said
        return ("told" if "msnet:" in said else "silently wrong"), said


class _Hang(BaseException):
    """Nothing that the command line would take for an error of its own."""


def _hang(*_: object) -> None:
    raise _Hang


def _state(folder: Path) -> dict[Path, object]:
    """Content of each file, target of each link; of links that lead nowhere nothing else."""
    return {
        path: path.readlink() if path.is_symlink() else path.is_file() and path.read_bytes()
        for path in folder.rglob("*")
        if "tensorboard" not in path.parts
    }


OUTCOMES = ("refused", "told", "taken", "refused wrongly", "silently wrong", "tracebacks", "hangs")
OUTCOMES += ("half-written or lost",)


def main_() -> None:
    """Run all cases."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    save_weights(create_model("msnet2d", max_disparity=32), _NETWORK)
    made = (pictures(), calibrations(), outputs(), weights(), truths(), settings(), values())
    made += (sources(),)
    cases = [case for cases in made for case in cases]
    wanted = sys.argv[1:]
    cases = [case for case in cases if all(word in f"{case.kind} {case.words}" for word in wanted)]
    counts: dict[str, Counter[str]] = {}
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        pair = Path(name)
        noise = np.random.default_rng(0).integers(0, 255, (48, 104, 3), dtype=np.uint8)
        write_png(pair / PAIR[0], np.ascontiguousarray(noise[:, :96]))
        write_png(pair / PAIR[1], np.ascontiguousarray(noise[:, 4:100]))
        for case in cases:
            outcome, said = run(case, pair)
            counts.setdefault(case.kind, Counter())[outcome] += 1
            if outcome in OUTCOMES[3:]:
                words = " ".join(
                    word if len(word) < 60 else word[:57] + "..." for word in case.words
                )
                print(f"{outcome}: msnet {words!r} {case.name}: {said[-300:]}", flush=True)
    table = Table("kind", *OUTCOMES, title=f"{len(cases)} bad inputs")
    counts["all"] = sum(counts.values(), Counter())
    for kind, found in counts.items():
        table.add_row(kind, *(str(found[outcome]) for outcome in OUTCOMES))
    Console(width=140).print(table)
    print(f"{time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main_()
