"""Textured meshes of results: files for Blender, browsers and printers."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mobilestereonet.atomic import check_outputs, write_atomically
from mobilestereonet.data.images import FloatMap, Picture
from mobilestereonet.errors import InputError
from mobilestereonet.inference.geometry import MAX_DISPARITY_GRADIENT

if TYPE_CHECKING:
    import trimesh

MESH_FORMATS = (".glb", ".obj", ".stl")

MAX_VERTICES = 250_000
"""Vertices up to which a mesh has one for every pixel unless asked otherwise: a file of 15 MB."""

_Y_UP = np.array([[1, 0, 0], [0, -1, 0], [0, 0, -1]], np.float32)
"""Camera frame to y up and z backward, as GLB and OBJ have it."""

_Z_UP = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.float32)
"""Camera frame to y forward and z up, as programs read STL."""


@dataclass(frozen=True)
class Mesh:
    """Textured surface in the left camera's frame: x to the right, y down, z forward.

    Attributes:
        vertices: (N, 3) float32, in metres.
        faces: (M, 3) int64, indices of vertices, counter-clockwise as the camera sees them.
        texture_coordinates: (N, 2) float32 in 0..1, from the texture's lower left corner.
        texture: The left view, (H, W, 3) uint8 RGB.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int64]
    texture_coordinates: NDArray[np.float32]
    texture: Picture

    def save(self, path: str | Path) -> list[Path]:
        """Write the mesh; each file atomically, and the one that names the others last.

        Args:
            path: ``.glb``, with its texture inside, or ``.obj``, with a ``.mtl`` and a ``.png``
                beside it: both with y up and z backward; or ``.stl``, the shape alone, with y
                forward and z up.

        Returns:
            The files.

        Raises:
            InputError: If the ending is another one, or there is no face.
        """
        path = check_mesh_file(path)
        if not len(self.faces):
            raise InputError(f"{path}: no face to write: is all depth unknown or beyond the limit?")
        files = self._contents(path)
        for name, content in files.items():
            write_atomically(path.with_name(name), partial(_write, content))
        return [path.with_name(name) for name in files]

    def _contents(self, path: Path) -> dict[str, bytes]:
        """The files' names and contents."""
        kind = path.suffix.lower()
        if kind == ".stl":
            return {path.name: _exported(self._trimesh(_Z_UP), "stl")}
        mesh = self._trimesh(_Y_UP, texture_name=path.stem)
        if kind == ".glb":
            return {path.name: _exported(mesh, "glb")}
        from trimesh.exchange.obj import export_obj

        text, others = export_obj(  # type: ignore[no-untyped-call]
            mesh, return_texture=True, mtl_name=f"{path.stem}.mtl"
        )
        return {**dict(sorted(others.items(), reverse=True)), path.name: text.encode()}

    def _trimesh(self, turn: NDArray[np.float32], texture_name: str = "") -> trimesh.Trimesh:
        import trimesh  # its import is slow

        visual = None
        if texture_name:
            material = trimesh.visual.material.SimpleMaterial(  # type: ignore[no-untyped-call]
                image=Image.fromarray(self.texture), name=texture_name, ambient=(255, 255, 255, 255)
            )
            visual = trimesh.visual.TextureVisuals(  # type: ignore[no-untyped-call]
                uv=self.texture_coordinates, material=material
            )
        return trimesh.Trimesh(self.vertices @ turn.T, self.faces, visual=visual, process=False)


def _write(content: bytes, path: Path) -> None:
    path.write_bytes(content)


def _exported(mesh: Any, kind: str) -> bytes:
    content: bytes = mesh.export(file_type=kind)
    return content


def check_mesh_file(path: str | Path) -> Path:
    """Check that a mesh can be written in the format that a path's ending names.

    Raises:
        InputError: If it can't.
    """
    path = Path(path)
    if path.suffix.lower() not in MESH_FORMATS:
        raise InputError(f"{path}: meshes are written as {', '.join(MESH_FORMATS)}")
    check_outputs(path)
    return path


def fitting_step(height: int, width: int) -> int:
    """Every how many pixels there is a vertex at least, for at most `MAX_VERTICES`."""
    steps = itertools.count(1)
    return next(step for step in steps if -(-height // step) * -(-width // step) <= MAX_VERTICES)


def surface(
    points: FloatMap, disparity: FloatMap, texture: Picture, *, step: int = 1, edges: bool = False
) -> Mesh:
    """Join neighbouring pixels to a surface, two triangles for four of them.

    Args:
        points: Points of the pixels in the camera's frame, (H, W, 3) in metres, NaN where there
            is none.
        disparity: (H, W), in px.
        texture: The left view, (H, W, 3) uint8 RGB.
        step: Every how many pixels there is a vertex; the texture stays whole.
        edges: True joins the two sides of depth edges, too: of steps above
            `MAX_DISPARITY_GRADIENT`.
    """
    height, width = disparity.shape
    rows, columns = np.arange(0, height, step), np.arange(0, width, step)
    sparse = points[::step, ::step].reshape(-1, 3)
    index = np.arange(len(sparse)).reshape(len(rows), len(columns))
    corners = index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]
    top_left, bottom_left, top_right, bottom_right = (corner.ravel() for corner in corners)
    faces = np.concatenate(
        (
            np.stack((top_left, bottom_left, top_right), axis=1),
            np.stack((top_right, bottom_left, bottom_right), axis=1),
        )
    )
    values = np.where(np.isfinite(sparse).all(axis=1), disparity[::step, ::step].ravel(), np.nan)
    spans = np.ptp(values[faces], axis=1)  # NaN where a corner has no point
    faces = faces[spans <= (np.inf if edges else step * MAX_DISPARITY_GRADIENT)]
    used, faces = np.unique(faces, return_inverse=True)
    x, y = (columns + 0.5) / width, 1 - (rows + 0.5) / height
    coordinates = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2).astype(np.float32)
    return Mesh(sparse[used], faces.reshape(-1, 3), coordinates[used], texture)
