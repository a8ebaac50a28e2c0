"""``msnet models``."""

from __future__ import annotations


def models() -> None:
    """List the named networks: which ones have weights in the package, and their parameters."""
    from rich.console import Console
    from rich.table import Table

    from mobilestereonet.nets import build_model, list_models
    from mobilestereonet.weights import embedded_models

    embedded = embedded_models()
    table = Table("name", "weights")
    table.add_column("parameters, M", justify="right")
    for name in list_models():
        parameters = sum(parameter.numel() for parameter in build_model(name).parameters())
        table.add_row(name, "embedded" if name in embedded else "", f"{parameters / 1e6:.3f}")
    Console().print(table)
    print("`msnet predict` and `msnet demo` also take sgbm, OpenCV's semi-global matching")
