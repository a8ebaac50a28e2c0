"""Procedural scenes against closed-form geometry."""

import functools
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st

from mobilestereonet.errors import InputError
from mobilestereonet.scenes import ProceduralScenes, SceneConfig
from mobilestereonet.scenes.layouts import LAYOUTS
from mobilestereonet.scenes.render import render_scenes
from mobilestereonet.scenes.scene import (
    CYLINDER,
    QUADRIC,
    RECTANGLE,
    SPHERE,
    Scene,
    Surfaces,
)
from mobilestereonet.scenes.textures import TextureBank

SMALL = SceneConfig(height=64, width=128, max_disparity=48, noise_textures=16, texture_size=64)
FOCAL, BASELINE = 100.0, 0.5
SIZE = (80, 120)
CX, CY = 60.0, 40.0


@pytest.fixture(scope="module")
def scenes():
    return ProceduralScenes(SMALL)


def surface(shape, centre, axes, quadric=SPHERE):
    """One plain white surface: half axes are the columns of ``axes``."""
    return {"shape": shape, "centre": centre, "axes": axes, "quadric": quadric}


def wall(depth):
    return surface(RECTANGLE, [0, 0, depth], np.diag([100.0, 100.0, 1.0]))


def make_scene(*items, light=(0.0, 0.0, -1.0)):
    count = len(items)

    def column(name, kind=np.float64):
        return np.array([item[name] for item in items], dtype=kind)

    surfaces = Surfaces(
        shape=column("shape", np.int64),
        centre=column("centre"),
        axes=column("axes"),
        quadric=column("quadric"),
        mask=np.zeros(count, np.int64),
        mask_repeat=np.ones((count, 2)),
        one_sided=np.zeros(count, np.bool_),
        texture=np.zeros(count, np.int64),
        texels=np.zeros((count, 2, 3)),
        density=np.ones(count),
        colour=np.ones((count, 3)),
        contrast=np.ones(count),
        gloss=np.zeros(count),
        mirror=np.zeros(count),
    )
    return Scene(
        focal=FOCAL,
        cx=CX,
        cy=CY,
        baseline=BASELINE,
        light=np.array(light),
        focus=np.array([0.0, 0.0, 5.0]),
        spread=5.0,
        ambient=0.3,
        diffuse=0.7,
        reach=1e3,
        shininess=10.0,
        brightness=0.3,
        surfaces=surfaces,
        kind="test",
    )


def render(*items, **how):
    bank = TextureBank(np.full((1, 4, 4, 3), 200, np.uint8), 1, torch.device("cpu"))
    masks = torch.ones(1, 4, 4, dtype=torch.bool)
    image, disparity, occluded = render_scenes([make_scene(*items, **how)], SIZE, 1, bank, masks)
    return image[0], disparity[0].numpy(), occluded[0].numpy()


def rays():
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.stack([(x - CX) / FOCAL, (y - CY) / FOCAL, np.ones(SIZE)], -1)


def test_disparity_of_a_wall_is_focal_times_baseline_over_depth():
    _, disparity, _ = render(wall(8.0))
    np.testing.assert_allclose(disparity, FOCAL * BASELINE / 8.0, rtol=1e-6)


def test_disparity_of_a_slanted_plane():
    x, y = np.array([1.0, 0.0, 0.6]), np.array([0.2, 1.0, -0.3])
    normal = np.cross(x, y) / np.linalg.norm(np.cross(x, y))
    centre = np.array([0.3, -0.2, 6.0])
    axes = np.stack([50 * x, 50 * y, normal], -1)
    _, disparity, _ = render(wall(500.0), surface(RECTANGLE, centre, axes))
    depth = (normal @ centre) / (rays() @ normal)
    near = (depth > 0) & (depth < 20)
    assert near.mean() > 0.9
    np.testing.assert_allclose(disparity[near], FOCAL * BASELINE / depth[near], atol=1e-3)


def ball_depth(centre, radius, ray, origin):
    """Depth at which rays from ``origin`` first meet a ball; infinite where they miss."""
    apart = origin - np.asarray(centre)
    a, b = (ray * ray).sum(-1), (ray * apart).sum(-1)
    root = b * b - a * ((apart * apart).sum(-1) - radius**2)
    return np.where(root >= 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)


def test_disparity_of_a_ball():
    centre = [0.4, 0.1, 5.0]
    _, disparity, _ = render(wall(20.0), surface(QUADRIC, centre, np.diag([1.0, 1.0, 1.0])))
    depth = np.minimum(ball_depth(centre, 1.0, rays(), np.zeros(3)), 20.0)
    wrong = np.abs(disparity - FOCAL * BASELINE / depth) > 1e-3
    assert wrong.mean() < 0.002  # the outline, where the root is all rounding
    # The ray through the centre meets the ball one radius before it.
    depth = 5.0 * (1 - 1 / np.linalg.norm(centre))
    assert disparity[42, 68] == pytest.approx(FOCAL * BASELINE / depth, abs=1e-3)


def test_a_thin_distant_pole_keeps_its_disparity_and_width():
    axes = np.array([[0.05, 0, 0], [0, 0, 3.0], [0, 0.05, 0]])  # its z axis points down
    pole = surface(QUADRIC, [0.0, 0.0, 4.0], axes, CYLINDER)
    _, disparity, _ = render(wall(50.0), pole)
    # Radius 0.05 m at 4 m and 100 px is 1.25 px: columns 59, 60 and 61.
    assert np.flatnonzero(disparity[40] > 5).tolist() == [59, 60, 61]
    assert disparity[40, 60] == pytest.approx(FOCAL * BASELINE / 3.95, abs=1e-3)


def test_a_card_hides_as_many_columns_as_disparities_differ():
    card = surface(RECTANGLE, [0.0, 0.0, 4.0], np.diag([0.8, 0.8, 1.0]))
    _, disparity, occluded = render(wall(10.0), card)
    # At 4 m the card spans columns 40..80 and has 12.5 px; the wall has 5 px.
    row = occluded[40]
    hidden = np.flatnonzero(row[5:]) + 5
    assert hidden.min() in (32, 33) and hidden.max() == 39
    assert row[:5].all()  # outside the right image
    assert not occluded[:15, 6:].any() and not occluded[40, 40:].any()
    assert disparity[40, 40] == pytest.approx(12.5) and disparity[40, 39] == pytest.approx(5)


def test_occlusion_by_a_ball_agrees_with_lines_of_sight():
    centre, radius = [0.3, 0.0, 3.0], 0.7
    ball = surface(QUADRIC, centre, np.diag([radius] * 3))
    _, disparity, occluded = render(wall(9.0), ball)
    right = np.array([BASELINE, 0, 0])
    point = rays() * (FOCAL * BASELINE / disparity)[..., None]
    sight = (point - right) / point[..., 2:]
    blocked = ball_depth(centre, radius, sight, right) < point[..., 2] - 1e-3
    outside = np.arange(SIZE[1]) - disparity < -0.5
    assert blocked.sum() > 300
    assert (occluded != (blocked | outside)).mean() < 0.01


def test_the_lamp_casts_a_shadow():
    # Half way between the lamp and the wall: the shadow is twice as large and twice as far aside.
    card = surface(RECTANGLE, [1.0, 0.0, 4.0], np.diag([0.3, 0.3, 1.0]))
    image, disparity, _ = render(wall(8.0), card, light=(0.0, 0.0, 0.0))
    grey = image[0].mean(0)
    assert disparity[40, 85] > 12 and disparity[40, 60] < 7
    # Seen from the lamp's own place shadows hide behind the card; from the right they show.
    right = image[1].mean(0)
    column = round(CX + FOCAL * (2.0 - BASELINE) / 8.0 + 6)  # beyond the card in the right view
    assert right[40, column] < 0.6 * right[10, column]
    assert grey[40, 40] == pytest.approx(float(grey[10, 40]), rel=0.2)


def test_texels_are_sampled_bilinearly_mirrored_and_averaged():
    image = np.zeros((1, 4, 4, 3), np.uint8)
    image[0, :, :, 0] = [[10, 20, 30, 40]] * 4
    image[0, :, :, 1] = np.array([[0], [60], [120], [180]])
    image[0, :, :, 2] = 7
    bank = TextureBank(image, 1, torch.device("cpu"))
    x = torch.tensor([1.5, 2.0, 4.5, 9.5, 2.0])
    y = torch.tensor([2.5, 2.0, 0.5, 0.5, 2.0])
    level = torch.tensor([0.0, -3.0, 0.0, 0.0, 9.0])
    colour = bank.sample(torch.zeros(5, dtype=torch.long), x, y, level)
    expected = [[20, 25, 40, 20, 25], [120, 90, 0, 0, 90], [7] * 5]
    torch.testing.assert_close(colour, torch.tensor(expected, dtype=torch.float32))


@pytest.fixture(scope="module")
def alone(scenes):
    """Scenes rendered one by one, each once."""
    return functools.cache(lambda index: scenes[index])


@settings(max_examples=12, deadline=None)
@given(indices=st.lists(st.integers(0, 9), min_size=1, max_size=4), noise=st.integers(0, 2**32 - 1))
def test_a_scene_does_not_depend_on_its_batch_or_on_global_random_state(
    scenes, alone, indices, noise
):
    torch.manual_seed(noise)
    np.random.seed(noise)
    together = scenes.batch(indices)
    assert together.name == ",".join(f"scene {index}" for index in indices)
    for place, index in enumerate(indices):
        expected = alone(index)
        same = (together.disparity[place] - expected.disparity).abs() < 1e-3
        assert same.float().mean() > 0.999
        for side in ("left", "right"):
            change = getattr(together, side)[place] - getattr(expected, side)
            assert (change.abs() < 1 / 255).float().mean() > 0.999
        assert (together.occluded[place] == expected.occluded).float().mean() > 0.999


def test_index_and_seed_change_the_scene(scenes):
    first, second = scenes[0], scenes[1]
    other = ProceduralScenes(replace(SMALL, seed=1))[0]
    for sample in (second, other):
        assert (first.disparity - sample.disparity).abs().mean() > 0.1
        assert (first.left - sample.left).abs().mean() > 0.02


def test_the_right_view_warped_by_the_disparity_is_the_left_view(scenes):
    sample = scenes.batch(range(12))
    _, height, width = sample.disparity.shape
    x = torch.arange(width) - sample.disparity
    y = torch.arange(height)[:, None].expand_as(x)
    grid = torch.stack([2 * x / (width - 1) - 1, 2 * y / (height - 1) - 1], -1)
    warped = F.grid_sample(sample.right, grid, align_corners=True, padding_mode="border")
    error = (warped - sample.left).abs().mean(1)
    seen, hidden = error[~sample.occluded].mean(), error[sample.occluded].mean()
    assert seen < 0.02
    assert hidden > 5 * seen


@pytest.mark.parametrize("kind", LAYOUTS)
def test_every_layout_covers_the_view(kind):
    config = replace(SMALL, kinds={kind: 1.0})
    sample = ProceduralScenes(config).batch([0, 1, 2])
    assert sample.left.shape == sample.right.shape == (3, 3, 64, 128)
    assert sample.left.dtype == sample.disparity.dtype == torch.float32
    assert sample.valid.all() and torch.isfinite(sample.disparity).all()
    for image in (sample.left, sample.right):
        assert image.min() >= 0 and image.max() <= 1 and image.std() > 0.03
    assert sample.occluded.any() and sample.occluded.float().mean() < 0.6


def test_slanted_backdrops_cover_wide_views():
    config = replace(SMALL, max_disparity=192, kinds={"planes": 1.0}, noise_textures=4, rays=1)
    # Of the first hundred scenes those in which a wall as slanted as any ended within the view.
    assert ProceduralScenes(config).batch([13, 35, 53, 60]).valid.all()


def test_disparities_spread_over_range_and_fractions(scenes):
    disparity = torch.cat([scenes.batch(range(at, at + 12)).disparity for at in range(0, 60, 12)])
    largest = disparity.flatten(1).quantile(0.98, 1)
    assert disparity.min() > 0 and disparity.min() < 1
    assert 0.2 < (largest < 20).float().mean() < 0.9
    assert (largest < 1.5 * SMALL.max_disparity).float().mean() > 0.9
    shares = torch.histc(disparity % 1, 10, 0, 1) / disparity.numel()
    assert shares.min() > 0.05


def test_more_rays_smooth_the_image_and_leave_the_truth():
    one, two = (ProceduralScenes(replace(SMALL, rays=rays)).batch([2, 4]) for rays in (1, 2))
    assert torch.equal(one.disparity, two.disparity)

    def roughness(image):
        return (image[..., 1:] - image[..., :-1]).square().mean()

    assert roughness(two.left) < 0.95 * roughness(one.left)


def test_a_sample_knows_its_calibration(scenes):
    sample, scene = scenes[6], scenes.scene(6)
    assert sample.left.shape == (3, 64, 128) and sample.disparity.shape == (64, 128)
    assert sample.calibration.focal == scene.focal and sample.calibration.cx == scene.cx
    assert sample.calibration.baseline == scene.baseline > 0
    assert len(scenes) == SMALL.length
    with pytest.raises(IndexError):
        scenes[SMALL.length]


def test_textures_come_from_a_folder(tmp_path, scenes):
    (tmp_path / "deep").mkdir()
    red = np.zeros((40, 70, 3), np.uint8)
    red[..., 2] = 255  # OpenCV's order
    cv2.imwrite(str(tmp_path / "deep" / "red.png"), red)
    (tmp_path / "notes.txt").write_text("not an image")

    def reddish(sample):
        r, g, b = sample.left.unbind(1)
        return ((r > 4 * g) & (r > 4 * b)).float().mean()

    with_red = ProceduralScenes(SMALL, textures=tmp_path).batch(range(6))
    assert reddish(with_red) > 0.3
    assert reddish(scenes.batch(range(6))) < 0.1


def test_large_near_surfaces_can_be_textureless(scenes):
    shares = []
    for chance in (0.5, 1.0):
        bare = ProceduralScenes(replace(SMALL, textureless=chance))
        faded, large, far = [], [], []
        for index in range(12):
            before, after = scenes.scene(index).surfaces, bare.scene(index).surfaces
            change = after.contrast / before.contrast
            assert ((change == 1) | ((change > 0.009) & (change < 0.101))).all()
            depth = before.centre[:, 2].clip(1e-6)
            half = np.linalg.norm(before.axes, axis=1)[:, :2].min(1)
            faded.append(change < 1)
            large.append(half * scenes.scene(index).focal / depth > 0.13 * SMALL.width)
            far.append(depth > 8 * 8.0)  # no layout's nearest things are beyond 8 m
            for name in ("centre", "axes", "texture", "colour", "density"):
                assert np.array_equal(getattr(after, name), getattr(before, name))
        faded, large, far = (np.concatenate(each) for each in (faded, large, far))
        assert not faded[far].any() and (large & far).any()
        shares.append(faded[large & ~far].mean())
        assert faded[~large].mean() < 0.01
    assert 0.4 * shares[1] < shares[0] < 0.6 * shares[1] and shares[1] > 0.8


def test_a_folder_without_images_is_an_error(tmp_path):
    with pytest.raises(InputError, match="no readable image below"):
        ProceduralScenes(SMALL, textures=tmp_path)
    with pytest.raises(FileNotFoundError, match="nowhere"):
        ProceduralScenes(SMALL, textures=tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rays": 3}, "rays must be 1 or 2, got 3"),
        ({"length": 0}, "length must be at least 1"),
        ({"min_disparity": 60.0}, "min_disparity <= max_disparity"),
        ({"texture_size": 100}, "power of two, got 100"),
        ({"textureless": 1.5}, "textureless must be from 0 to 1, got 1.5"),
        ({"seed": -1}, "seed must be from 0"),
        ({"objects": (5, 2)}, "objects must be a range"),
        ({"kinds": {"moon": 1.0}}, "weights for some of room, street"),
        ({"kinds": {}}, "weights for some of"),
        ({"kinds": {"room": math.inf}}, "weights for some of"),
        ({"height": 1}, "height must be at least 2"),
        ({"width": 1}, "width must be at least 2"),
        ({"max_disparity": math.inf}, "max_disparity <= 1e[+]06 must hold"),
        ({"min_disparity": 1e-300}, "1e-06 <= min_disparity"),
        ({"seed": 2**64}, "seed must be from 0 to 2[*][*]64 - 1"),
        ({"objects": (0, 10**9)}, "objects must be a range of counts up to 10000"),
    ],
)
def test_bad_settings_are_named(change, message):
    with pytest.raises(InputError, match=message):
        replace(SMALL, **change)


TINY = replace(SMALL, height=32, width=48, max_disparity=24, noise_textures=4, texture_size=16)


@pytest.mark.parametrize(
    "change",
    [
        {"objects": (1500, 1500), "kinds": {"clutter": 1}},
        {"objects": (0, 0)},
        {"height": 2, "width": 2},
        {"noise_textures": 1, "texture_size": 2},
        {"textureless": 1.0, "rays": 1},
        {"min_disparity": 1e-6, "max_disparity": 1e-6},
        {"min_disparity": 1e6, "max_disparity": 1e6},
        {"seed": 2**64 - 1},
        {"kinds": {"room": 1e-300, "park": 0}},
    ],
)
def test_extreme_settings_work(change):
    scenes = ProceduralScenes(replace(TINY, **change))
    for index in range(3):
        sample = scenes.batch([index])
        assert sample.left.isfinite().all() and sample.disparity.isfinite().all()


def test_many_surfaces_have_materials_of_their_own():
    scenes = ProceduralScenes(replace(TINY, objects=(1500, 1500), kinds={"clutter": 1}))
    looks = scenes.scene(0).surfaces
    assert len(np.unique(looks.colour, axis=0)) > 1400


def test_many_things_appear_before_what_was_there(scenes):
    indices = [0, 1, 2, 3]
    before = scenes.batch(indices)
    for name, farthest in (("background", 0.35), ("floating", 1.1)):
        after = ProceduralScenes(replace(SMALL, **{name: 1.0})).batch(indices)
        changed = after.disparity > before.disparity + 1e-3
        assert (after.disparity > before.disparity - 1e-3).all()
        assert 0.02 < changed.float().mean() < 0.8
        assert after.disparity[changed].max() < 1.3 * farthest * SMALL.max_disparity


def test_the_chance_of_many_things():
    config = replace(SMALL, noise_textures=4, kinds={"planes": 1.0}, objects=(0, 0))
    counts = {}
    for chance in (0.0, 0.4, 1.0):
        scenes = ProceduralScenes(replace(config, floating=chance))
        counts[chance] = [len(scenes.scene(index).surfaces.shape) for index in range(60)]
    assert max(counts[0.0]) < 10 and min(counts[1.0]) > 80
    share = np.mean([count > 80 for count in counts[0.4]])
    assert 0.15 < share < 0.65  # 4 standard deviations


def _matched(sample):
    """The right view as seen from the left one, by the ground truth."""
    height, width = sample.disparity.shape[-2:]
    x = (2 * (torch.arange(width) - sample.disparity) + 1) / width - 1
    y = (2 * torch.arange(height)[:, None] + 1) / height - 1
    grid = torch.stack((x, y.expand_as(x)), -1)
    return F.grid_sample(sample.right, grid, align_corners=False)


def test_mirrors_change_the_views_and_not_the_geometry(scenes):
    indices = list(range(6))
    plain = scenes.batch(indices)
    shiny = ProceduralScenes(replace(SMALL, mirrors=1.0)).batch(indices)
    assert torch.equal(shiny.disparity, plain.disparity)
    assert torch.equal(shiny.occluded, plain.occluded)

    def mismatch(sample):
        """Median difference of matching pixels, relative to the contrast."""
        error = (_matched(sample) - sample.left).abs().mean(1)[~sample.occluded]
        return float(error.median() / sample.left.std())

    assert mismatch(shiny) > 2 * mismatch(plain)


def test_what_a_mirror_shows_stays_where_it_is_infinitely_far_away():
    """A flat mirror across the view: its picture has no disparity, the mirror itself has."""
    texture = np.random.default_rng(0).integers(0, 255, (2, 16, 16, 3), np.uint8)
    texture[0] = 0
    bank = TextureBank(texture, 2, torch.device("cpu"))
    scene = make_scene(wall(4))
    surfaces = replace(scene.surfaces, mirror=np.array([1.0]), colour=np.zeros((1, 3)))
    scene = replace(scene, surfaces=surfaces, surroundings=1)
    masks = torch.ones(1, 4, 4, dtype=torch.bool)
    images, disparity, _ = render_scenes([scene], SIZE, 1, bank, masks)
    assert disparity.min() > 2
    assert images[0].std() > 0.02
    torch.testing.assert_close(images[0, 0], images[0, 1], atol=1e-4, rtol=0)


def test_reliefs_match_their_disparity():
    config = replace(SMALL, reliefs=1.0, max_disparity=30.0)
    sample = ProceduralScenes(config).batch(range(8))
    assert sample.valid.all() and sample.disparity.max() <= 30
    assert sample.disparity.min() >= 0.05 * SMALL.min_disparity
    assert 0.02 < sample.occluded.float().mean() < 0.5
    seen = _matched(sample)
    # Edges of layers are mixed; elsewhere the two views agree up to what resampling blurs.
    edge = F.max_pool2d(sample.disparity, 5, 1, 2) + F.max_pool2d(-sample.disparity, 5, 1, 2) > 1.5
    inside = ~sample.occluded & ~edge
    assert inside.float().mean() > 0.3
    error = (seen - sample.left).abs().mean(1)
    shifted = (seen.roll(1, -1) - sample.left).abs().mean(1)
    assert error[inside].mean() < 0.5 * shifted[inside].mean()
    assert error[sample.occluded].mean() > 2 * error[inside].mean()


def test_reliefs_are_a_share_of_the_scenes(scenes):
    some = ProceduralScenes(replace(SMALL, reliefs=0.5))
    reliefs = [index for index in range(12) if some[index].calibration is None]
    assert 1 <= len(reliefs) <= 11
    together, plain = some.batch(range(12)), scenes.batch(range(12))
    for index in range(12):
        assert torch.allclose(together.left[index], some.batch([index]).left[0], atol=1e-5)
        same = torch.allclose(together.left[index], plain.left[index], atol=1e-5)
        assert same == (index not in reliefs)


def test_photographs_are_on_reliefs_if_there_are_some(tmp_path):
    cv2.imwrite(str(tmp_path / "red.png"), np.full((40, 40, 3), (0, 0, 255), np.uint8))
    config = replace(SMALL, reliefs=1.0)
    sample = ProceduralScenes(config, textures=tmp_path).batch(range(2))
    assert (sample.left[:, 0] > 0.95).all() and (sample.left[:, 1] < 0.05).all()
