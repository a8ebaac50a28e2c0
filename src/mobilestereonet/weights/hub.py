"""The Hugging Face Hub's layout of a model: a folder to write, to read and to download."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml  # type: ignore[import-untyped]

from mobilestereonet.atomic import write_text
from mobilestereonet.errors import InputError
from mobilestereonet.nets import StereoModel
from mobilestereonet.weights.files import model_reference, save_weights, write_json

_TASK = "depth-estimation"
_FIGURES = ("epe_px", "d1_percent")


def download(repository: str, revision: str | None) -> Path:
    """Folder of a model on the hub, from the hub's own cache where it is there already.

    Args:
        repository: "organisation/name".
        revision: Branch, tag or commit; None takes the main branch.

    Raises:
        InputError: If the extra ``hub`` is not installed, or the hub cannot be reached or has no
            such model.
    """
    try:
        from huggingface_hub import snapshot_download
    except ImportError:
        raise InputError(
            f"{repository}: no such file or folder here; to read it from the Hugging Face Hub, "
            'pip install "mobilestereonet[hub]"'
        ) from None
    try:
        folder = snapshot_download(
            repository, revision=revision, allow_patterns=["*.json", "*.safetensors", "*.md"]
        )
    except Exception as error:  # of its own, of its HTTP client, of the network
        at = f" at {revision}" if revision else ""
        reason = str(error).strip().split("\n")[0] or type(error).__name__
        raise InputError(
            f"{repository}{at}: no such file or folder here, and not read from the Hugging Face "
            f"Hub: {reason}"
        ) from error
    return Path(folder)


def save_pretrained(
    net: StereoModel, folder: str | Path, *, card: dict[str, Any] | None = None
) -> None:
    """Write a network as a folder in the Hugging Face Hub's layout, which `load_model` reads.

    Args:
        net: The network, of any architecture.
        folder: Gets ``config.json``, ``model.safetensors`` and ``README.md``; made if need be.
        card: The weights' card as `save_weights` takes it, such as ``card("msnet2d")``: it goes
            into ``README.md`` in words, and whole into ``card.json``.

    Raises:
        InputError: If a weight is not finite.
    """
    folder = Path(folder)
    save_weights(net, folder / "model.safetensors")
    model = model_reference(net)
    record = {"model": model, "config": asdict(net.config)}
    write_json(folder / "config.json", record | {"preprocessing": asdict(net.preprocessing)})
    if card is not None:
        write_json(folder / "card.json", card)
    write_text(folder / "README.md", model_page(model, card or {}))


def model_page(model: str, card: dict[str, Any]) -> str:
    """A model card as a page, with the head that the hub reads; figures in its ``model-index``."""
    licence, name = card.get("licence"), str(card.get("model", model))
    training, metrics = (_part(card, key) for key in ("training", "metrics"))
    rows = [row for row in metrics.get("pairs", ()) if {"pair", *_FIGURES} <= row.keys()]
    head: dict[str, Any] = {"library_name": "mobilestereonet", "pipeline_tag": _TASK}
    head |= {"license": licence.lower()} if licence else {}
    head |= {"tags": ["stereo-matching"]}
    head |= {"model-index": [{"name": name, "results": [_result(r) for r in rows]}]} if rows else {}
    lines = ["---", yaml.safe_dump(head, sort_keys=False, allow_unicode=True) + "---", f"# {name}"]
    lines += ["", f"Stereo matching network `{model}` of the Python package mobilestereonet.", ""]
    lines += ["```python", "from mobilestereonet import StereoMatcher", ""]
    lines += ['matcher = StereoMatcher.from_pretrained("path/to/this/folder")', "```", ""]
    lines += [f"- Licence: {licence or 'not stated'}"]
    lines += [f"- Version: {card['version']}, {card['date']}"] if "version" in card else []
    lines += [f"- Trained on: {training['data']}"] if "data" in training else []
    lines += [f"- Training: {training['steps']} steps"] if "steps" in training else []
    if rows:
        lines += ["", f"Accuracy ({metrics.get('protocol', 'protocol not stated')}):", ""]
        lines += ["| pair | EPE, px | D1, % |", "| --- | --- | --- |"]
        lines += ["| {pair} | {epe_px} | {d1_percent} |".format(**row) for row in rows]
    return "\n".join(lines) + "\n"


def _result(row: dict[str, Any]) -> dict[str, Any]:
    """The figures of one pair or set as an entry of the hub's ``model-index``."""
    kind = re.sub(r"[^a-z0-9]+", "-", row["pair"].lower()).strip("-")
    return {
        "task": {"type": _TASK, "name": "stereo matching"},
        "dataset": {"type": kind, "name": row["pair"]},
        "metrics": [
            {"type": "epe", "value": row["epe_px"], "name": "EPE, px"},
            {"type": "d1", "value": row["d1_percent"], "name": "D1, %"},
        ],
    }


def _part(card: dict[str, Any], key: str) -> dict[str, Any]:
    part = card.get(key)
    return part if isinstance(part, dict) else {}
