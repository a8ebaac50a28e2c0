"""What the command line makes of its process before anything heavy is imported, and of errors."""

from __future__ import annotations

import io
import logging
import os
import re
import sys
import traceback
import warnings

from mobilestereonet.cli.progress import LongWork
from mobilestereonet.errors import InputError
from mobilestereonet.memory import keep_freed_memory
from mobilestereonet.text import shorten

BAD_INPUT, UNFORESEEN = 2, 70
"""Exit codes: what the user can put right; a fault of ours (sysexits.h: EX_SOFTWARE)."""

_ENVIRONMENT = {
    # Threads that wait for others sleep instead of spinning. Beside other programs, spinning takes
    # the very cores away that the others' share of the work needs. Read when PyTorch is loaded.
    "OMP_WAIT_POLICY": "PASSIVE",
    "OPENCV_LOG_LEVEL": "FATAL",  # our own line says what is wrong with a file
    # Nothing is reported to the makers of libraries; the engines see to their own.
    "HF_HUB_DISABLE_TELEMETRY": "1",
    "RAY_USAGE_STATS_ENABLED": "0",
    "GRADIO_ANALYTICS_ENABLED": "False",
}

_OUT_OF_MEMORY = re.compile(r"out of memory|insufficient memory|n.t allocate|Failed to alloc", re.I)


def prepare_process() -> None:
    """Set up the process; what the user's environment says stays."""
    for name, value in _ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    for stream in (sys.stdout, sys.stderr):
        # Names of files may be bytes that are no text, or signs that the terminal lacks.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    for of_libraries in (DeprecationWarning, FutureWarning):
        warnings.simplefilter("ignore", of_libraries)
    # The message alone, without the line of code that gave it.
    warnings.showwarning = lambda message, *_: print(f"msnet: {message}", file=sys.stderr)
    notes = logging.getLogger(__name__.partition(".")[0])
    notes.setLevel(logging.INFO)
    if not any(isinstance(handler, _Notes) for handler in notes.handlers):
        notes.addHandler(_Notes())
    keep_freed_memory()


class _Notes(logging.Handler):
    """Prints messages, and what takes long, so that it does not work in silence."""

    def __init__(self) -> None:
        super().__init__()
        self._shown: list[LongWork] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Print one message, or begin or end to show that work goes on; see `long_work`."""
        text, work = record.getMessage(), getattr(record, "work", None)
        if work == "begins":
            self._shown.append(LongWork(text))
        elif work is None or (self._shown and self._shown.pop().end()):
            print(f"msnet: {text}", file=sys.stderr, flush=True)


def report(error: Exception, *, debug: bool = False) -> int:
    """Tell what ended a command, in one line on stderr; returns the exit code.

    Args:
        error: The error.
        debug: Print the traceback before.
    """
    if debug:
        traceback.print_exception(error)
    text = _one_line(error)
    if isinstance(error, InputError | OSError):
        print(f"msnet: {text}", file=sys.stderr)
        return BAD_INPUT
    module = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    if module and module != __name__.partition(".")[0]:
        package = _package_of(module)
        remedy = (
            f"pip install --force-reinstall --no-deps {package}"
            if package
            else f"put the package back that brings {module}"
        )
        print(
            f"msnet: {text}: a package is missing, or was removed in part; {remedy} (`msnet info` "
            "says what is installed)",
            file=sys.stderr,
        )
        return BAD_INPUT
    if isinstance(error, MemoryError) or _OUT_OF_MEMORY.search(text):
        print(
            f"msnet: not enough memory ({text}): take smaller pictures, smaller tiles (--tile) or "
            "a smaller network",
            file=sys.stderr,
        )
        return BAD_INPUT
    print(
        f"msnet: a fault of msnet itself, {type(error).__name__}: {text}; please report it with "
        "the command and with what `msnet --debug` and this command, and `msnet --version`, print",
        file=sys.stderr,
    )
    return UNFORESEEN


def _package_of(module: str) -> str | None:
    """The package of our requirements that brings a module, such as OpenCV's; None if none does."""
    from importlib import metadata

    try:
        requirements = metadata.requires(__name__.partition(".")[0]) or []
    except metadata.PackageNotFoundError:  # run from its sources
        return None
    needed = {_normalized(re.split(r"[^\w.-]", text, maxsplit=1)[0]) for text in requirements}
    owners = metadata.packages_distributions().get(module, [module])
    return next((name for name in owners if _normalized(name) in needed), None)


def _normalized(package: str) -> str:
    return re.sub(r"[-_.]+", "-", package).lower()


def _one_line(error: Exception) -> str:
    """An error's text without line ends and without what would steer a terminal."""
    return shorten(re.sub(r"[\x00-\x20\x7f-\x9f]+", " ", str(error)).strip(), 1000)
