"""What only an optional extra brings: tests skip without it, unless MSNET_REQUIRE_EXTRAS=1."""

import importlib
import os

import pytest

REQUIRED = os.environ.get("MSNET_REQUIRE_EXTRAS") == "1"


def need_extra(module):
    """The module; without it the test, or the file of tests that asks for it, is skipped."""
    return importlib.import_module(module) if REQUIRED else pytest.importorskip(module)
