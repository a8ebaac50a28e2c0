"""What is not everywhere: optional extras, the shared folder."""

import importlib
import os
from pathlib import Path

import pytest

REQUIRED = os.environ.get("MSNET_REQUIRE_EXTRAS") == "1"

SHARED = Path(os.environ.get("MSNET_SHARED", Path(__file__).parents[2] / "shared"))
"""Public data, the paper's figures and larger parity outputs, beside the checkout."""

needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="no shared folder")


def need_extra(module):
    """The module; without it the test, or the file of tests that asks for it, is skipped."""
    return importlib.import_module(module) if REQUIRED else pytest.importorskip(module)
