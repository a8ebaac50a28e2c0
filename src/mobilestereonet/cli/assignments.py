"""Values by name on the command line."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from mobilestereonet.errors import InputError


def parse_assignments(assignments: Sequence[str]) -> dict[str, Any]:
    """Read assignments such as ``size=H``, ``lr=5e-4`` or ``augment.noise=0.02``.

    Values are JSON; what is no JSON is taken as text.

    Raises:
        InputError: If an assignment has no "=".
    """
    options: dict[str, Any] = {}
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals:
            raise InputError(f"{assignment!r}: write it as key=value")
        try:
            options[key] = json.loads(text)
        except json.JSONDecodeError:
            options[key] = text
    return options
