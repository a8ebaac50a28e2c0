"""``msnet models``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from mobilestereonet.cli.early import ABLATIONS, check_network
from mobilestereonet.cli.sources import networks
from mobilestereonet.errors import InputError

if TYPE_CHECKING:
    from mobilestereonet.nets import ModelInfo


def models(
    name: Annotated[
        str | None,
        typer.Argument(
            help="A network or a version of its weights to describe, or a pattern.",
            autocompletion=networks,
        ),
    ] = None,
) -> None:
    """List the networks, or describe one of them and its weights.

    Those with weights in the package come first. A pattern such as 'table3b-*' lists what matches
    it.
    """
    is_name = name is not None and not any(sign in name for sign in "*?[")
    if name is not None and is_name:
        check_network("models", name if ".py:" in name else name.partition(".")[0])

    from mobilestereonet.nets import list_models, model_info

    if name is not None and is_name:
        model = name.partition(".")[0] if name.partition(".")[0] in list_models() else name
        _describe(name, model_info(model))
        return
    names = list_models(name or "*")
    if not names:
        raise InputError(f"no network's name matches {name}: `msnet models` lists all")
    rows = {row for pattern in ABLATIONS for row in list_models(pattern)} if name is None else ()
    _list([found for found in names if found not in rows])
    if rows:
        print("rows of the paper's tables (parameters: msnet models 'table*'):")
        print(", ".join(found for found in names if found in rows))
    print("`msnet predict` and `msnet demo` also take sgbm, OpenCV's semi-global matching")


def _list(names: list[str]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from mobilestereonet.nets import model_info
    from mobilestereonet.weights import count_parameters, embedded_versions

    table = Table()
    for heading in ("name", "weights"):
        table.add_column(heading, no_wrap=True)
    table.add_column("parameters, M", justify="right", no_wrap=True)
    table.add_column("paper")
    for name in sorted(names, key=lambda name: not embedded_versions(name)):
        weights = [version.partition(".")[2] for version in embedded_versions(name)]
        info = model_info(name)
        if info.checkpoints and not info.checkpoints.startswith("none"):
            weights.append("public")
        paper = Text(info.paper, no_wrap=True, overflow="ellipsis")
        parameters = f"{count_parameters(name) / 1e6:.3f}"
        table.add_row(name, ", ".join(weights), parameters, paper)
    Console().print(table)
    print("public: released checkpoints that `msnet models NAME` names and --weights FILE reads")


def _describe(name: str, info: ModelInfo) -> None:
    """Print what the registry, and the card of the embedded weights, know about a network."""
    from dataclasses import asdict

    from mobilestereonet.weights import card, count_parameters, embedded_versions

    embedded = name != info.name or embedded_versions(info.name)
    content = card(name) if embedded else None
    values = ", ".join(f"{key}={value}" for key, value in asdict(info.config).items())
    facts = {
        "network": info.name,
        "paper": info.paper,
        "published": ", ".join(f"{what} {value}" for what, value in info.published.items()),
        "parameters": f"{count_parameters(info.name):,}",
        "config": values,
        "public checkpoints": info.checkpoints,
        "trained on": info.trained_on,
        "their licence": info.licence,
        "recipes": ", ".join(info.recipes) or "none published",
        "embedded weights": ", ".join(embedded_versions(info.name)) or "none",
    }
    print("\n".join(f"{key}: {value}" for key, value in facts.items() if value))
    if content is not None:
        _print_card(content)


def _print_card(card: dict[str, Any]) -> None:
    training, metrics = card.get("training", {}), card.get("metrics", {})
    config = ", ".join(f"{key}={value}" for key, value in card.get("config", {}).items())
    facts = {
        "date": card.get("date"),
        "licence": card.get("licence"),
        "config": config,
        "trained on": training.get("data"),
        "steps": training.get("steps"),
        "preprocessing": card.get("preprocessing"),
        "measured by": metrics.get("protocol"),
    }
    print(f"\n{card.get('model')}.{card.get('version')}")
    print("\n".join(f"  {key}: {value}" for key, value in facts.items() if value))
    for row in metrics.get("pairs", ()):
        print("  {pair}: EPE {epe_px} px, D1 {d1_percent} %".format(**row))
