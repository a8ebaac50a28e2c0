"""Image, PFM and disparity files: readers on hand-made bytes, writers through other readers."""

import os
import stat
import struct

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from extras import need_extra
from mobilestereonet.data import (
    Calibration,
    image_to_tensor,
    read_depth_as_disparity,
    read_disparity,
    read_disparity_exr,
    read_disparity_fsd,
    read_disparity_hdf5,
    read_disparity_pfm,
    read_disparity_png,
    read_disparity_sintel,
    read_image,
    read_pfm,
    write_atomically,
    write_disparity_png,
    write_npy,
    write_pfm,
    write_png,
)
from mobilestereonet.errors import InputError

RGB = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [10, 20, 30]]], np.uint8)
GREY = np.array([[0, 50], [100, 255]], np.uint8)


@pytest.mark.parametrize(
    ("name", "image", "expected"),
    [
        ("colour.png", Image.fromarray(RGB), RGB),
        ("colour.bmp", Image.fromarray(RGB), RGB),
        ("alpha.png", Image.fromarray(np.dstack([RGB, GREY])), RGB),
        ("palette.png", Image.fromarray(RGB).quantize(4), RGB),
        ("grey.png", Image.fromarray(GREY), np.dstack([GREY] * 3)),
        (
            "grey_alpha.png",
            Image.merge("LA", [Image.fromarray(GREY)] * 2),
            np.dstack([GREY] * 3),
        ),
        (
            "grey16.png",
            Image.fromarray(GREY.astype(np.uint16) * 257),
            np.dstack([GREY.astype(np.uint16) * 257] * 3),
        ),
    ],
)
def test_read_image_gives_rgb_of_the_files_dtype(tmp_path, name, image, expected):
    image.save(tmp_path / name)
    result = read_image(tmp_path / name)
    assert result.dtype == expected.dtype
    np.testing.assert_array_equal(result, expected)


def test_read_image_16_bit_colour_and_jpeg(tmp_path):
    deep = RGB.astype(np.uint16) * 257
    cv2.imwrite(str(tmp_path / "deep.png"), deep[..., ::-1])
    result = read_image(str(tmp_path / "deep.png"))
    assert result.dtype == np.uint16
    np.testing.assert_array_equal(result, deep)

    red = np.zeros((16, 16, 3), np.uint8) + np.array([200, 30, 40], np.uint8)
    Image.fromarray(red).save(tmp_path / "red.jpg", quality=95)
    assert np.abs(read_image(tmp_path / "red.jpg").astype(int) - red).max() <= 4


def test_read_image_names_what_is_wrong(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nothing\.png: no such file"):
        read_image(tmp_path / "nothing.png")
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_image(tmp_path)
    Image.fromarray(np.zeros((64, 64, 3), np.uint8)).save(tmp_path / "whole.png")
    whole = (tmp_path / "whole.png").read_bytes()
    for name, content in {"text": b"hello", "empty": b"", "half": whole[: len(whole) // 2]}.items():
        path = tmp_path / f"{name}.png"
        path.write_bytes(content)
        with pytest.raises(InputError, match=f"{name}.png: not an image"):
            read_image(path)
    cv2.imwrite(str(tmp_path / "signed.tiff"), np.zeros((2, 2), np.int16))
    with pytest.raises(InputError, match="int16"):
        read_image(tmp_path / "signed.tiff")


def test_image_to_tensor_scales_each_dtype():
    expected = torch.tensor(
        [[[1, 0], [0, 10 / 255]], [[0, 1], [0, 20 / 255]], [[0, 0], [1, 30 / 255]]]
    )
    for image in (RGB, RGB.astype(np.uint16) * 257, RGB / 255, (RGB / 255).astype(np.float32)):
        tensor = image_to_tensor(image)
        assert tensor.dtype == torch.float32
        assert tensor.is_contiguous()
        torch.testing.assert_close(tensor, expected, rtol=0, atol=1e-7)


def test_image_to_tensor_channels_and_memory():
    grey = image_to_tensor(GREY)
    assert grey.shape == (3, 2, 2)
    torch.testing.assert_close(image_to_tensor(GREY[..., None]), grey)
    assert grey[2, 0, 1].item() == pytest.approx(50 / 255)
    torch.testing.assert_close(image_to_tensor(np.dstack([RGB, GREY])), image_to_tensor(RGB))

    image = np.full((2, 2, 3), 0.5, np.float32)
    image_to_tensor(image).zero_()
    assert image.min() == 0.5


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((2, 2, 2), np.uint8), "shape"),
        (np.zeros((1, 2, 2, 3), np.uint8), "shape"),
        (np.zeros((0, 2, 3), np.uint8), "shape"),
        (np.zeros((2, 2), np.int32), "int32"),
        (np.zeros((2, 2), bool), "bool"),
        (np.full((2, 2), 1.5), "0..1, got 1.5 to 1.5"),
        (np.full((2, 2), -0.1), "0..1"),
        (np.array([[0.5, np.nan]]), "nan"),
        (np.array([[0.5, np.inf]]), "inf"),
    ],
)
def test_image_to_tensor_refuses(image, message):
    with pytest.raises(InputError, match=message):
        image_to_tensor(image)


ROWS = [[1.5, -2.0, 3.0], [4.0, 5.0, 6.25]]  # top row first
BOTTOM_UP = [4.0, 5.0, 6.25, 1.5, -2.0, 3.0]


@pytest.mark.parametrize(
    "header",
    [
        b"Pf\n3 2\n-1.0\n",
        b"Pf \n3 2 \n-1.0\n",  # SceneFlow
        b"Pf\r\n3 2\r\n-1.0\r\n",
        b"Pf\n3\n2\n-1\n",
        b"Pf 3 2 -1.000000 \n",
        b"Pf\n3 2\n-0.003922\n",  # Middlebury
        b"Pf\n# made by hand\n3 2\n-1e0\t\n",
    ],
)
def test_read_pfm_headers(tmp_path, header):
    path = tmp_path / "a.pfm"
    path.write_bytes(header + struct.pack("<6f", *BOTTOM_UP))
    result = read_pfm(path)
    assert result.dtype == np.float32
    assert result.dtype.isnative
    np.testing.assert_array_equal(result, np.array(ROWS, np.float32))


@pytest.mark.parametrize("scale", [b"1.0", b"+255", b"0.003922"])
def test_read_pfm_big_endian(tmp_path, scale):
    path = tmp_path / "a.pfm"
    path.write_bytes(b"Pf\n3 2\n" + scale + b"\n" + struct.pack(">6f", *BOTTOM_UP))
    result = read_pfm(path)
    assert result.dtype.isnative
    np.testing.assert_array_equal(result, np.array(ROWS, np.float32))


def test_read_pfm_values_that_look_like_white_space(tmp_path):
    path = tmp_path / "a.pfm"
    path.write_bytes(b"Pf\n1 1\n-1.0\n" + b"\x0a\x20\x0a\x41")
    assert read_pfm(path)[0, 0] == struct.unpack("<f", b"\x0a\x20\x0a\x41")[0]


def test_read_pfm_colour(tmp_path):
    path = tmp_path / "a.pfm"
    path.write_bytes(b"PF\n1 2\n-1.0\n" + struct.pack("<6f", *range(6)))
    np.testing.assert_array_equal(read_pfm(path), [[[3, 4, 5]], [[0, 1, 2]]])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"Pf\n3 2\n-1.0\n" + bytes(23), "needs 24 bytes after the header, found 23"),
        (b"PF\n3 2\n-1.0\n" + bytes(24), "needs 72 bytes"),
        (b"Pf\n0 2\n-1.0\n" + bytes(24), "0x2"),
        (b"Pf\n3 2\n0.0\n" + bytes(24), "scale"),
        (b"Pf\n3 2\nx\n" + bytes(24), "scale"),
        (b"P5\n3 2\n255\n" + bytes(6), "not a PFM"),
        (b"Pf" + b"\n" * 5000 + b"x", "not a PFM"),
        (b"", "not a PFM"),
    ],
)
def test_read_pfm_refuses(tmp_path, content, message):
    (tmp_path / "bad.pfm").write_bytes(content)
    with pytest.raises(InputError, match=rf"bad\.pfm.*{message}"):
        read_pfm(tmp_path / "bad.pfm")


def test_write_pfm_bytes_and_opencv(tmp_path):
    values = np.array(ROWS)
    write_pfm(tmp_path / "a.pfm", values)
    expected = b"Pf\n3 2\n-1.0\n" + struct.pack("<6f", *BOTTOM_UP)
    assert (tmp_path / "a.pfm").read_bytes() == expected
    np.testing.assert_array_equal(
        cv2.imread(str(tmp_path / "a.pfm"), cv2.IMREAD_UNCHANGED), values.astype(np.float32)
    )
    colour = np.arange(12, dtype=np.float32).reshape(2, 2, 3)
    write_pfm(tmp_path / "c.pfm", colour)
    np.testing.assert_array_equal(read_pfm(tmp_path / "c.pfm"), colour)
    with pytest.raises(InputError, match=r"\(2, 2, 2\)"):
        write_pfm(tmp_path / "d.pfm", np.zeros((2, 2, 2)))


def test_read_disparity_png(tmp_path):
    Image.fromarray(np.array([[0, 1, 256, 65535]], np.uint16)).save(tmp_path / "d.png")
    disparity, valid = read_disparity_png(tmp_path / "d.png")
    assert disparity.dtype == np.float32
    assert valid.dtype == bool
    np.testing.assert_array_equal(disparity, [[0, 1 / 256, 1, 65535 / 256]])
    np.testing.assert_array_equal(valid, [[False, True, True, True]])
    np.testing.assert_array_equal(read_disparity(tmp_path / "d.png")[0], disparity)
    assert read_disparity(tmp_path / "d.png", scale=128)[0][0, 2] == 2

    Image.fromarray(np.array([[0, 10, 255]], np.uint8)).save(tmp_path / "m.png")
    for reader in (lambda p: read_disparity_png(p, 4, bits=8), lambda p: read_disparity(p, 4)):
        disparity, valid = reader(tmp_path / "m.png")
        np.testing.assert_array_equal(disparity, [[0, 2.5, 63.75]])
        np.testing.assert_array_equal(valid, [[False, True, True]])
    with pytest.raises(InputError, match="16-bit image, got uint8"):
        read_disparity_png(tmp_path / "m.png")
    with pytest.raises(InputError, match="8-bit image, got uint16"):
        read_disparity_png(tmp_path / "d.png", 4, bits=8)
    with pytest.raises(InputError, match="needs its scale"):
        read_disparity(tmp_path / "m.png")
    Image.fromarray(RGB).save(tmp_path / "colour.png")
    with pytest.raises(InputError, match="grey"):
        read_disparity(tmp_path / "colour.png", 4)


def test_write_disparity_png(tmp_path):
    disparity = np.array([[0.001, 1.5, 100.25, np.nan], [np.inf, -3, 0, 7]])
    valid = np.ones((2, 4), bool)
    valid[1, 3] = False
    write_disparity_png(tmp_path / "d.png", disparity, valid)
    levels = np.asarray(Image.open(tmp_path / "d.png"))
    np.testing.assert_array_equal(levels, [[1, 384, 25664, 0], [0, 0, 0, 0]])
    write_disparity_png(tmp_path / "d.png", np.array([[300.0]]), scale=100)
    assert np.asarray(Image.open(tmp_path / "d.png")) == 30000
    with pytest.raises(InputError, match=r"300 does not fit.*255\.996"):
        write_disparity_png(tmp_path / "e.png", np.array([[300.0]]))
    assert not (tmp_path / "e.png").exists()


@pytest.mark.parametrize("sign", [1, -1])
def test_read_disparity_pfm_sign_and_unknown(tmp_path, sign):
    # Most pixels tell the sign; a pixel of the other sign is not a disparity.
    values = np.array([[2.5, 3.5, -1.0], [np.inf, np.nan, 0.0], [-np.inf, 4.0, 5.0]]) * sign
    content = b"Pf\n3 3\n-1\n" + struct.pack("<9f", *values[::-1].ravel())
    (tmp_path / "d.pfm").write_bytes(content)
    for reader in (read_disparity_pfm, read_disparity):
        disparity, valid = reader(tmp_path / "d.pfm")
        np.testing.assert_array_equal(disparity, [[2.5, 3.5, 0], [0, 0, 0], [0, 4, 5]])
        np.testing.assert_array_equal(valid, [[1, 1, 0], [0, 0, 0], [0, 1, 1]])
    (tmp_path / "c.pfm").write_bytes(b"PF\n1 1\n-1\n" + bytes(12))
    with pytest.raises(InputError, match="three channels"):
        read_disparity_pfm(tmp_path / "c.pfm")


def test_read_disparity_sintel(tmp_path):
    packed = np.array([[[10, 32, 128], [0, 0, 0], [255, 255, 255]]], np.uint8)
    Image.fromarray(packed).save(tmp_path / "d.png")
    disparity, valid = read_disparity_sintel(tmp_path / "d.png")
    # 4 * 10 + 32 / 64 + 128 / 16384
    np.testing.assert_allclose(disparity[0, :2], [40.5078125, 0], rtol=0)
    assert disparity[0, 2] == pytest.approx(1020 + 255 / 64 + 255 / 16384, abs=1e-4)
    np.testing.assert_array_equal(valid, [[True, False, True]])
    Image.fromarray(GREY).save(tmp_path / "grey.png")
    with pytest.raises(InputError, match="Sintel"):
        read_disparity_sintel(tmp_path / "grey.png")


def test_depth_in_centimetres(tmp_path):
    Image.fromarray(np.array([[100, 5000, 65534, 65535, 0]], np.uint16)).save(tmp_path / "d.png")
    calibration = Calibration(focal=725.0087, baseline=0.532725)
    disparity, valid = read_depth_as_disparity(tmp_path / "d.png", calibration, 100)
    # At 1 m the disparity is focal times baseline: 725.0087 * 0.532725 = 386.23026.
    np.testing.assert_allclose(disparity[0, :3], [386.23026, 7.7246052, 0.5893586], rtol=1e-6)
    np.testing.assert_array_equal(disparity[0, 3:], [0, 0])
    np.testing.assert_array_equal(valid, [[True, True, True, False, False]])


def test_depth_in_metres(tmp_path):
    np.save(tmp_path / "d.npy", np.array([[16, 1e4, 0, -1, np.inf, np.nan]], np.float32))
    calibration = Calibration(focal=320, baseline=0.25)
    disparity, valid = read_depth_as_disparity(tmp_path / "d.npy", calibration)
    np.testing.assert_allclose(disparity, [[5, 0.008, 0, 0, 0, 0]], rtol=1e-6)
    np.testing.assert_array_equal(valid, [[True, True, False, False, False, False]])


def test_read_disparity_fsd(tmp_path):
    packed = np.array([[[0, 16, 31], [1, 0, 0], [2, 1, 254], [0, 0, 0]]], np.uint8)
    Image.fromarray(packed).save(tmp_path / "d.png")
    disparity, valid = read_disparity_fsd(tmp_path / "d.png")
    # The base is 255: 16 * 255 + 31, 255 * 255, 2 * 255 * 255 + 255 + 254.
    np.testing.assert_allclose(disparity, [[4.111, 65.025, 130.559, 0]], rtol=1e-6)
    np.testing.assert_array_equal(valid, [[True, True, True, False]])
    Image.fromarray(GREY).save(tmp_path / "grey.png")
    with pytest.raises(InputError, match="FoundationStereo"):
        read_disparity_fsd(tmp_path / "grey.png")


def test_read_disparity_hdf5(tmp_path):
    h5py = need_extra("h5py")
    with h5py.File(tmp_path / "d.dsp5", "w") as file:
        file["disparity"] = np.array([[1, 2, np.nan, 4], [5, 6, 7, 8], [9, 8, 0, 6]], np.float32)
    disparity, valid = read_disparity_hdf5(tmp_path / "d.dsp5", step=2)
    np.testing.assert_array_equal(disparity, [[1, 0], [9, 0]])
    np.testing.assert_array_equal(valid, [[True, False], [True, False]])
    with h5py.File(tmp_path / "flow.flo5", "w") as file:
        file["flow"] = np.zeros((2, 2, 2), np.float32)
    (tmp_path / "cut.dsp5").write_bytes((tmp_path / "d.dsp5").read_bytes()[:500])
    for name in ("flow.flo5", "cut.dsp5"):
        with pytest.raises(InputError, match=rf"{name}: no HDF5 file with an array disparity"):
            read_disparity_hdf5(tmp_path / name)
    with pytest.raises(FileNotFoundError, match=r"absent\.dsp5"):
        read_disparity_hdf5(tmp_path / "absent.dsp5")


def test_read_disparity_exr(tmp_path):
    exr = need_extra("OpenEXR")
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    values = np.array([[1.5, 0, np.inf], [2, 3, 4]], np.float32)
    for name, channels in (
        ("one", {"Y": values}),
        ("half", {"G": values.astype(np.float16)}),
        ("alike", {"R": values, "G": values, "B": values}),
    ):
        exr.File(header, channels).write(str(tmp_path / f"{name}.exr"))
        disparity, valid = read_disparity_exr(tmp_path / f"{name}.exr")
        np.testing.assert_array_equal(disparity, [[1.5, 0, 0], [2, 3, 4]])
        np.testing.assert_array_equal(valid, [[True, False, False], [True, True, True]])
    exr.File(header, {"R": values, "G": values + 1}).write(str(tmp_path / "two.exr"))
    with pytest.raises(InputError, match=r"two\.exr: disparity must be one channel, .* it has 2"):
        read_disparity_exr(tmp_path / "two.exr")
    (tmp_path / "cut.exr").write_bytes((tmp_path / "one.exr").read_bytes()[:300])
    with pytest.raises(InputError, match=r"cut\.exr: not an OpenEXR image that is whole"):
        read_disparity_exr(tmp_path / "cut.exr")
    with pytest.raises(FileNotFoundError, match=r"absent\.exr"):
        read_disparity_exr(tmp_path / "absent.exr")


def test_an_exr_image_of_equal_channels_with_unknown_pixels(tmp_path):
    exr = need_extra("OpenEXR")
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    values = np.array([[3, np.nan], [5, 6]], np.float32)
    exr.File(header, dict.fromkeys("RGB", values)).write(str(tmp_path / "a.exr"))
    disparity, valid = read_disparity_exr(tmp_path / "a.exr")
    np.testing.assert_array_equal(disparity, [[3, 0], [5, 6]])
    np.testing.assert_array_equal(valid, [[True, False], [True, True]])


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("ending", ["npy", "pfm", "tiff"])
def test_the_sign_of_most_disparities_is_the_files(tmp_path, sign, ending):
    path = tmp_path / f"d.{ending}"
    values = sign * np.array([[1.5, np.nan, -1, 2, np.inf, 0]], np.float32)
    if ending == "tiff":
        assert cv2.imwrite(str(path), values)
    else:
        (write_npy if ending == "npy" else write_pfm)(path, values)
    disparity, valid = read_disparity(path)
    np.testing.assert_array_equal(disparity, [[1.5, 0, 0, 2, 0, 0]])
    np.testing.assert_array_equal(valid, [[True, False, False, True, False, False]])


def test_integers_of_an_array_need_their_scale(tmp_path):
    path = tmp_path / "d.npy"
    for dtype in (np.int16, np.uint16, np.int64):
        np.save(path, np.array([[40, 0, 16]], dtype))  # OpenCV's matchers give 16 levels per px
        np.testing.assert_array_equal(read_disparity(path, 16)[0], [[2.5, 0, 1]])
        with pytest.raises(InputError, match=r"d.npy: .* need their scale .*: 256 as in"):
            read_disparity(path)
    np.save(path, np.array([[-40, 16, -16]], np.int16))
    np.testing.assert_array_equal(read_disparity(path, 16)[0], [[2.5, 0, 1]])
    with pytest.raises(InputError, match="must be positive"):
        read_disparity(path, 0)


@pytest.mark.parametrize(
    "values",
    [
        np.array([["1.5", "2"]]),
        np.array([[b"1", b"2"]]),
        np.array([[True, False]]),
        np.array([[1j, 2]]),
        np.array([["2024-01-01"]], "datetime64[D]"),
        np.zeros((1, 2), [("disparity", "f4")]),
    ],
)
def test_arrays_of_other_things_than_numbers_are_refused(tmp_path, values):
    np.save(tmp_path / "d.npy", values)
    with pytest.raises(InputError, match=r"d.npy: disparity must be an array of numbers"):
        read_disparity(tmp_path / "d.npy")


def test_files_that_are_no_array(tmp_path):
    path = tmp_path / "d.npy"
    np.save(path, np.array([[None]]), allow_pickle=True)
    with pytest.raises(InputError, match="not an array file"):
        read_disparity(path)
    with path.open("wb") as file:
        np.savez(file, np.zeros((2, 2)))
    with pytest.raises(InputError, match="several arrays"):
        read_disparity(path)
    for shape in ("(9999999999, 9999999)", "(1, 2", "-1"):
        header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}}}".ljust(117) + "\n"
        path.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode())
        with pytest.raises(InputError, match="not an array file"):
            read_disparity(path)


def test_read_disparity_npy(tmp_path):
    write_npy(tmp_path / "d.npy", np.array([[1.5, np.nan, 1]]))
    np.testing.assert_array_equal(np.load(tmp_path / "d.npy"), [[1.5, np.nan, 1]])
    (tmp_path / "bad.npy").write_bytes(b"no array")
    with pytest.raises(InputError, match=r"bad\.npy"):
        read_disparity(tmp_path / "bad.npy")
    write_npy(tmp_path / "deep.npy", np.zeros((2, 2, 2)))
    with pytest.raises(InputError, match=r"\(2, 2, 2\)"):
        read_disparity(tmp_path / "deep.npy")
    for name in ("none.npy", "none.pfm", "none.png"):
        with pytest.raises(FileNotFoundError, match=name):
            read_disparity(tmp_path / name)


def test_write_png(tmp_path):
    write_png(tmp_path / "a.png", RGB)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), RGB)
    deep = GREY.astype(np.uint16) * 257
    write_png(tmp_path / "b.png", deep)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "b.png")), deep)
    for bad in (RGB / 255, RGB[..., :2], np.zeros((2, 2), np.int64)):
        with pytest.raises(InputError, match=r"a\.png: a PNG takes"):
            write_png(tmp_path / "a.png", bad)


def test_write_atomically_never_leaves_a_part(tmp_path):
    target = tmp_path / "new" / "folder" / "a.tar.gz"
    seen = []

    def write(temporary):
        seen.append(temporary)
        assert not target.exists()
        temporary.write_text("first")

    write_atomically(target, write)
    assert target.read_text() == "first"
    assert seen[0].parent == target.parent  # os.replace is atomic within one file system only
    assert seen[0].suffixes[-2:] == [".tar", ".gz"]

    def fail(temporary):
        temporary.write_text("half")
        raise RuntimeError("out of luck")

    with pytest.raises(RuntimeError, match="out of luck"):
        write_atomically(target, fail)
    assert target.read_text() == "first"
    assert list(target.parent.iterdir()) == [target]

    with pytest.raises(InputError, match="folder is a folder: name the file"):
        write_atomically(target.parent, write)


def test_written_files_follow_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        write_npy(tmp_path / "a.npy", np.zeros(1))
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.npy").stat().st_mode) == 0o640
