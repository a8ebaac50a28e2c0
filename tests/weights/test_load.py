"""What `load_model` takes a name for, and folders in the hub's layout."""

import json
import os
import re
import sys
from pathlib import Path

import pytest
import torch

from mobilestereonet import InputError, create_model, load_model, save_weights
from mobilestereonet.weights import card, save_pretrained
from mobilestereonet.weights.hub import model_page

SMALL = {"max_disparity": 32, "hourglasses": 1, "width": 8}


@pytest.fixture(scope="module")
def net():
    torch.manual_seed(0)
    return create_model("msnet2d", **SMALL)


def equal(one, other):
    own = one.state_dict()
    return all(own[name].equal(value) for name, value in other.state_dict().items())


def test_names_go_before_files_and_paths_reach_those(net, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_weights(net, tmp_path / "msnet2d.safetensors")
    (tmp_path / "msnet2d.safetensors").rename("msnet2d")
    (tmp_path / "org").mkdir()
    save_weights(net, tmp_path / "org" / "net.safetensors")
    (tmp_path / "org" / "net.safetensors").rename("org/net")
    assert load_model("msnet2d").max_disparity == 192
    for path in ("./msnet2d", Path("msnet2d"), tmp_path / "msnet2d"):
        assert load_model(path).max_disparity == 32
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)  # what is here asks no hub
    assert load_model("org/net").max_disparity == 32


def test_what_is_nowhere(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(InputError, match="unknown model 'msnet2': did you mean msnet2d"):
        load_model("msnet2")
    with pytest.raises(InputError, match="no weights of 'baseline2d' come with the package"):
        load_model("baseline2d")
    for path in (tmp_path / "no.safetensors", "runs/last.ckpt", "no.pth"):
        with pytest.raises(FileNotFoundError, match=rf"^{re.escape(str(path))}: no such file$"):
            load_model(path)
    for path in ("./org/net", tmp_path):
        with pytest.raises(FileNotFoundError, match=r"no weights|neither embedded weights \(msnet"):
            load_model(path)


def test_the_hub_is_an_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(InputError, match=r"org/net.*pip install \"mobilestereonet\[hub\]\""):
        load_model("org/net")


def test_a_model_on_the_hub(net, tmp_path, monkeypatch):
    hub = pytest.importorskip("huggingface_hub")
    save_pretrained(net, tmp_path)
    asked = []

    def snapshot(repository, *, revision, allow_patterns):
        asked.append((repository, revision))
        return str(tmp_path)

    monkeypatch.setattr(hub, "snapshot_download", snapshot)
    assert equal(load_model("org/net"), net)
    assert equal(load_model("org/net", revision="v2"), net)
    assert asked == [("org/net", None), ("org/net", "v2")]
    with pytest.raises(
        InputError,
        match=r"org/net: holds a variant of msnet2d \(.*width 8, not 48.*\), not msnet2d",
    ):
        load_model("org/net", model="msnet2d")
    with pytest.raises(InputError, match=r"revision='v2' is of the hub, and .* is here"):
        load_model(tmp_path, revision="v2")


def test_a_hub_out_of_reach_is_one_line(tmp_path, monkeypatch):
    pytest.importorskip("huggingface_hub")
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path))
    for revision, name in ((None, "org/net: no such file"), ("v2", "org/net at v2: no such file")):
        with pytest.raises(InputError, match=name) as caught:
            load_model("org/net", revision=revision)
        assert "\n" not in str(caught.value)


def test_a_folder_in_the_hubs_layout(net, tmp_path):
    folder = tmp_path / "new" / "folder"
    save_pretrained(net, folder, card=card("msnet2d"))
    names = {path.name for path in folder.iterdir()}
    assert names == {"README.md", "card.json", "config.json", "model.safetensors"}
    record = json.loads((folder / "config.json").read_text())
    assert record["model"] == "msnet2d"
    assert record["config"]["width"] == 8
    assert record["preprocessing"]["mean"] == [0.485, 0.456, 0.406]
    page = (folder / "README.md").read_text()
    for line in ("license: apache-2.0", "| Motorcycle (scikit-image) | 1.23 | 6.1 |"):
        assert line in page.splitlines()
    loaded = load_model(folder)
    assert loaded.config == net.config
    assert equal(loaded, net)
    assert not loaded.training
    (folder / "config.json").unlink()  # the weights say it, too
    assert load_model(folder).config == net.config
    for text in ("{", "[]", '{"model_type": "bert"}'):
        (folder / "config.json").write_text(text)
        with pytest.raises(InputError, match=r"config.json: no"):
            load_model(folder)
    (folder / "model.safetensors").unlink()
    with pytest.raises(
        FileNotFoundError, match=r"folder holds no weights: no model.safetensors or"
    ):
        load_model(folder)


def test_a_card_in_other_words_is_no_obstacle(net, tmp_path):
    words = {"training": "a night on a GPU", "metrics": {"pairs": [{"pair": "a", "error": 3}]}}
    save_pretrained(net, tmp_path, card=words)
    assert json.loads((tmp_path / "card.json").read_text()) == words
    assert "| pair |" not in (tmp_path / "README.md").read_text()


def test_a_folder_without_a_card_says_so(net, tmp_path):
    save_pretrained(net, tmp_path)
    assert "- Licence: not stated" in (tmp_path / "README.md").read_text().splitlines()
    assert not (tmp_path / "card.json").exists()


def test_the_folder_of_a_run(net, tmp_path):
    save_weights(net, tmp_path / "weights.safetensors", dtype=torch.float16)
    assert load_model(tmp_path).config == net.config


@pytest.mark.parametrize("name", ["msnet2d", "msnet3d"])
def test_the_hub_reads_the_figures_of_a_page(name):
    hub = pytest.importorskip("huggingface_hub")
    own = card(name)
    page = hub.ModelCard(model_page("msnet", own), ignore_metadata_errors=False)
    assert page.data.license == "apache-2.0"
    assert page.data.model_name == own["model"]
    results, rows = page.data.eval_results, own["metrics"]["pairs"]
    figures = {(each.dataset_name, each.metric_type): each.metric_value for each in results}
    assert len(figures) == 2 * len(rows)
    for row in rows:
        assert figures[row["pair"], "epe"] == row["epe_px"]
        assert figures[row["pair"], "d1"] == row["d1_percent"]


def test_a_pipe_is_no_weights_file(tmp_path):
    os.mkfifo(tmp_path / "a.ckpt")
    with pytest.raises(InputError, match=r"a\.ckpt is a device or a pipe"):
        load_model(tmp_path / "a.ckpt")
