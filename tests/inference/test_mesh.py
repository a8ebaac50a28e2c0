"""Meshes of results, opened by trimesh, and the other forms that a result takes."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from mobilestereonet import Calibration, StereoResult
from mobilestereonet.errors import InputError
from mobilestereonet.inference.mesh import fitting_step
from mobilestereonet.plots import colour_disparity

HEIGHT, WIDTH = 12, 20
CALIBRATION = Calibration(focal=50, baseline=0.5)


@pytest.fixture
def result():
    """A wall at 5 m, a box at 1 m before it, and an unknown corner."""
    disparity = np.full((HEIGHT, WIDTH), 5, np.float32)
    disparity[4:8, 6:14] = 25
    valid = np.ones((HEIGHT, WIDTH), bool)
    valid[:2, :3] = False
    left = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    return StereoResult(left, disparity, valid, confidence=np.linspace(0, 1, 240).reshape(12, 20))


def quads(height, width):
    return 2 * (height - 1) * (width - 1)


def test_a_mesh_is_cut_at_depth_edges(result):
    mesh = result.mesh(CALIBRATION)
    around = quads(6, 10)  # of the box and the pixels around it
    unknown = 2 * 2 * 3
    beside_corners = 2 + 1  # triangles: of the box and of the unknown corner
    kept = quads(HEIGHT, WIDTH) - around - unknown + quads(4, 8) + beside_corners
    assert len(mesh.faces) == kept
    assert len(mesh.vertices) == HEIGHT * WIDTH - 6
    depths = mesh.vertices[mesh.faces][..., 2]
    assert np.ptp(depths, axis=1).max() < 1e-4
    joined = result.mesh(CALIBRATION, edges=True)
    assert len(joined.faces) == quads(HEIGHT, WIDTH) - unknown + 1
    # The faces look at the camera.
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0).all()


def test_which_pixels_are_in_a_mesh(result):
    assert result.mesh(CALIBRATION, max_depth=2).vertices[:, 2].max() == pytest.approx(1)
    assert len(result.mesh(CALIBRATION, max_depth=2).faces) == quads(4, 8)
    assert len(result.mesh(CALIBRATION, min_confidence=0.5).vertices) <= HEIGHT * WIDTH / 2
    sparse = result.mesh(CALIBRATION, step=2, edges=True)
    assert len(sparse.faces) == quads(HEIGHT // 2, WIDTH // 2) - 2 * 2 + 1
    assert sparse.texture.shape == (HEIGHT, WIDTH, 3)
    for bad, message in (({"step": 0}, "step must be 1"), ({"min_confidence": 0.5}, "confidence")):
        plain = StereoResult(result.left, result.disparity, result.valid)
        with pytest.raises(InputError, match=message):
            plain.mesh(CALIBRATION, **bad)


def test_a_large_view_has_a_vertex_for_every_other_pixel():
    size = (400, 800)
    plane = StereoResult(
        np.zeros((*size, 3), np.uint8), np.ones(size, np.float32), np.ones(size) > 0
    )
    assert len(plane.mesh(CALIBRATION).vertices) == 200 * 400
    assert len(plane.mesh(CALIBRATION, step=1).vertices) == 400 * 800
    assert fitting_step(500, 500) == 1
    assert fitting_step(999, 1001) == 3  # every second one would be 500 x 501


def colours_at_vertices(mesh):
    """The texture's colours at the vertices, looked up as the formats define it."""
    material = mesh.visual.material
    texture = material.image if hasattr(material, "image") else material.baseColorTexture
    image = np.asarray(texture.convert("RGB"))
    u, v = mesh.visual.uv.T
    rows = np.clip(((1 - v) * HEIGHT).astype(int), 0, HEIGHT - 1)
    return image[rows, np.clip((u * WIDTH).astype(int), 0, WIDTH - 1)]


@pytest.mark.parametrize("name", ["a.glb", "a.obj", "new/a b.obj"])
def test_textured_files_are_read_by_trimesh(result, tmp_path, name):
    mesh = result.mesh(CALIBRATION)
    files = mesh.save(tmp_path / name)
    assert files[-1] == tmp_path / name
    assert sorted(files) == sorted(files[0].parent.iterdir())
    read = trimesh.load(tmp_path / name, force="mesh", process=False)
    assert len(read.faces) == len(mesh.faces)
    upright = mesh.vertices[mesh.faces] * [1, -1, -1]
    np.testing.assert_allclose(
        read.triangles.mean(axis=(0, 1)), upright.mean(axis=(0, 1)), atol=1e-4
    )
    assert read.vertices[:, 2].max() < 0  # in front of a camera that looks along -z
    pixels = {tuple(colour) for colour in result.left[result.valid]}
    found = {tuple(colour) for colour in colours_at_vertices(read)}
    assert len(found & pixels) > 0.95 * len(pixels)
    # The upper left corner of the box is where it is in the picture.
    corner = np.argmin(np.abs(read.vertices - [(6 - 9.5) / 50, -(4 - 5.5) / 50, -1]).sum(axis=1))
    assert tuple(colours_at_vertices(read)[corner]) == tuple(result.left[4, 6])


def test_stl_stands_upright(result, tmp_path):
    mesh = result.mesh(CALIBRATION)
    assert mesh.save(tmp_path / "a.stl") == [tmp_path / "a.stl"]
    read = trimesh.load(tmp_path / "a.stl")
    assert len(read.faces) == len(mesh.faces)
    assert read.bounds[:, 1] == pytest.approx([1, 5], abs=1e-4)  # y is forward
    assert read.bounds[1, 2] == pytest.approx(5.5 / 50 * 5, abs=1e-3)  # z is up


def test_files_that_cannot_be_written(result, tmp_path):
    mesh = result.mesh(CALIBRATION)
    with pytest.raises(InputError, match=r"a.fbx: meshes are written as .glb, .obj, .stl"):
        mesh.save(tmp_path / "a.fbx")
    with pytest.raises(InputError, match="no face to write"):
        result.mesh(CALIBRATION, max_depth=0.5).save(tmp_path / "a.glb")
    assert not list(tmp_path.iterdir())


def test_depth_of_numbers(result):
    depth = result.depth(focal=50, baseline=0.5)
    np.testing.assert_array_equal(depth, result.depth(CALIBRATION))
    shifted = Calibration(focal=50, baseline=0.5, doffs=2)
    np.testing.assert_array_equal(
        result.depth(focal=50, baseline=0.5, doffs=2), result.depth(shifted)
    )
    for missing in ({}, {"focal": 50}, {"baseline": 0.5}):
        with pytest.raises(InputError, match="both of them"):
            result.depth(**missing)
    with pytest.raises(InputError, match="leave one out"):
        result.depth(CALIBRATION, focal=50)


def test_pil_image(result):
    image = result.to_pil()
    assert image.size == (WIDTH, HEIGHT)
    expected = colour_disparity(result.disparity, valid=result.valid)
    np.testing.assert_array_equal(np.asarray(image), expected)


def test_plot_and_show(result, monkeypatch):
    titles = [axes.get_title() for axes in replace(result, calibration=CALIBRATION).plot().axes]
    assert titles[:4] == ["left view", "disparity (px)", "depth (m)", "confidence"]
    left, disparity, confidence, *bars = result.plot().axes
    assert [axes.get_title() for axes in (left, disparity, confidence)] == [
        "left view",
        "disparity (px)",
        "confidence",
    ]
    assert len(bars) == 2
    assert np.ma.count_masked(disparity.images[0].get_array()) == 6
    from matplotlib import pyplot
    from matplotlib.figure import Figure

    new, shown = Figure(), []
    monkeypatch.setattr(pyplot, "figure", lambda layout: new)
    monkeypatch.setattr(pyplot, "show", lambda: shown.extend(new.axes))
    result.show()
    assert len(shown) == 5


def test_open3d(result, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(InputError, match="pip install open3d"):
        result.to_open3d(CALIBRATION)
    stand_in = SimpleNamespace(
        geometry=SimpleNamespace(PointCloud=SimpleNamespace),
        utility=SimpleNamespace(Vector3dVector=np.asarray),
    )
    monkeypatch.setitem(sys.modules, "open3d", stand_in)
    cloud, expected = result.to_open3d(CALIBRATION), result.points(CALIBRATION)
    np.testing.assert_array_equal(cloud.points, expected.points)
    assert cloud.points.dtype == np.float64
    np.testing.assert_allclose(cloud.colors, expected.colours / 255)
    near = result.to_open3d(CALIBRATION, max_depth=2)
    assert 0 < len(near.points) < len(cloud.points)
