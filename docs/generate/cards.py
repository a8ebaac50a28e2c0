"""Writes docs/models: a page per version of the embedded weights, from its card.

python docs/generate/cards.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mobilestereonet.weights import card, count_parameters, embedded_models, embedded_versions

FOLDER = Path(__file__).parents[1] / "models"


_PARETO = "![Time against error of the quality levels and of StereoSGBM](../images/pareto.svg)"

_OVERVIEW = f"""# Model cards

What each version of the weights was trained on, how, with which figures and under which licence. A
network's name, such as `msnet3d`, means the newest version; a version's name, such as
`msnet3d.procedural-1`, stays what it is ([weights](../weights.md)). `msnet models NAME` prints a
card, and `mobilestereonet.weights.card(NAME)` gives it as data.

{_PARETO}

| version | date | parameters, M | training | licence |
| --- | --- | --- | --- | --- |"""

_FIGURES = """## Figures

Development figures: the pairs chose the weights. [Accuracy](../accuracy.md) has more of them.
Protocol: {protocol}.

| pair | EPE, px | D1, % |
| --- | --- | --- |"""

_LICENCE = """## Licence

The weights are under Apache-2.0. The scenes were rendered by this package. Their surfaces show
noise textures and crops of photographs and textures from the packages below, under their own
licences: none of them is non-commercial, and no picture is in the weights file or in this package.
Pairs of public data sets measured the weights and chose among them; they trained none.{note}

| textures from | licence |
| --- | --- |"""


def card_pages() -> dict[str, str]:
    """Markdown by file name: one page per version, and one that lists them."""
    versions = [version for model in embedded_models() for version in embedded_versions(model)]
    pages = {f"{page_name(version)}.md": _page(version, card(version)) for version in versions}
    return {"index.md": _overview(versions), **pages}


def page_name(version: str) -> str:
    """Name of a version's page without its ending."""
    return version.replace(".", "-")


def _overview(versions: list[str]) -> str:
    lines = [_OVERVIEW]
    for version in versions:
        content = card(version)
        parameters = f"{count_parameters(content['model']) / 1e6:.2f}"
        steps = f"{content['training']['steps']:,} steps on procedural scenes"
        link = f"[`{version}`]({page_name(version)}.md)"
        lines.append(
            f"| {link} | {content['date']} | {parameters} | {steps} | {content['licence']} |"
        )
    return "\n".join(lines) + "\n"


def _page(version: str, content: dict[str, Any]) -> str:
    training = content["training"]
    parts = [
        [f"# {version}", "", _summary(content), ""],
        ["```python", "from mobilestereonet import StereoMatcher", ""],
        [f'matcher = StereoMatcher.from_pretrained("{version}")', "```", ""],
        _facts(content),
        _figures(content["metrics"]),
        _confidence(content.get("confidence")),
        _licence(training),
        ["## Training", "", *_data(training), "", *_stages(training["stages"]), ""],
        ["Each run was started so, with `START` and the values of the table:", ""],
        ["```text", training["command"], "```", ""],
        _recipe(training["resolved"]),
    ]
    return "\n".join(line for part in parts for line in part) + "\n"


def _summary(content: dict[str, Any]) -> str:
    return (
        f"Weights of `{content['model']}`, version `{content['version']}` of {content['date']}, "
        f"under {content['licence']}.\nTrained on scenes that this package renders, and on no real "
        "pair."
    )


def _facts(content: dict[str, Any]) -> list[str]:
    config = ", ".join(f"`{name}={_value(value)}`" for name, value in content["config"].items())
    parameters = f"{count_parameters(content['model']):,} parameters with training's heads"
    colours = content["preprocessing"]
    rows = {
        "network": f"`{content['model']}`, {parameters}",
        "config": f"{config}; {content['config_note']}",
        "input": f"RGB in 0..1, mean {colours['mean']}, standard deviation {colours['std']}",
        "machine": content["training"]["machine"],
    }
    lines = [f"| {name} | {_cell(text)} |" for name, text in rows.items()]
    return ["| | |", "| --- | --- |", *lines, ""]


def _figures(metrics: dict[str, Any]) -> list[str]:
    row = "| {pair} | {epe_px:.2f} | {d1_percent:.1f} |"
    rows = [row.format(**pair) for pair in metrics["pairs"]]
    return [_FIGURES.format(protocol=metrics["protocol"]), *rows, "", _PARETO, ""]


def _confidence(facts: dict[str, Any] | None) -> list[str]:
    if facts is None:
        return []
    formula = "sigmoid({rise:.4f} log(c) - {fall:.4f} log(1 - c) {sign} {size:.4f})"
    offset = facts["fit"]["offset"]
    values = facts["fit"] | {"sign": "-" if offset < 0 else "+", "size": abs(offset)}
    size = "{} x {}".format(*facts["size"])
    lines = ["## Confidence", ""]
    lines += ["Of the network's own confidence c, the probability of an error below 3 px is", ""]
    lines += ["```text", formula.format(**values), "```", ""]
    lines += [
        f"by `msnet fit-confidence` on {facts['scenes']} procedural scenes of {size} (seed "
        f"{facts['seed']}, {facts['precision']}).",
        f"There the calibration error is {100 * facts['error']:.1f} %, and was "
        f"{100 * facts['error_before']:.1f} %. Other pairs are in "
        "[what the confidence says](../accuracy.md#what-the-confidence-says).",
        "",
        "| confidence | pixels | within 3 px |",
        "| --- | --- | --- |",
    ]
    row = "| {said:.3f} | {pixels:,} | {true:.3f} |"
    return [*lines, *(row.format(**found) for found in facts["table"]), ""]


def _licence(training: dict[str, Any]) -> list[str]:
    rows = [f"| {_cell(t['package'])} | {_cell(t['licence'])} |" for t in training["textures"]]
    note = training.get("textures_note", "")
    return [_LICENCE.format(note=note and f" {note[0].upper()}{note[1:]}."), *rows, ""]


def _data(training: dict[str, Any]) -> list[str]:
    note = f" ({training['steps_note']})" if "steps_note" in training else ""
    return [f"{training['steps']:,} steps{note}, on {training['data']}."]


def _stages(stages: list[dict[str, Any]]) -> list[str]:
    lines = ["| run | starts from | steps | pairs a step | crop | what differs |"]
    lines.append("| --- | --- | --- | --- | --- | --- |")
    for stage in stages:
        if "mean" in stage:
            shares = ", ".join(f"{share:g} of {run}" for run, share in stage["of"].items())
            note = f"; {stage['note']}" if "note" in stage else ""
            lines.append(f"| **{stage['mean']}** | the mean: {shares}{note} | | | | |")
            continue
        crop = " x ".join(map(str, stage["crop"]))
        values = {"seed": stage["seed"]} if "seed" in stage else {}
        if "scenes" in stage:
            values["scenes"] = " x ".join(map(str, stage["scenes"]))
        changed = [f"`{name}={_value(v)}`" for name, v in (values | stage.get("set", {})).items()]
        text = ", ".join(changed) + (f"; {stage['note']}" if "note" in stage else "")
        cells = (stage["run"], stage["start"], stage["steps"], stage["pairs_per_step"], crop, text)
        lines.append(f"| {' | '.join(_cell(str(cell)) for cell in cells)} |")
    return lines


def _recipe(resolved: dict[str, Any]) -> list[str]:
    return [
        f"All values of run {resolved['run']}; other runs differ in those of the table:",
        "",
        '<details markdown="1"><summary>recipe.json</summary>',
        "",
        "```json",
        json.dumps(resolved["recipe"], indent=1),
        "```",
        "",
        "</details>",
    ]


def _value(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def main() -> None:
    """Write the pages."""
    FOLDER.mkdir(exist_ok=True)
    for name, content in card_pages().items():
        (FOLDER / name).write_text(content, "utf-8")


if __name__ == "__main__":
    main()
