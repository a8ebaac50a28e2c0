"""``msnet fit-confidence``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mobilestereonet.cli.early import PRECISIONS, ends_in, network_name, one_of, weights_file
from mobilestereonet.cli.options import new_output

if TYPE_CHECKING:
    from mobilestereonet.evaluation import Reliability

SEED = 3_000_017
"""Seed of the scenes: no training, no validation and no benchmark of this package uses it."""


def fit_confidence(
    weights: Annotated[
        str,
        typer.Argument(
            help="Weights file, checkpoint or name of embedded weights.", callback=weights_file
        ),
    ],
    output: Annotated[
        Path,
        new_output(
            "fitted.safetensors",
            "File to write, ends in .safetensors.",
            ends_in([".safetensors"], "weights are"),
        ),
    ],
    model: Annotated[
        str | None,
        typer.Option(help="The network, where the file does not tell.", callback=network_name),
    ] = None,
    scenes: Annotated[int, typer.Option(min=1, help="Procedural scenes to fit to.")] = 40,
    height: Annotated[int, typer.Option(min=32, help="Their height in px.")] = 256,
    width: Annotated[int, typer.Option(min=32, help="Their width in px.")] = 512,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the scenes.")] = SEED,
    precision: Annotated[
        str, typer.Option(help="Precision of the network.", callback=one_of(PRECISIONS))
    ] = "auto",
    threads: Annotated[int | None, typer.Option(min=1, help="Threads on the CPU.")] = None,
    half: Annotated[bool, typer.Option(help="Write half precision, half the size.")] = False,
) -> None:
    """Fit the confidence of weights: a probability that the error is below 3 px.

    The weights are written with the fit inside, and every command then shows that probability.
    The card beside them, <name>.json, gets the fit and its reliability table.
    """
    from dataclasses import asdict

    import torch

    from mobilestereonet import evaluation
    from mobilestereonet.atomic import check_outputs
    from mobilestereonet.cli.progress import progress_bar
    from mobilestereonet.inference import StereoMatcher
    from mobilestereonet.scenes import ProceduralScenes, SceneConfig
    from mobilestereonet.weights import load_model, save_weights

    check_outputs(output, output.with_suffix(".json"))
    net = load_model(weights, model=model)
    net.confidence_fit = None
    matcher = StereoMatcher(net, precision=precision, threads=threads, confidence=True)
    data = ProceduralScenes(SceneConfig(height=height, width=width, seed=seed, length=scenes))
    with progress_bar("scenes") as bar:
        samples = (data[index] for index in bar.track(range(scenes), description="fit"))
        raw, correct = evaluation.confidences(matcher, samples)
    fit = evaluation.fit_confidence(raw, correct)
    before = evaluation.reliability(raw, correct)
    after = evaluation.reliability(fit(torch.from_numpy(raw)).numpy(), correct)
    facts = {
        "fit": asdict(fit),
        "scenes": scenes,
        "size": [height, width],
        "seed": seed,
        "precision": matcher.engine.precision,
        "error_before": round(before.error, 4),
        "error": round(after.error, 4),
        "table": after.table(),
    }
    net.confidence_fit = fit
    card = _card(weights) | {"confidence": facts}
    save_weights(net, output, card=card, dtype=torch.float16 if half else None)
    _print(output, before, after)


def _card(weights: str) -> dict[str, Any]:
    """The card of weights, embedded or beside a file; empty without one."""
    from mobilestereonet.text import read_json
    from mobilestereonet.weights import card, is_embedded

    if is_embedded(weights):
        return card(weights)
    file = Path(weights).with_suffix(".json")
    found = read_json(file) if file.is_file() else {}
    return found if isinstance(found, dict) else {}


def _print(output: Path, before: Reliability, after: Reliability) -> None:
    print("confidence  pixels      within 3 px")
    for row in after.table():
        print(f"{row['said']:10.3f}  {row['pixels']:10}  {row['true']:.3f}")
    print(f"calibration error {100 * before.error:.1f} % before, {100 * after.error:.1f} % after")
    print(output)
