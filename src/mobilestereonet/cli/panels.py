"""Panels of options in the commands' help."""

from __future__ import annotations

PANELS = {
    "Input": (
        *(
            "data",
            "root",
            "split",
            "textures",
            "count",
            "seed",
            "training_only",
            "partial",
            "authors",
        ),
        "threshold",
        *("pair_by", "layout", "order", "rotate", "fps", "left_topic", "right_topic", "tolerance"),
    ),
    "Network": (
        *("model", "models", "table", "vary", "weights", "quality", "hz", "settings"),
        *("max_disparity", "scale", "shift"),
    ),
    "Training": ("recipe", "assignments", "steps", "seeds", "resume", "max_time"),
    "Engine": (
        *("runtime", "precision", "threads", "device", "accelerator", "devices", "num_nodes"),
        *("tile", "batch_size", "ray", "workers", "gpus"),
    ),
    "Calibration": (
        *("rig", "numbers", "unit", "fisheye", "rectified", "resized"),
        *("focal", "fov", "baseline", "doffs", "known"),
    ),
    "Refinement and filter": (
        *("refine", "left_right", "min_confidence", "max_depth", "keep_edges", "force"),
    ),
    "Output": (
        *("output", "frames", "write", "depth", "depth_std", "points", "mesh", "confidence"),
        *(
            "show",
            "beside",
            "bag",
            "rerun",
            "pictures",
            "format",
            "statistic",
            "paper",
            "json",
            "csv",
            "per_pair",
            "as_json",
            "skip_existing",
            "progress",
        ),
    ),
}
"""Parameters of the commands in each, in the order of the help.

What is in none stands in Typer's own panel "Options"; an option whose name means something else in
one command says its panel itself.
"""

_PANEL_OF = {name: panel for panel, names in PANELS.items() for name in names}


def panel_of(name: str) -> str | None:
    """The panel of a parameter; None for Typer's own."""
    return _PANEL_OF.get(name)


def place_in_help(name: str, panel: str | None) -> tuple[int, int]:
    """Sorts parameters: by panel, Typer's own first, and in a panel as it lists them."""
    if panel not in PANELS:
        return -1, 0
    names = PANELS[panel]
    return list(PANELS).index(panel), names.index(name) if name in names else len(names)
