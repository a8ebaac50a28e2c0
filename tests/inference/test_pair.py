"""Reading a pair: every form of a view, and what is refused."""

import numpy as np
import pytest
import torch
from PIL import Image

from mobilestereonet import InputError, StereoMatcher
from mobilestereonet.inference import load_pair


def random_pair(height, width, seed=0):
    return tuple(
        np.random.default_rng(seed).integers(0, 256, (2, height, width, 3), dtype=np.uint8)
    )


def few_colours():
    """An image that a palette of 64 colours holds without loss."""
    image = Image.fromarray(random_pair(20, 40)[0]).quantize(64).convert("RGB")
    assert len(image.getcolors(64)) > 32
    return image


def with_palette(alpha=False):
    image = few_colours().quantize(64)
    assert image.mode == "P"
    return image.convert("PA") if alpha else image


@pytest.mark.parametrize(
    ("image", "expected"),
    [
        (with_palette(), few_colours()),
        (with_palette(alpha=True), few_colours()),
        (few_colours().convert("RGBA"), few_colours()),
        (few_colours().convert("RGBX"), few_colours()),
        (few_colours().convert("RGBA").convert("RGBa"), few_colours()),
        (few_colours().convert("CMYK"), few_colours()),
        (few_colours().convert("L"), few_colours().convert("L")),
        (few_colours().convert("LA"), few_colours().convert("L")),
        (few_colours().convert("LA").convert("La"), few_colours().convert("L")),
        (few_colours().convert("1"), few_colours().convert("1")),
        (few_colours().convert("YCbCr"), few_colours().convert("YCbCr").convert("RGB")),
        (few_colours().convert("HSV"), few_colours().convert("HSV").convert("RGB")),
    ],
    ids=lambda image: image.mode,
)
def test_a_pil_image_is_read_by_the_meaning_of_its_mode(image, expected):
    pixels = np.asarray(expected.convert("RGB"))
    pair = load_pair(image, image)
    np.testing.assert_array_equal(pair.left_image, pixels)
    np.testing.assert_array_equal(pair.left.permute(1, 2, 0), pixels / np.float32(255))


@pytest.mark.parametrize("mode", ["I;16", "I;16B", "I;16L", "I"])
def test_a_16_bit_pil_image_is_divided_by_65535(mode):
    levels = np.random.default_rng(0).integers(0, 65536, (20, 40), dtype=np.uint16)
    stored = levels.astype(">u2" if mode == "I;16B" else "<i4" if mode == "I" else "<u2")
    image = Image.frombytes(mode, (40, 20), stored.tobytes())
    left = load_pair(image, image).left
    torch.testing.assert_close(left[1], torch.from_numpy(levels / 65535).float())


def test_a_pil_image_of_floats_must_lie_in_0_to_1():
    values = np.random.default_rng(0).random((20, 40), dtype=np.float32)
    image = Image.fromarray(values)
    assert image.mode == "F"
    torch.testing.assert_close(load_pair(image, image).left[2], torch.from_numpy(values))
    loud = Image.fromarray(200 * values)
    with pytest.raises(InputError, match=r"right view: .*0\.\.1, got .* to 19\d"):
        load_pair(image, loud)
    far = Image.fromarray(np.full((20, 40), 70_000, np.int32))
    with pytest.raises(InputError, match=r"left view: .*mode I .*0\.\.65535, got 70000 to 70000"):
        load_pair(far, far)


@pytest.mark.parametrize(
    "views",
    [
        ("left.png",),
        (np.zeros((20, 40, 3), np.uint8),),
        (np.zeros((2, 20, 40, 3), np.uint8),),
        (torch.zeros(2, 3, 20, 40),),
        ([("left.png", "right.png")],),
        ("left.png", None),
    ],
    ids=["path", "array", "two arrays", "tensors", "list of pairs", "None"],
)
def test_a_missing_right_view_is_told(views):
    matcher = StereoMatcher.from_pretrained("sgbm")
    with pytest.raises(InputError, match=r"no right view: .*matcher\(left, right\).*batch"):
        matcher(*views)


def test_a_view_of_no_known_type_is_named():
    with pytest.raises(InputError, match=r"right view: .*path, an array, a tensor .* got dict"):
        load_pair(random_pair(20, 40)[0], {"path": "right.png"})


def test_the_bytes_of_a_pair_are_kept_for_pictures():
    left, right = random_pair(20, 40)
    pair = load_pair(left, right)
    np.testing.assert_array_equal(pair.left_image, left)
    np.testing.assert_array_equal(pair.right_image, right)
    grey = load_pair(left[..., 0], right[..., :1])
    np.testing.assert_array_equal(grey.left_image, left[..., :1].repeat(3, axis=2))
    floats = load_pair(left / 255, (right / 255).astype(np.float32))
    np.testing.assert_array_equal(floats.left_image, left)
    np.testing.assert_array_equal(floats.right_image, right)


def test_a_tensor_stays_on_its_device():
    left, right = torch.rand(2, 3, 20, 40)
    pair = load_pair(left, right[None])
    assert pair.left.data_ptr() == left.data_ptr()
    assert torch.equal(pair.right, right)
    bytes_ = load_pair(*(torch.from_numpy(view).permute(2, 0, 1) for view in random_pair(20, 40)))
    np.testing.assert_array_equal(bytes_.left_image, random_pair(20, 40)[0])
    half = load_pair(left.half(), right.bfloat16())
    assert half.left.dtype == half.right.dtype == torch.float32


@pytest.mark.parametrize(
    ("view", "message"),
    [
        (torch.zeros(3, 20, 40, dtype=torch.int64), "int64"),
        (torch.zeros(5, 20, 40), r"\(3, H, W\), got \(5, 20, 40\)"),
        (torch.zeros(2, 3, 20, 40), r"got \(2, 3, 20, 40\): several pairs go to .*batch"),
    ],
)
def test_bad_tensors_are_named(view, message):
    with pytest.raises(InputError, match=message):
        load_pair(view, view)


@pytest.mark.parametrize("alone", [True, False])
def test_an_unknown_layout_is_refused(alone):
    left, right = random_pair(20, 40)
    with pytest.raises(InputError, match="side-by-side, top-bottom; got 'top-down'"):
        load_pair(left, None if alone else right, layout="top-down")
