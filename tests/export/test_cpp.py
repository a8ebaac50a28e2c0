"""The C++ example, compiled against OpenVINO's wheel, gives what Python gives."""

import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from extras import REQUIRED, need_extra
from mobilestereonet.data.disparity_files import read_disparity_png
from mobilestereonet.data.images import pad, unpad
from mobilestereonet.export import FORMATS, export_model
from mobilestereonet.nets import build_model

utils = need_extra("openvino.utils")
if shutil.which("cmake") is None and not REQUIRED:
    pytest.skip("CMake is not installed", allow_module_level=True)

pytestmark = pytest.mark.slow

SOURCE = Path(__file__).parents[2] / "examples" / "cpp"


def run(*words):
    return subprocess.run([*map(str, words)], capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    build = tmp_path_factory.mktemp("cpp")
    made = run("cmake", "-S", SOURCE, "-B", build, f"-DOpenVINO_DIR={utils.get_cmake_path()}")
    if "Could NOT find PNG" in made.stderr and not REQUIRED:
        pytest.skip("libpng's headers are not installed")
    assert made.returncode == 0, made.stderr
    made = run("cmake", "--build", build)
    assert made.returncode == 0, made.stdout + made.stderr
    assert "warning" not in made.stdout + made.stderr
    return build / "stereo"


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """A noisy pair of 70 x 45, shifted by 6 px, as files."""
    folder = tmp_path_factory.mktemp("pair")
    noise = np.random.default_rng(0).integers(0, 256, (45, 76, 3), dtype=np.uint8)
    paths = []
    for name, view in (("left", noise[:, :70]), ("right", noise[:, 6:])):
        paths.append(folder / f"{name}.png")
        assert cv2.imwrite(str(paths[-1]), cv2.GaussianBlur(view, (5, 5), 0))
    return paths


def test_the_program_gives_what_python_gives(program, pair, tmp_path):
    torch.manual_seed(0)
    net = build_model("msnet2d", max_disparity=32, hourglasses=1, width=8).eval()
    net.zero_residuals()
    model = tmp_path / "small.xml"
    export_model("openvino", net, model, model="small", size=(32, 64))
    disparity, confidence = tmp_path / "disparity.png", tmp_path / "confidence.png"
    done = run(program, model, *pair, disparity, confidence)
    assert (done.returncode, done.stderr) == (0, "")

    views = [cv2.imread(str(path))[..., ::-1] / np.float32(255) for path in pair]
    left, right = (torch.from_numpy(view.transpose(2, 0, 1)[None].copy()) for view in views)
    expected = FORMATS["openvino"].open(model)(pad(left, 48, 80), pad(right, 48, 80))
    expected = [unpad(map_, 45, 70)[0].numpy() for map_ in expected]
    found, known = read_disparity_png(disparity)
    assert found.shape == (45, 70) and known.all()
    np.testing.assert_allclose(found, expected[0], rtol=0, atol=1 / 512 + 1e-3)
    sure = cv2.imread(str(confidence), cv2.IMREAD_UNCHANGED) / 255
    np.testing.assert_allclose(sure, expected[1], rtol=0, atol=1 / 510 + 1e-3)


def test_bad_input_is_one_line(program, pair, tmp_path):
    left, right = pair
    assert run(program).returncode == 2
    for words, message in (
        ((tmp_path / "none.xml", left, right), "none.xml"),
        ((Path(__file__), left, right), "test_cpp.py"),
    ):
        done = run(program, *words, tmp_path / "out.png")
        assert done.returncode == 1 and message in done.stderr
    assert not list(tmp_path.iterdir())
