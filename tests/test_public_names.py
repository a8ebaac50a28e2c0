"""What `import mobilestereonet` gives, and that it is quick."""

import json
import subprocess
import sys

import pytest

import mobilestereonet

HEAVY = {"torch", "numpy", "cv2", "matplotlib", "lightning", "kornia", "skimage"}


def imported(code):
    """Names of the packages that a program has imported at its end."""
    code += "\nimport json, sys; print(json.dumps([n for n in sys.modules if '.' not in n]))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_public_names_exist():
    assert {"StereoMatcher", "create_model", "InputError"} <= set(mobilestereonet.__all__)
    for name in mobilestereonet.__all__:
        assert getattr(mobilestereonet, name).__name__ == name
    assert set(mobilestereonet.__all__) <= set(dir(mobilestereonet))
    with pytest.raises(AttributeError, match="load_wieghts"):
        mobilestereonet.load_wieghts  # noqa: B018


def test_heavy_packages_wait_for_their_use():
    assert not imported("import mobilestereonet.cli.main") & HEAVY


def test_inference_and_evaluation_need_no_extra():
    extras = {"lightning", "torchmetrics", "kornia", "tensorboard", "skimage", "matplotlib"}
    extras |= {"scipy", "onnx", "onnxruntime", "openvino", "huggingface_hub"}
    code = "\n".join(f"from mobilestereonet import {n}" for n in mobilestereonet.__all__)
    rooms = ("evaluation", "scenes", "export", "costs", "paper.tables", "paper.blocks", "streams")
    code += "".join(f"\nimport mobilestereonet.{room}" for room in rooms)
    assert not imported(code) & extras
