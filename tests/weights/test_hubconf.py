import subprocess
import sys
from pathlib import Path

import torch

from mobilestereonet import load_model

REPOSITORY = str(Path(__file__).parents[2])


def test_torch_hub_loads_the_networks():
    net = torch.hub.load(REPOSITORY, "msnet2d", source="local")
    assert net.config == load_model("msnet2d").config
    assert net.heads[3].score.weight.equal(load_model("msnet2d").heads[3].score.weight)
    fresh = torch.hub.load(
        REPOSITORY, "msnet3d", source="local", pretrained=False, max_disparity=64
    )
    assert fresh.training
    assert fresh.max_disparity == 64


def test_torch_hub_does_not_need_the_package_installed(tmp_path):
    code = (
        "import sys, torch; sys.path[:] = [p for p in sys.path if not p.endswith('/src')]\n"
        f"torch.hub.load({REPOSITORY!r}, 'msnet2d', source='local', pretrained=False)\n"
        "import mobilestereonet; print(mobilestereonet.__file__)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip().startswith(REPOSITORY)
