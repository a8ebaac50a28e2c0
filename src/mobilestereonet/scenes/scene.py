"""Description of a scene: cameras, a lamp and surfaces in the left camera's frame, in metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

RECTANGLE, MASKED, QUADRIC = range(3)
# x^2 + y^2 + a z^2 + b z + c = 0 with |z| <= 1.
SPHERE = (1.0, 0.0, -1.0)
CYLINDER = (0.0, 0.0, -1.0)
CONE = (-0.25, 0.5, -0.25)  # its tip at z = 1
BARREL = (0.5, 0.0, -1.0)
VASE = (-0.6, 0.0, -0.4)
BOWL = (0.0, 0.5, -0.5)


@dataclass(frozen=True)
class Surfaces:
    """Surfaces of one scene in the left camera's frame; n of them.

    Attributes:
        shape: RECTANGLE, MASKED or QUADRIC, (n,).
        centre: Centre in metres, (n, 3).
        axes: Half axes in metres as columns; a rectangle's third is its unit normal, (n, 3, 3).
        quadric: a, b, c of a quadric, (n, 3).
        mask: Index of the mask of a MASKED one, (n,).
        mask_repeat: How often the mask repeats along x and y, (n, 2).
        one_sided: Whether a rectangle is seen only from where its normal points, (n,).
        texture: Index in the texture bank, (n,).
        texels: Local x and y (a quadric: angle and z) to texels, (n, 2, 3).
        density: Texels per metre, (n,).
        colour: Factor on the texture's colour, (n, 3).
        contrast: Factor on the texture's departure from its mean, (n,).
        gloss: Strength of the highlight, (n,).
        mirror: Share of the light that it mirrors, seen head-on, (n,).
    """

    shape: Ints
    centre: Floats
    axes: Floats
    quadric: Floats
    mask: Ints
    mask_repeat: Floats
    one_sided: NDArray[np.bool_]
    texture: Ints
    texels: Floats
    density: Floats
    colour: Floats
    contrast: Floats
    gloss: Floats
    mirror: Floats


@dataclass(frozen=True)
class Scene:
    """Scene to render: cameras, light and surfaces.

    Attributes:
        focal: Focal length in pixels.
        cx: Column of the principal point.
        cy: Row of the principal point.
        baseline: Distance of the cameras, in metres.
        light: Position of the lamp in the camera's frame, in metres.
        focus: Middle of the region in which the lamp casts shadows, in the camera's frame.
        spread: Radius of that region, in metres.
        ambient: Light that comes from everywhere.
        diffuse: Light of the lamp, before falloff.
        reach: Distance in metres at which the lamp is half as bright.
        shininess: Exponent of the highlights.
        brightness: Geometric mean of the images, as an automatic exposure would set it.
        surfaces: Its surfaces.
        kind: Name of the layout.
        surroundings: Index of the texture that mirrors show.
    """

    focal: float
    cx: float
    cy: float
    baseline: float
    light: Floats
    focus: Floats
    spread: float
    ambient: float
    diffuse: float
    reach: float
    shininess: float
    brightness: float
    surfaces: Surfaces
    kind: str
    surroundings: int = 0
