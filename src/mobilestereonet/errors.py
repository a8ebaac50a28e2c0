"""Errors that users cause and can fix."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class InputError(ValueError):
    """Bad input: names the value and the way out. The command line prints it and exits with 2."""


def check_multiple(name: str, value: int, factor: int) -> None:
    """Check that a value is a positive multiple.

    Args:
        name: What the value is, for the message.
        value: The value.
        factor: What it must be a multiple of.

    Raises:
        InputError: If it is none.
    """
    if value < factor or value % factor:
        raise InputError(f"{name} must be a positive multiple of {factor}, got {value}")


@contextmanager
def needs_extra(extra: str, hint: str = "") -> Iterator[None]:
    """Context for the imports that an optional extra of this package brings.

        with needs_extra("train"):
            import lightning as L

    Args:
        extra: Name of the extra, such as "train".
        hint: What else helps, as the end of the message.

    Raises:
        InputError: If a module is not installed; the message names it and the extra.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        name = (error.name or "").partition(".")[0]
        if name == __package__:  # a fault of ours is not told as a missing package
            raise
        command = f'pip install "mobilestereonet[{extra}]"'
        raise InputError(f"{name} is not installed: {command}{hint and '; '}{hint}") from error
