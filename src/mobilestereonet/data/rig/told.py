"""What the user says about a calibration file, and which baselines are plausible."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mobilestereonet.errors import InputError

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Metres per unit of length."""

MIN_BASELINE_M = 1e-3
"""Smallest distance between two cameras that is believed without a confirmation."""

MAX_BASELINE_M = 10.0
"""Largest one."""

MAX_BASELINE_DIFFERENCE = 0.01
"""Largest relative difference between two statements of one baseline."""


@dataclass(frozen=True)
class Told:
    """What the user says about a calibration file.

    Attributes:
        unit: Unit of the file's lengths, one of `UNITS`; None for that of its format.
        baseline: Distance between the cameras in metres, where the file has none or an implausible
            one.
        cameras: Numbers of the left and the right camera, where a file has more than two.
        fisheye: Whether the lenses are fisheye ones, where distortion coefficients have no model.
        rectified: Whether the pictures are rectified; then nothing else of a file is read.

    Raises:
        InputError: If a value is impossible.
    """

    unit: str | None = None
    baseline: float | None = None
    cameras: tuple[int, int] | None = None
    fisheye: bool | None = None
    rectified: bool | None = None

    def __post_init__(self) -> None:
        if self.unit is not None and self.unit not in UNITS:
            raise InputError(f"a unit is one of {', '.join(UNITS)}, got {self.unit!r}")
        if self.baseline is not None and not 0 < self.baseline < math.inf:
            raise InputError(f"a baseline must be positive and finite, got {self.baseline:g}")
        if self.cameras is not None and self.cameras[0] == self.cameras[1]:
            raise InputError(f"left and right must be two cameras, got {self.cameras[0]} twice")

    def metres(self, length: float, unit: str = "m") -> float:
        """A file's baseline in metres, checked.

        Args:
            length: The baseline as the file has it; 0 where it has none.
            unit: Unit of the format, if the user names none.

        Raises:
            InputError: If it is implausible and the user does not confirm it, if the file has
                none and the user tells none, or if the two disagree.
        """
        if not math.isfinite(length):
            raise InputError(f"the baseline must be finite, got {length}")
        metres = length * UNITS[self.unit or unit]
        if length < 0:
            raise InputError(
                f"the baseline must be positive, got {metres:g} m: are the cameras swapped?"
            )
        plausible = MIN_BASELINE_M <= metres <= MAX_BASELINE_M
        if self.baseline is None:
            if length == 0:
                raise InputError("the file has no baseline: --baseline METRES tells it")
            if not plausible:
                others = [
                    f"--unit {name} ({length * factor:g} m)"
                    for name, factor in UNITS.items()
                    if MIN_BASELINE_M <= length * factor <= MAX_BASELINE_M
                ]
                raise InputError(
                    f"a baseline of {metres:g} m is implausible: name the unit of the file's "
                    f"lengths, {' or '.join(others) or '--unit'}, or confirm the baseline by "
                    f"--baseline {metres:g}"
                )
            return metres
        if plausible and not math.isclose(metres, self.baseline, rel_tol=MAX_BASELINE_DIFFERENCE):
            raise InputError(
                f"the file's baseline is {metres:g} m, and --baseline says {self.baseline:g} m: "
                "leave it out, or name the unit of the file's lengths by --unit"
            )
        return self.baseline
