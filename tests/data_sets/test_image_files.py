"""Image files that are damaged, turned, too large, or have other levels than 0 to 255."""

import io
import struct
import tracemalloc
import warnings
import zlib
from contextlib import ExitStack, suppress
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest
import simplejpeg
from PIL import EpsImagePlugin, Image, PngImagePlugin
from tifffile import imwrite

from extras import SHARED, needs_shared
from mobilestereonet.data import read_image
from mobilestereonet.data.image_files import MAX_IMAGE_PIXELS, decode_image, read_frames
from mobilestereonet.data.quiet import quiet_decoders
from mobilestereonet.errors import InputError
from mobilestereonet.inference import load_pair

RNG = np.random.default_rng(0)
SCENE = cv2.GaussianBlur(RNG.integers(0, 256, (80, 120, 3), dtype=np.uint8), (0, 0), 1.5)


def encoded(form, image=SCENE, **options):
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, form, **options)
    return stream.getvalue()


WHOLE = {
    "jpeg": encoded("JPEG", quality=90),
    "progressive.jpeg": encoded("JPEG", quality=90, progressive=True),
    "grey.jpeg": encoded("JPEG", SCENE[..., 0], quality=90),
    "restart.jpeg": encoded("JPEG", quality=90, restart_marker_rows=1),
    "png": encoded("PNG"),
    "webp": encoded("WEBP", quality=90),
    "lzw.tiff": encoded("TIFF", compression="tiff_lzw"),
    "deflate.tiff": encoded("TIFF", compression="tiff_adobe_deflate"),
    "jp2": encoded("JPEG2000"),
    "bmp": encoded("BMP"),
    "ppm": encoded("PPM"),
}


@pytest.mark.parametrize("name", WHOLE)
def test_damaged_files_are_refused(tmp_path, name, capfd):
    whole = WHOLE[name]
    path = tmp_path / name
    path.write_bytes(whole)
    assert np.abs(read_image(path).astype(int).mean() - SCENE.mean()) < 3
    middle = len(whole) // 2
    damaged = {"cut": whole[:middle], "hole": whole[:middle] + whole[middle + 200 :]}
    if "jpeg" in name:
        damaged["closed"] = whole[:middle] + b"\xff\xd9"
        damaged["zeros"] = whole[:middle] + bytes(200) + whole[middle + 200 :]
    if name == "png":
        damaged["bit"] = whole[:middle] + bytes([whole[middle] ^ 8]) + whole[middle + 1 :]
    for kind, content in damaged.items():
        path.write_bytes(content)
        with pytest.raises(InputError, match=f"{name}: not an image"):
            read_image(path)
            pytest.fail(f"{kind} was read")
    assert capfd.readouterr() == ("", "")


def test_filling_bytes_behind_the_data_are_no_damage(tmp_path):
    whole = WHOLE["grey.jpeg"]
    (tmp_path / "a.jpg").write_bytes(whole[:-2] + b"\0\0" + whole[-2:] + b"notes of a camera")
    np.testing.assert_array_equal(
        read_image(tmp_path / "a.jpg"), cv2.imdecode(np.frombuffer(whole, np.uint8), 1)
    )


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def huge(form):
    """A small file whose header says 40,000 x 40,000 pixels."""
    if form == "png":
        header = struct.pack(">IIBBBBB", 40000, 40000, 1, 0, 0, 0, 0)
        return (
            b"\x89PNG\r\n\x1a\n"
            + chunk(b"IHDR", header)
            + chunk(b"IDAT", b"")
            + chunk(b"IEND", b"")
        )
    if form == "jpg":
        whole = bytearray(WHOLE["jpeg"])
        at = whole.find(b"\xff\xc0") + 5
        whole[at : at + 4] = struct.pack(">HH", 40000, 40000)
        return bytes(whole)
    if form == "bmp":
        sizes = struct.pack("<IiiHHIIiiII", 40, 40000, 40000, 1, 24, 0, 0, 0, 0, 0, 0)
        return b"BM" + struct.pack("<IHHI", 154, 0, 0, 54) + sizes + bytes(100)
    if form == "tif":
        tags = [(256, 4, 1, 40000), (257, 4, 1, 40000), (258, 3, 1, 8), (259, 3, 1, 1)]
        tags += [(262, 3, 1, 1), (273, 4, 1, 8), (277, 3, 1, 1), (278, 4, 1, 40000)]
        tags += [(279, 4, 1, 1600000000)]
        entries = b"".join(struct.pack("<HHII", *tag) for tag in tags)
        return b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + bytes(104)
    if form == "pam":
        return b"P7\nWIDTH 40000\nHEIGHT 40000\nDEPTH 1\nMAXVAL 255\nTUPLTYPE GRAYSCALE\nENDHDR\n"
    return {"pgm": b"P5\n40000 40000\n255\n", "pfm": b"Pf\n40000 40000\n-1\n"}[form] + bytes(100)


@pytest.mark.parametrize("form", ["png", "jpg", "bmp", "tif", "pgm", "pam", "pfm"])
def test_a_header_of_too_many_pixels_is_refused_unread(tmp_path, form, capfd):
    path = tmp_path / f"big.{form}"
    path.write_bytes(huge(form))
    expected = "not an image" if form == "pam" else f"1600000000 pixels.*{MAX_IMAGE_PIXELS}"
    with pytest.raises(InputError, match=rf"big.{form}: {expected}"):
        read_image(path)
    assert capfd.readouterr() == ("", "")


def note(orientation):
    exif = Image.Exif()
    exif[0x0112] = orientation
    return exif


UNDO = {2: "FLIP_LEFT_RIGHT", 3: "ROTATE_180", 4: "FLIP_TOP_BOTTOM", 5: "TRANSPOSE"}
UNDO |= {6: "ROTATE_90", 7: "TRANSVERSE", 8: "ROTATE_270"}
"""What makes the stored picture of the shown one, by the orientation that is noted."""


@pytest.mark.parametrize("form", ["PNG", "WEBP", "TIFF", "JPEG"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_orientation_that_a_file_tells_is_applied(tmp_path, form, orientation):
    shown = np.zeros((32, 48, 3), np.uint8)
    shown[:16, :16], shown[:16, 32:], shown[16:, :16] = (250, 0, 0), (0, 250, 0), (0, 0, 250)
    stored = Image.fromarray(shown)
    if orientation > 1:
        stored = stored.transpose(getattr(Image.Transpose, UNDO[orientation]))
    options = {"lossless": True} if form == "WEBP" else {}
    path = tmp_path / f"a.{form.lower()}"
    stored.save(path, form, exif=note(orientation), **options)
    image = read_image(path)
    assert image.shape == shown.shape
    assert np.abs(image.astype(int) - shown)[4:12, 4:12].max() < 12
    assert np.median(np.abs(image.astype(int) - shown)) < 4
    pair = load_pair(path, path)
    told = [finding for finding in pair.findings if finding.check == "orientation"]
    assert [finding.level for finding in told] == (["fixed"] if orientation > 1 else [])
    with Image.open(path) as opened:  # the same of a PIL image
        np.testing.assert_array_equal(load_pair(opened, path).left_image, pair.left_image)


@pytest.mark.parametrize("kind", [b"P5", b"P6", b"P2", b"P7"])
@pytest.mark.parametrize("maximum", [100, 255, 1023, 4095, 65535])
def test_levels_of_a_pnm_are_shares_of_its_maximum(tmp_path, kind, maximum):
    values = np.array([0, maximum // 2, maximum])
    if kind == b"P6":
        values = values.repeat(3)
    body = values.astype(">u2" if maximum > 255 else np.uint8).tobytes()
    header = b"%s\n# a camera\n3 1\n%d\n" % (kind, maximum)
    if kind == b"P2":
        body = b" ".join(b"%d" % value for value in values) + b"\n"
    if kind == b"P7":
        header = (
            b"P7\nWIDTH 3\nHEIGHT 1\nDEPTH 1\nMAXVAL %d\nTUPLTYPE GRAYSCALE\nENDHDR\n" % maximum
        )
    (tmp_path / "a.pnm").write_bytes(header + body)
    image = read_image(tmp_path / "a.pnm")
    white = np.iinfo(image.dtype).max
    np.testing.assert_allclose(image[0, :, 0] / white, [0, 0.5, 1], atol=0.006)


def tiff(levels, photometric, extra=(), deflated=b""):
    """A little-endian TIFF, uncompressed unless its deflated data is given."""
    levels = np.atleast_3d(levels)
    height, width, channels = levels.shape
    bits = levels.dtype.itemsize * 8
    data = deflated or levels.tobytes()
    tags = [(256, 4, 1, width), (257, 4, 1, height), (258, 3, channels, bits)]
    tags += [(259, 3, 1, 8 if deflated else 1)]
    tags += [(262, 3, 1, photometric), (273, 4, 1, 0), (277, 3, 1, channels), (278, 4, 1, height)]
    tags += [(279, 4, 1, len(data)), *extra]
    behind = 8 + 2 + 12 * len(tags) + 4
    if channels > 2:
        tags[2] = (258, 3, channels, behind)
        data = struct.pack(f"<{channels}H", *[bits] * channels) + data
    tags[5] = (273, 4, 1, behind + (2 * channels if channels > 2 else 0))
    entries = b"".join(struct.pack("<HHII", *tag) for tag in tags)
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + bytes(4) + data


def test_levels_of_a_tiff_are_what_they_mean(tmp_path):
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
    path = tmp_path / "a.tif"
    for levels, full in ((grey, 255), (grey.astype(np.uint16) * 257, 65535)):
        path.write_bytes(tiff(full - levels, 0))  # white is zero
        np.testing.assert_array_equal(read_image(path)[..., 0], levels)
        path.write_bytes(tiff(levels, 1))
        np.testing.assert_array_equal(read_image(path)[..., 0], levels)
    alpha = np.full_like(grey, 128)
    for kind, share in ((1, 0.5), (2, 1)):  # associated: the colours are multiplied by alpha
        stored = np.dstack([(grey * share).astype(np.uint8)] * 3 + [alpha])
        path.write_bytes(tiff(stored, 2, [(338, 3, 1, kind)]))
        assert np.abs(read_image(path)[..., 0].astype(int) - grey).max() <= 2


@pytest.mark.parametrize("bits", [8, 10, 12, 14])
def test_bits_of_a_camera_in_16_bit_files(tmp_path, bits):
    deep = (SCENE[..., 0].astype(np.float32) / 255 * (2**bits - 1)).astype(np.uint16)
    right = deep // 2  # both are scaled alike
    for name, view in (("l", deep), ("r", right)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), view)
    for views in ((tmp_path / "l.png", tmp_path / "r.png"), (deep, right)):
        pair = load_pair(*views)
        assert pair.left.max() > 0.95 * SCENE[..., 0].max() / 255
        assert float(pair.right.mean() / pair.left.mean()) == pytest.approx(0.5, abs=0.02)
        (told,) = pair.findings
        assert (told.check, told.level) == ("levels", "fixed")
        assert f"{bits} bits" in told.text
    shifted = deep << (16 - bits)  # as many cameras store them
    assert not load_pair(shifted, shifted).findings
    assert decode_image(tmp_path / "l.png").max() == deep.max()


def test_both_pictures_of_an_mpo(tmp_path):
    left, right = Image.fromarray(SCENE), Image.fromarray(SCENE[:, ::-1].copy())
    left.save(tmp_path / "a.mpo", save_all=True, append_images=[right], quality=95)
    first, second = read_frames(tmp_path / "a.mpo")
    assert np.abs(first.astype(int) - SCENE).mean() < 4
    assert np.abs(second.astype(int) - SCENE[:, ::-1]).mean() < 4
    left.save(tmp_path / "a.jpg")
    assert len(read_frames(tmp_path / "a.jpg")) == 1


def test_a_damaged_picture_of_an_mpo_is_refused(tmp_path):
    whole = encoded("MPO", save_all=True, append_images=[Image.fromarray(SCENE)], quality=90)
    path = tmp_path / "a.mpo"
    damaged = [whole[: len(whole) * 3 // 4]]
    for middle in (len(whole) // 4, len(whole) * 3 // 4):
        for hole in (500, 1200):
            damaged.append(whole[: middle - hole // 2] + bytes(hole) + whole[middle + hole // 2 :])
    for content in damaged:
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"a.mpo: not an image that is whole"):
            read_frames(path)


def test_data_that_a_hole_has_shifted_are_no_filling_bytes(tmp_path):
    whole = encoded("JPEG", quality=95)
    refused = 0
    for middle in range(1000, 3600, 100):
        content = whole[:middle] + bytes(200) + whole[middle + 200 :]
        with suppress(ValueError):
            simplejpeg.decode_jpeg(content, "GRAY", strict=True)
            continue  # libjpeg warns of nothing
        (tmp_path / "a.jpg").write_bytes(content)
        with pytest.raises(InputError, match="not an image that is whole"):
            read_image(tmp_path / "a.jpg")
        refused += 1
    assert refused > 5


def test_a_photo_with_a_preview_is_one_picture(tmp_path):
    small = Image.fromarray(SCENE).reduce(2)
    (tmp_path / "a.jpg").write_bytes(encoded("MPO", save_all=True, append_images=[small]))
    (frame,) = read_frames(tmp_path / "a.jpg")
    assert frame.shape == SCENE.shape


def test_no_other_program_sees_a_file(tmp_path, monkeypatch):
    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", lambda *_, **__: pytest.fail("it was run"))
    (tmp_path / "a.png").write_bytes(encoded("EPS"))
    with pytest.raises(InputError, match="not an image"):
        read_image(tmp_path / "a.png")


def wrong_scan_header(content):
    """As some telephones write it."""
    at = content.rfind(b"\xff\xda")
    at += 2 + content[at + 3]
    return content[: at - 3] + bytes(3) + content[at:]


@pytest.mark.parametrize("form", ["jpeg", "restart.jpeg", "grey.jpeg", "revision"])
def test_a_harmless_warning_hides_no_damage(tmp_path, form):
    if form == "revision":
        noted = WHOLE["jpeg"].replace(b"JFIF\0\1", b"JFIF\0\3", 1)
    else:
        noted = wrong_scan_header(WHOLE[form])
    path = tmp_path / "a.jpg"
    path.write_bytes(noted)
    image = read_image(path)
    assert np.abs(image.astype(int).mean() - SCENE.mean()) < 3
    middle = len(noted) // 2
    for content in (
        noted[:middle],
        noted[:middle] + b"\xff\xd9",
        noted[:middle] + bytes(200) + noted[middle + 200 :],
    ):
        path.write_bytes(content)
        with pytest.raises(InputError, match="not an image that is whole"):
            read_image(path)


@pytest.mark.parametrize("subsampling", ["4:2:0", "4:2:2"])
def test_a_jpeg_of_print_colours_is_read_and_checked_as_far_as_can_be(tmp_path, subsampling):
    path, stream = tmp_path / "a.jpg", io.BytesIO()
    Image.fromarray(SCENE).convert("CMYK").save(stream, "JPEG", subsampling=subsampling)
    whole = stream.getvalue()
    path.write_bytes(whole)
    with pytest.warns(UserWarning, match=r"a\.jpg: .* damage within it is not noticed"):
        assert np.abs(read_image(path).astype(int) - SCENE).mean() < 8
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"not an image that is whole: .*truncated"):
        read_image(path)


def test_a_hole_after_which_a_jpeg_goes_on_as_if_whole(tmp_path):
    noise = np.random.default_rng(0).integers(0, 255, (48, 96, 3), dtype=np.uint8)
    path, whole = tmp_path / "a.jpg", cv2.imencode(".jpg", noise)[1].tobytes()
    path.write_bytes(whole[:3000] + whole[4500:])  # a decoder does not notice this one
    with pytest.warns(UserWarning, match=r"a\.jpg: some of its blocks have levels .* be missing"):
        read_image(path)


@pytest.mark.parametrize("subsampling", ["4:4:4", "4:2:0"])
@pytest.mark.parametrize("levels", [9, -30])
def test_brightness_that_changes_from_one_block_on(tmp_path, subsampling, levels):
    path = tmp_path / "a.jpg"
    large = cv2.GaussianBlur(RNG.integers(0, 256, (160, 240, 3), dtype=np.uint8), (0, 0), 2) // 2
    large += 60
    barred = large.copy()
    barred[:32] = barred[-32:] = 0  # as of a film: a step in every column is no staircase
    for image in (large, barred):
        path.write_bytes(encoded("JPEG", image, quality=85, subsampling=subsampling))
        with warnings.catch_warnings(action="error"):
            read_image(path)
    rows = 8 if subsampling == "4:4:4" else 16
    shifted = large.astype(int)
    shifted[64 : 64 + rows, 128:] += levels
    shifted[64 + rows :] += levels
    content = encoded("JPEG", shifted.astype(np.uint8), quality=85, subsampling=subsampling)
    path.write_bytes(content)
    with pytest.warns(UserWarning, match=r"a\.jpg: .* along row 64; bytes .* be missing"):
        read_image(path)


@pytest.mark.parametrize("quality", [10, 50, 90])
@pytest.mark.parametrize("paper", [0, 255])
def test_dots_and_letters_are_no_missing_bytes(tmp_path, quality, paper):
    page = np.full((256, 256, 3), paper, np.uint8)
    page[RNG.random(page.shape[:2]) < 0.02] = 255 - paper
    for row in range(20, 250, 20):
        cv2.putText(page, "gjqy 0189 %", (5, row), 0, 0.5, (255 - paper,) * 3)
    (tmp_path / "a.jpg").write_bytes(encoded("JPEG", page, quality=quality))
    with warnings.catch_warnings(action="error"):
        assert read_image(tmp_path / "a.jpg").shape == page.shape


@pytest.mark.parametrize("marker", [0xC5, 0xCE, 0xCF])
def test_a_marker_within_the_data_is_damage(tmp_path, marker):
    whole = WHOLE["jpeg"]
    middle = len(whole) // 2
    path = tmp_path / "a.jpg"
    path.write_bytes(whole[:middle] + bytes((0xFF, marker)) + whole[middle + 2 :])
    with pytest.raises(InputError, match="not an image that is whole"):
        read_image(path)


def silently_read(path, content):
    path.write_bytes(content)
    with warnings.catch_warnings(action="error"):
        return read_image(path)


def test_whites_beyond_white_are_no_missing_bytes(tmp_path):
    """mozjpeg stores them, so that the edges of letters do not ring."""
    content = (Path(__file__).parents[1] / "data/mozjpeg.jpg").read_bytes()
    assert silently_read(tmp_path / "a.jpg", content).shape == (48, 64, 3)


@pytest.mark.parametrize("noise", [0, 0.5, 1])
@pytest.mark.parametrize("quality", [30, 45, 59])
def test_a_smooth_sky_is_no_missing_bytes(tmp_path, quality, noise):
    y, x = np.mgrid[:400, :640]
    for slope, tilt in product((0.3, 0.4, 0.5), (-0.005, 0, 0.005)):
        sky = 30 + slope * y + tilt * x + RNG.normal(0, 1, y.shape) * noise
        levels = np.rint(sky.clip(0, 255)).astype(np.uint8)
        silently_read(tmp_path / "a.jpg", encoded("JPEG", levels, quality=quality))


def test_tables_of_quantisation_by_any_number(tmp_path):
    content = bytearray(WHOLE["grey.jpeg"])
    table, frame = content.find(b"\xff\xdb"), content.find(b"\xff\xc0")
    content[table + 4] = content[frame + 12] = 1  # number of the table, and who uses it
    silently_read(tmp_path / "a.jpg", bytes(content))
    content[frame + 12] = 2
    with pytest.raises(InputError, match="not an image"):
        silently_read(tmp_path / "b.jpg", bytes(content))


def test_black_of_print_is_no_missing_bytes(tmp_path):
    cmy = RNG.integers(0, 2, (64, 96, 3), np.uint8) * 200
    black = cmy.min(axis=2, keepdims=True)
    stream = io.BytesIO()
    image = Image.fromarray(np.concatenate((cmy - black, black), axis=2), "CMYK")
    image.save(stream, "JPEG", quality=90, subsampling="4:4:4")
    silently_read(tmp_path / "a.jpg", stream.getvalue())


def test_long_texts_in_a_png_are_no_damage(tmp_path):
    texts = PngImagePlugin.PngInfo()
    texts.add_text("parameters", "a" * 2_000_000, zip=True)
    path = tmp_path / "a.png"
    whole = encoded("PNG", pnginfo=texts, exif=note(3))
    path.write_bytes(whole)
    np.testing.assert_array_equal(read_image(path), SCENE[::-1, ::-1])
    path.write_bytes(whole.replace(b"IDAT", b"IDAT\1", 1))
    with pytest.raises(InputError, match="not an image that is whole"):
        read_image(path)


@pytest.mark.parametrize("compression", ["tiff_adobe_deflate", "tiff_deflate"])
def test_a_zeroed_block_in_a_deflated_tiff(tmp_path, compression):
    path = tmp_path / "a.tiff"
    content = encoded("TIFF", compression=compression)
    path.write_bytes(content)
    np.testing.assert_array_equal(read_image(path), SCENE)
    half = len(content) // 2
    path.write_bytes(content[:half] + bytes(60) + content[half + 60 :])
    with pytest.raises(InputError, match="not an image that is whole: its data is damaged"):
        read_image(path)


def test_tiles_may_reach_far_beyond_the_picture(tmp_path):
    band = np.random.default_rng(0).integers(0, 256, (16, 5000, 3), np.uint8)
    imwrite(tmp_path / "a.tiff", band, tile=(512, 512), compression="zlib", photometric="rgb")
    np.testing.assert_array_equal(read_image(tmp_path / "a.tiff"), band)


def test_a_deflated_tiff_that_swells_is_refused_in_little_memory(tmp_path):
    path = tmp_path / "a.tiff"
    grey = SCENE[..., 0]
    path.write_bytes(tiff(grey, 1, deflated=zlib.compress(grey.tobytes())))
    np.testing.assert_array_equal(read_image(path)[..., 0], grey)
    path.write_bytes(tiff(grey, 1, deflated=zlib.compress(bytes(40_000_000))))
    tracemalloc.start()
    with pytest.raises(InputError, match="its data is larger than the picture"):
        read_image(path)
    assert tracemalloc.get_traced_memory()[1] < 8_000_000
    tracemalloc.stop()


def test_the_callers_settings_stay(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(WHOLE["png"])
    logging = cv2.utils.logging
    before = logging.getLogLevel(), list(warnings.filters)
    assert "PIL" not in str(before)
    first, second = ExitStack(), ExitStack()
    for context in (first, second):  # of two threads, the first leaves first
        context.enter_context(quiet_decoders)
    first.close()
    read_image(path)
    assert logging.getLogLevel() == logging.LOG_LEVEL_SILENT
    second.close()
    assert (logging.getLogLevel(), list(warnings.filters)) == before


@needs_shared
def test_the_shared_cases():
    bugs = SHARED / "bugs"
    for name in ("left_hole", "left_cut_closed"):
        with pytest.raises(InputError, match="not an image that is whole"):
            read_image(bugs / "damaged-jpeg" / f"{name}.jpg")
    for name in ("big.bmp", "big.pgm", "big.tif"):
        with pytest.raises(InputError, match="1600000000 pixels"):
            read_image(bugs / "huge-header-other" / name)
    (told,) = load_pair(bugs / "exif-differs/left.jpg", bugs / "exif-differs/right.jpg").findings
    assert "right.jpg is turned by 180 degrees" in told.text
    (told,) = load_pair(bugs / "mono12/left.png", bugs / "mono12/right.png").findings
    assert "12 bits" in told.text
