import subprocess
import sys

import mobilestereonet

PUBLIC = {
    "Calibration",
    "InputError",
    "NetConfig",
    "StereoMatcher",
    "StereoModel",
    "StereoNet",
    "StereoResult",
    "StereoSample",
    "create_model",
    "list_models",
    "load_model",
    "register_model",
    "save_weights",
}


def test_public_names():
    assert set(mobilestereonet.__all__) == PUBLIC
    for name in PUBLIC:
        assert getattr(mobilestereonet, name).__name__ == name
    assert set(dir(mobilestereonet)) >= PUBLIC | {"__version__"}
    assert not hasattr(mobilestereonet, "load_wieghts")


def test_heavy_packages_wait_for_their_use():
    code = (
        "import sys, mobilestereonet.cli.main; "
        "print(*({'torch', 'numpy', 'cv2', 'matplotlib', 'lightning'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
