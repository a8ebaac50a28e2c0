"""Writes docs/notebook.ipynb: runs its cells one after the other and keeps what they show.

python docs/figures/notebook.py
"""

from __future__ import annotations

import ast
import base64
import io
import json
import os
import tempfile
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from PIL.Image import Image

NOTEBOOK = Path(__file__).parents[1] / "notebook.ipynb"

CELLS = (
    "# From two pictures to a mesh\n\n"
    "A rectified pair as PIL images, its disparity, its depth in metres, and a textured mesh that "
    'opens in Blender. It needs `pip install "mobilestereonet[demo,plots]"`.',
    """from PIL import Image
from skimage.data import stereo_motorcycle

left, right = (Image.fromarray(view) for view in stereo_motorcycle()[:2])
left.reduce(3)""",
    """from mobilestereonet import Calibration, StereoMatcher

matcher = StereoMatcher.from_pretrained(quality="fast", confidence=True)
result = matcher(left, right)
result.plot()""",
    "Depth is `focal * baseline / (disparity + doffs)`; these are the numbers of this pair's "
    "cameras (Middlebury's Motorcycle).",
    """calibration = Calibration(focal=994.978, baseline=0.193001, doffs=31.086)
depth = result.depth(calibration)
print(f"{depth[depth > 0].min():.2f} to {depth.max():.2f} m")""",
    "The surface is cut at depth edges; `step=3` takes every third pixel for a vertex, and the "
    "texture stays whole.",
    """mesh = result.mesh(calibration, max_depth=6, step=3)
print([path.name for path in mesh.save("motorcycle.glb")])
len(mesh.vertices), len(mesh.faces)""",
    "`mesh.save` also writes `.obj` and `.stl`; `result.points(calibration)` gives points, "
    "`result.to_open3d(calibration)` those of Open3D.",
)
"""Text, and code, which begins with an import or an assignment."""


def is_code(cell: str) -> bool:
    """Whether a cell is code."""
    return cell.startswith(("from ", "calibration", "mesh"))


def shown(value: Any) -> dict[str, Any]:
    """What a notebook keeps of the value of a cell's last line."""
    if isinstance(value, Figure | Image):
        picture = io.BytesIO()
        if isinstance(value, Figure):
            value.savefig(picture, dpi=50)
        else:
            value.save(picture, "png")
        return {"image/png": base64.b64encode(picture.getvalue()).decode()}
    return {"text/plain": [repr(value)]}


def run(source: str, names: dict[str, Any], count: int) -> dict[str, Any]:
    """Run a cell of code; gives it as the notebook's format has it."""
    *lines, last = ast.parse(source).body
    printed, outputs = io.StringIO(), []
    with redirect_stdout(printed):
        exec(compile(ast.Module(lines, []), "cell", "exec"), names)
        value = None
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
        else:
            exec(compile(ast.Module([last], []), "cell", "exec"), names)
    if printed.getvalue():
        text = printed.getvalue().splitlines(keepends=True)
        outputs.append({"output_type": "stream", "name": "stdout", "text": text})
    if value is not None:
        result = {"output_type": "execute_result", "execution_count": count, "metadata": {}}
        outputs.append(result | {"data": shown(value)})
    return {"cell_type": "code", "execution_count": count, "outputs": outputs}


def main() -> None:
    """Run all cells in a folder of their own and write the notebook."""
    names: dict[str, Any] = {}
    cells = []
    os.chdir(tempfile.mkdtemp())
    for source in CELLS:
        cell = {"cell_type": "markdown"}
        if is_code(source):
            cell = run(source, names, 1 + sum(c["cell_type"] == "code" for c in cells))
        source_lines = source.splitlines(keepends=True)
        cells.append(cell | {"id": f"cell-{len(cells)}", "metadata": {}, "source": source_lines})
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    notebook = {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4}
    NOTEBOOK.write_text(json.dumps(notebook | {"nbformat_minor": 5}, indent=1) + "\n")


if __name__ == "__main__":
    main()
