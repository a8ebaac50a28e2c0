"""A page without a server: a folder to host anywhere, in which the browser matches pairs."""

from __future__ import annotations

import hashlib
import json
import shutil
from importlib.resources import as_file, files
from pathlib import Path
from uuid import uuid4

import cv2
import numpy as np

import mobilestereonet
from mobilestereonet.atomic import make_folder
from mobilestereonet.data.files import write_png
from mobilestereonet.data.images import to_picture
from mobilestereonet.data.motorcycle import motorcycle
from mobilestereonet.engines.tracing import Size
from mobilestereonet.errors import InputError
from mobilestereonet.export.export import Export, export_model
from mobilestereonet.nets.model import StereoModel
from mobilestereonet.nets.volume_model import VolumeModel
from mobilestereonet.plots import colour_disparity

PAGE_SIZE = (320, 448)
"""Height and width in px to which the page scales photos down: between 4:3 and 3:2."""

PACKAGES = {"onnxruntime-web": "1.30.0", "three": "0.187.0"}
"""npm's packages that the page needs, with the versions that it was tested with."""

_RUNTIME = (
    "onnxruntime-web/dist/ort.wasm.min.mjs",
    "onnxruntime-web/dist/ort-wasm-simd-threaded.mjs",
    "onnxruntime-web/dist/ort-wasm-simd-threaded.wasm",
    "onnxruntime-web/dist/ort.webgpu.min.mjs",
    "onnxruntime-web/dist/ort-wasm-simd-threaded.asyncify.mjs",
    "onnxruntime-web/dist/ort-wasm-simd-threaded.asyncify.wasm",
    "three/LICENSE",
    "three/build/three.core.js",
    "three/build/three.module.js",
    "three/examples/jsm/controls/OrbitControls.js",
)

_WRITTEN = {"runtime", "model.onnx", "page.json", "example-left.png", "example-right.png"}
"""What a page has beside its own assets and the runtime's files."""


def export_page(
    net: StereoModel,
    folder: str | Path,
    *,
    runtime: str | Path,
    model: str,
    embedded: bool = False,
    precision: str = "fp32",
    size: Size = PAGE_SIZE,
) -> Export:
    """Write a folder that any web server can host, with the network and all that it needs.

    Args:
        net: The network; one with scores is refined inside its file.
        folder: The folder; one that an earlier export wrote is replaced.
        runtime: npm's folder ``node_modules`` with `PACKAGES`. Nothing is taken from the network.
        model: Name of the network.
        embedded: Whether its weights are those that come with the package.
        precision: One of those of ``onnx``.
        size: Height and width to which photos are scaled down, multiples of the network's.

    Returns:
        How the network's file compares, see `export_model`.

    Raises:
        InputError: If the folder holds something else, a file of the runtime is missing, or see
            `export_model`. The folder is then as it was.
    """
    folder, runtime = Path(folder), Path(runtime)
    _check_replaceable(folder)
    for name in _RUNTIME:
        if not (runtime / name).is_file():
            packages = " ".join(f"{package}@{version}" for package, version in PACKAGES.items())
            raise InputError(
                f"{runtime} has no {name}: npm install {packages}, then --runtime-dir node_modules"
            )
    make_folder(folder.resolve().parent)
    new = folder.resolve().parent / f".{uuid4().hex[:12]}"
    try:
        with as_file(files(__package__).joinpath("page")) as page:
            shutil.copytree(page, new)
        _copy_runtime(runtime, new / "runtime")
        export = export_model(
            "onnx",
            net,
            new / "model.onnx",
            model=model,
            embedded=embedded,
            precision=precision,
            size=size,
            refine=isinstance(net, VolumeModel),
            fixed=True,
        )
        _write_settings(new, model, size)
        _name_cache(new)
        if folder.exists():
            shutil.rmtree(folder.resolve())
        new.rename(folder.resolve())
    finally:
        shutil.rmtree(new, ignore_errors=True)
    return export


def _check_replaceable(folder: Path) -> None:
    """Refuse a path that is something else than an empty folder or one that `export_page` wrote."""
    if not folder.exists():
        return
    foreign = ""
    if folder.is_dir():
        names = {path.relative_to(folder).as_posix() for path in folder.rglob("*")}
        assets = {path.name for path in files(__package__).joinpath("page").iterdir()}
        runtime = {f"runtime/{Path(name).name}" for name in _RUNTIME}
        foreign = min(names - assets - runtime - _WRITTEN, default="")
        if not foreign and (not names or "page.json" in names):
            return
    raise InputError(
        f"{folder} holds something else than such a page{foreign and f' ({foreign})'}: choose "
        "another folder"
    )


def _copy_runtime(runtime: Path, folder: Path) -> None:
    folder.mkdir()
    for name in _RUNTIME:
        target = folder / Path(name).name
        if target.name == "OrbitControls.js":
            # It names the package, for bundlers.
            text = (runtime / name).read_text("utf-8")
            target.write_text(text.replace("from 'three'", "from './three.module.js'"), "utf-8")
        else:
            shutil.copyfile(runtime / name, target)


def _write_settings(folder: Path, model: str, size: Size) -> None:
    """The example's views, scaled to the network's size, and what the page reads."""
    sample = motorcycle()
    calibration = sample.calibration
    assert calibration is not None
    height, width = sample.left.shape[-2:]
    scale = min(size[0] / height, size[1] / width, 1.0)
    scaled = (round(scale * width), round(scale * height))
    for name, view in (("left", sample.left), ("right", sample.right)):
        picture = cv2.resize(to_picture(view), scaled, interpolation=cv2.INTER_AREA)
        write_png(folder / f"example-{name}.png", picture)
    levels = np.arange(256, dtype=np.float32)[None] / 256
    settings = {
        "about": f"{model} of mobilestereonet {mobilestereonet.__version__}",
        "model": "model.onnx",
        "bytes": (folder / "model.onnx").stat().st_size,
        "height": size[0],
        "width": size[1],
        "colours": colour_disparity(levels, maximum=1.0).tobytes().hex(),
        "example": {
            "left": "example-left.png",
            "right": "example-right.png",
            "focal": round(calibration.focal * scale, 3),
            "baseline": calibration.baseline,
            "doffs": round(calibration.doffs * scale, 3),
        },
    }
    (folder / "page.json").write_text(json.dumps(settings, indent=1), "utf-8")


def _name_cache(folder: Path) -> None:
    """Name the service worker's cache by what is in the folder: new files, new cache."""
    digest = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        digest.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    worker = folder / "sw.js"
    text = worker.read_text("utf-8").replace("@DIGEST@", digest.hexdigest()[:16])
    worker.write_text(text, "utf-8")
