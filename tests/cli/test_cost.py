"""``msnet cost``."""

import json

import pytest


def test_json(msnet):
    size = ("--height", 32, "--width", 64)
    network = ("--model", "msnet2d", "--set", "net.max_disparity=64")
    code, out, err = msnet("cost", "--json", *network, *size)
    assert not code, err
    facts = json.loads(out)
    assert facts["model"] == "msnet2d"
    assert facts["config"]["max_disparity"] == 64
    parts = ["features", "reduction", "volume", "pre_hourglass", "hourglasses", "heads"]
    assert list(facts["parts"]) == parts
    for key in ("macs", "paper_macs", "params", "paper_params"):
        assert facts["total"][key] == sum(part[key] for part in facts["parts"].values())
    # 16 planes instead of 48: heads of 48 -> 48 -> 16 channels.
    assert facts["parts"]["heads"]["macs"] == 128 * 9 * 48 * (48 + 16)


MY_NET = """
from dataclasses import dataclass
import torch
from torch import nn
from mobilestereonet.nets import Prediction, StereoModel

@dataclass(frozen=True)
class Config:
    max_disparity: int = 64
    channels: int = 4

class MyNet(StereoModel):
    config: Config
    size_multiple = 8

    def __init__(self, config):
        super().__init__(config)
        self.encoder = nn.Conv2d(6, config.channels, 3, padding=1)
        self.decoder = nn.Conv2d(config.channels, 1, 1, bias=False)
        self.offset = nn.Parameter(torch.zeros(1))

    def forward(self, left, right):
        x = self.decoder(self.encoder(torch.cat((left, right), dim=1)))
        return Prediction(x[:, 0] + self.offset)
"""


def test_a_network_of_the_users_own(msnet, tmp_path):
    path = tmp_path / "my_net.py"
    path.write_text(MY_NET)
    arguments = ("--set", "net.channels=2", "--height", 8, "--width", 16, "--json")
    code, out, err = msnet("cost", "--model", f"{path}:MyNet", *arguments)
    assert not code, err
    facts = json.loads(out)
    pixels = 8 * 16
    assert facts["parts"] == {
        "encoder": {
            "macs": pixels * 9 * 6 * 2,
            "paper_macs": pixels * (9 * 6 * 2 + 2),
            "params": 9 * 6 * 2 + 2,
            "paper_params": 9 * 6 * 2 + 2,
        },
        "decoder": {"macs": pixels * 2, "paper_macs": pixels * 2, "params": 2, "paper_params": 2},
        "offset": {"macs": 0, "paper_macs": 0, "params": 1, "paper_params": 1},
    }


def test_paper_json(msnet):
    _, out, _ = msnet("cost", "--paper", "--json")
    records = json.loads(out)
    assert len(records) >= 74
    assert {record["table"] for record in records} == {
        "Table 3a",
        "Table 3b",
        "Appendix 2D",
        "Appendix 3D",
        "Modules",
        "Table 4a",
        "Table 4b",
        "Table 5",
        "Table 6",
    }
    assert all(set(r) == {"table", "row", "what", "counted", "printed"} for r in records)
    final = {r["what"]: r["counted"] for r in records if r["row"] == "3D-MobileStereoNet"}
    assert final == pytest.approx({"macs": 153.141, "params": 1.770}, abs=0.001)


def test_what_the_embedded_weights_have_besides_is_said(msnet):
    texts = ['estimator="mode"', "coarse_pass=true", "coarse_levels=2"]
    options = [f"--set net.{text}" for text in texts]
    said = f"the embedded weights have {', '.join(texts)}: add {' '.join(options)} to count that\n"
    size = ("--model", "msnet3d", "--height", 32, "--width", 64)
    _, out, _ = msnet("cost", *size)
    assert "msnet3d, two views of 3 x 32 x 64" in out
    assert out.endswith(said)
    first, second = (("--set", f"net.{text}") for text in texts[1:])
    assert "coarse_levels=2: add" in msnet("cost", *size, *first)[1]
    # With all of them, or without weights like that; the last size is none for two passes.
    for arguments in ((*first, *second), ("--model", "msnet2d"), ("--json",), ("--height", 48)):
        code, out, _ = msnet("cost", *size, *arguments)
        assert code == 0 and "embedded" not in out


def test_tables(msnet, tmp_path):
    assert "30.327" in msnet("cost", "--model", "table3a-v1-v2")[1]
    _, out, _ = msnet("cost", "--paper", "--plot", tmp_path / "curve.png")
    assert (tmp_path / "curve.png").is_file()
    for text in ("18.99", "table2-interlaced-16", "182.951 !", "misprint of 2.23", "7.99", "8.88"):
        assert text in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--model", "nonet"), "nonet"),
        (("--set", "net.colour=1"), "networks have no value 'colour': `msnet models NAME` shows"),
        (("--set", "width=16"), "--set width=16: write it as net.width=16"),
        (("--set", "net.width=wide"), "width must be a whole number"),
        (("--set", "net.v2_skip=2"), "v2_skip must be true or false"),
        (("--set", "net.features=v3"), "features must be one of conv, v1, v2"),
        (("--height", 100), "got 100"),
        (("--plot", "curve.png"), "--paper"),
        (("--model", "msnet2d", "--paper"), "--paper"),
    ],
)
def test_refuses(msnet, arguments, message):
    code, _, err = msnet("cost", *arguments)
    assert code == 2
    assert message in err
