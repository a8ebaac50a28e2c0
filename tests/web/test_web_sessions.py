"""What the page does with pictures and numbers, without gradio."""

import base64
import io
import struct
import zlib
from dataclasses import replace
from threading import Thread
from zipfile import ZipFile

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from mobilestereonet import InputError, StereoMatcher, create_model
from mobilestereonet.data.depth_files import write_depth
from mobilestereonet.data.image_files import decode_image
from mobilestereonet.data.rig import Camera, CameraPair, Rig
from mobilestereonet.inference import PointCloud, Rectifier, StereoResult, load_pair
from mobilestereonet.inference.mesh import Mesh
from mobilestereonet.web.answer import (
    CLOUD,
    MESH,
    answer,
    prepare,
    rectifier_of,
    view,
    viewing_distance,
)
from mobilestereonet.web.cameras import CAMERAS, FILE, NUMBERS, UNKNOWN, Geometry
from mobilestereonet.web.sessions import Sessions
from mobilestereonet.web.uploads import (
    UploadLimits,
    admit_calibration,
    admit_pair,
    read_views,
)

LEFT, RIGHT = np.random.default_rng(0).integers(0, 256, (2, 40, 64, 3), dtype=np.uint8)


@pytest.fixture
def root(tmp_path):
    return tmp_path / "uploads"


@pytest.fixture
def sessions(root):
    return Sessions(root / "sessions")


@pytest.fixture
def upload(root):
    """Puts a file where gradio puts uploads."""

    def put(content, name="picture.png", folder="a1b2"):
        if isinstance(content, np.ndarray):
            content = cv2.imencode(".png", content)[1].tobytes()
        path = root / folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        return path

    return put


@pytest.fixture(scope="module")
def matcher():
    torch.manual_seed(0)
    return StereoMatcher(create_model("msnet2d", max_disparity=32), confidence=True)


def admit(path, root, session, limits=UploadLimits()):
    """Drop one picture on the page; gives the session's left one."""
    admit_pair([path], root, session, limits)
    return session.file("left")


@pytest.fixture
def session(root, sessions, upload):
    """A session with a pair."""
    session = sessions["someone"]
    for picture in (LEFT, RIGHT):
        admit(upload(picture), root, session)
    return session


def known(focal=50, baseline=0.2, doffs=0, max_depth=100, min_confidence=0.0):
    return Geometry(NUMBERS, None, focal, baseline, doffs, max_depth, min_confidence)


def ask(session, matcher, geometry, rectifier=None, pixels=UploadLimits().pixels):
    """An answer, and what the browser shows of it."""
    pair, size = read_views(session, pixels)
    pair = prepare(pair, size, rectifier_of(geometry, size, pair) or rectifier, matcher)
    result = matcher.match(pair)
    return answer(session, pair, result, geometry), view(pair, result, geometry.guessed)


def names_in(session):
    return {path.name for path in files_below(session.folder)}


def shown(data_url):
    content = base64.b64decode(data_url.partition(",")[2])
    return cv2.imdecode(np.frombuffer(content, np.uint8), -1)


def files_below(folder):
    return sorted(path for path in folder.rglob("*") if path.is_file())


def png_header(width, height):
    """A PNG that claims a size and has next to no pixels."""

    def chunk(kind, content):
        checksum = zlib.crc32(kind + content)
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", checksum)

    size = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    pixels = chunk(b"IDAT", zlib.compress(bytes(100)))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", size) + pixels + chunk(b"IEND", b"")


def test_an_upload_is_copied_into_the_session_under_our_name(root, sessions, upload):
    path = upload(LEFT, name="My holiday \u2603.jpeg")  # a PNG, whatever it is called
    kept = admit(path, root, sessions["a"])
    assert kept.name == "left.png"
    assert kept.is_relative_to(sessions["a"].folder)
    np.testing.assert_array_equal(decode_image(kept), LEFT)
    admit(upload(RIGHT), root, sessions["a"])
    again = admit(upload(RIGHT), root, sessions["a"])  # the left one of a new pair
    np.testing.assert_array_equal(decode_image(again), RIGHT)
    assert files_below(root / "sessions") == [again]


def test_two_visitors_with_the_same_picture(root, sessions, upload):
    path = upload(LEFT)  # one path: gradio names it by its content
    kept = [admit(path, root, sessions[name]) for name in "ab"]
    sessions.close("a")
    assert files_below(root / "sessions") == kept[1:]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "no PNG, JPEG, WebP or BMP"),
        (b"no picture at all", "no PNG, JPEG, WebP or BMP"),
        (b"<svg xmlns='http://www.w3.org/2000/svg'/>", "no PNG, JPEG, WebP or BMP"),
        (b"GIF89a" + bytes(100), "no PNG, JPEG, WebP or BMP"),
        (png_header(9000, 9000), "9000 x 9000, more than 64 megapixels"),
        (png_header(60_000, 60_000), "more than 64 megapixels"),
        (png_header(0, 5), "no PNG, JPEG, WebP or BMP"),
        (bytes(2**20 + 1), "more than 1 MB"),
    ],
    ids=["empty", "text", "svg", "gif", "large", "bomb", "nothing", "heavy"],
)
def test_a_bad_upload_is_deleted(root, sessions, upload, content, words):
    path = upload(content)
    with pytest.raises(InputError, match=f"left picture: .*{words}") as error:
        admit(path, root, sessions["a"], UploadLimits(megabytes=1))
    assert str(root) not in str(error.value)
    assert files_below(root) == []


def test_the_size_is_told_without_decoding(root, sessions, upload, monkeypatch):
    monkeypatch.setattr("PIL.ImageFile.ImageFile.load", lambda *_: pytest.fail("decoded"))
    with pytest.raises(InputError, match="megapixels"):
        admit(upload(png_header(9000, 9000)), root, sessions["a"])


def test_only_uploads_are_taken(root, sessions, upload, tmp_path):
    secret = tmp_path / "secret.png"
    secret.write_bytes(cv2.imencode(".png", LEFT)[1].tobytes())
    theirs = admit(upload(LEFT), root, sessions["other"])
    link = root / "c3d4" / "link.png"
    link.parent.mkdir()
    link.symlink_to(secret)
    for path in (
        secret,
        root / "a1b2" / ".." / ".." / "secret.png",
        root / "a1b2" / "missing.png",
        root / "a1b2",
        root.parent,
        link,
        theirs,
    ):
        with pytest.raises(InputError, match="the upload is not there"):
            admit(path, root, sessions["a"])
    assert secret.exists()
    assert theirs.exists()
    assert sessions["a"].file("left") is None


def test_two_files_are_left_and_right_by_their_names(root, sessions, upload):
    session = sessions["a"]
    files = [upload(RIGHT, "scene_R.png", "r"), upload(LEFT, "scene_L.png", "l")]
    admit_pair(files, root, session, UploadLimits())
    pair, _ = read_views(session, 10**6)
    np.testing.assert_array_equal(pair.left_image[..., ::-1], LEFT)
    session.swap("left", "right")
    np.testing.assert_array_equal(read_views(session, 10**6)[0].right_image[..., ::-1], LEFT)
    with pytest.raises(InputError, match="these are 3 pictures"):
        admit_pair([*files, files[0]], root, session, UploadLimits())
    with pytest.raises(InputError, match="there is no picture"):
        admit_pair([], root, session, UploadLimits())


def test_one_file_after_the_other(root, sessions, upload):
    session = sessions["a"]
    admit_pair([upload(LEFT)], root, session, UploadLimits())
    with pytest.raises(InputError, match="there is no right picture yet: drop it, too"):
        read_views(session, 10**6)
    admit_pair([upload(RIGHT)], root, session, UploadLimits())
    np.testing.assert_array_equal(read_views(session, 10**6)[0].right_image[..., ::-1], RIGHT)
    admit_pair([upload(RIGHT)], root, session, UploadLimits())  # a new left one
    assert session.file("right") is None


NOISE = np.random.default_rng(0).integers(0, 256, (120, 400, 3), dtype=np.uint8)
SCENE = cv2.GaussianBlur(NOISE, (0, 0), 1)
VIEWS = SCENE[:, :188], SCENE[:, 12:200]


def mpo():
    frames = [Image.fromarray(picture[..., ::-1]) for picture in VIEWS]
    file = io.BytesIO()
    frames[0].save(file, "MPO", save_all=True, append_images=frames[1:], quality=95)
    return file.getvalue()


@pytest.mark.parametrize("pixels", [10**6, 600])
@pytest.mark.parametrize("content", [np.hstack(VIEWS), mpo()], ids=["joined", "mpo"])
@pytest.mark.parametrize("first", [None, LEFT], ids=["alone", "after a left one"])
def test_one_picture_of_both_views(root, sessions, upload, content, pixels, first):
    session = sessions["a"]
    if first is not None:
        admit_pair([upload(first)], root, session, UploadLimits())
    for _ in range(2):  # the next one of the same camera replaces it
        admit_pair([upload(content)], root, session, UploadLimits())
        pair, size = read_views(session, pixels)
        assert size == (188, 120)
        assert pair.width * pair.height <= pixels
        assert pair.width / pair.height == pytest.approx(188 / 120, rel=0.1)
    session.swap("left", "right")
    left, right = (decode_image(session.file(side)) for side in ("left", "right"))
    loss = 0 if isinstance(content, np.ndarray) else 8  # of JPEG
    assert np.abs(left.astype(float) - VIEWS[1]).mean() <= loss
    assert np.abs(right.astype(float) - VIEWS[0]).mean() <= loss
    read_views(session, pixels)


def test_wide_views_one_after_the_other(root, sessions, upload):
    noise = np.random.default_rng(1).integers(0, 256, (300, 752, 3), dtype=np.uint8)
    scene, session = cv2.GaussianBlur(noise, (0, 0), 1), sessions["a"]
    views = {"left": scene[:, :740], "right": scene[:, 12:]}
    admit_pair([upload(views["left"])], root, session, UploadLimits())
    with pytest.raises(InputError, match=r"no right picture yet.*halves.*not two views"):
        read_views(session, 10**6)
    admit_pair([upload(views["right"])], root, session, UploadLimits())
    for side, seen in views.items():
        np.testing.assert_array_equal(decode_image(session.file(side)), seen)


def test_a_waiting_view_that_was_moved_to_the_right(root, sessions, upload):
    session = sessions["a"]
    admit_pair([upload(RIGHT)], root, session, UploadLimits())
    session.swap("left", "right")
    with pytest.raises(InputError, match="there is no left picture yet: drop it, too"):
        read_views(session, 10**6)
    admit_pair([upload(LEFT)], root, session, UploadLimits())
    for side, seen in (("left", LEFT), ("right", RIGHT)):
        np.testing.assert_array_equal(decode_image(session.file(side)), seen)


def test_a_refused_pair_leaves_the_former_one(root, session, upload):
    files = [upload(RIGHT, "a.png", "a"), upload(b"text", "b.png", "b")]
    with pytest.raises(InputError, match="right picture: this is no PNG"):
        admit_pair(files, root, session, UploadLimits())
    for side, seen in (("left", LEFT), ("right", RIGHT)):
        np.testing.assert_array_equal(decode_image(session.file(side)), seen)


def test_large_pictures_are_scaled_and_the_calibration_with_them(session, matcher):
    found, seen = ask(session, matcher, known(doffs=4), pixels=640)
    assert shown(seen["left"]).shape == (20, 32, 3)
    assert seen["geometry"]["focal"] == 25
    assert seen["geometry"]["depth"] == pytest.approx(5)
    assert seen["geometry"]["doffs"] == 2
    assert "32x20" in found.summary


def test_what_is_shown_and_written(session, matcher):
    found, seen = ask(session, matcher, known(doffs=3))
    expected = matcher(LEFT[..., ::-1], RIGHT[..., ::-1])
    assert list(found.downloads) == ["picture", "depth", "blender", "everything"]
    depth = 50 * 0.2 / (expected.disparity + 3)
    metres = cv2.imread(str(found.downloads["depth"]), cv2.IMREAD_UNCHANGED)
    np.testing.assert_allclose(metres, depth, rtol=1e-5)
    assert decode_image(found.downloads["picture"]).shape == LEFT.shape
    assert found.downloads["blender"].read_bytes().startswith(b"glTF")
    with ZipFile(found.downloads["everything"]) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    assert {CLOUD, MESH, "left.png", "stereo_depth.png", "stereo_depth.npy"} < set(files)
    np.testing.assert_array_equal(
        np.load(io.BytesIO(files["stereo_disparity.npy"])), expected.disparity
    )
    assert files["stereo_points.ply"].startswith(b"ply")
    assert found.summary.startswith("msnet2d on torch fp32, 64x40: matched in ")
    seen_left, left = (cv2.blur(image, (9, 9)) for image in (shown(seen["left"]), LEFT))
    assert np.abs(seen_left.astype(float) - left).mean() < 5  # noise, as JPEG


def test_points_fill_the_view_in_3d():
    corners = np.array([[-3, -1, 4], [3, 1, 4], [-6, -2, 8], [6, 2, 8]], np.float32)
    distance = viewing_distance(PointCloud(corners, np.zeros((4, 3), np.uint8)))
    x, y, z = (corners - [0, 0, 6 - distance]).T  # of the viewer's camera
    seen = np.abs([x / z / 1.5, y / z]) / np.tan(0.4)
    assert seen.max() == pytest.approx(1)


def test_maps_unpack_to_the_disparity(session, matcher):
    _, seen = ask(session, matcher, known(doffs=3))
    expected = matcher(LEFT[..., ::-1], RIGHT[..., ::-1])
    sure, low, high = np.moveaxis(shown(seen["levels"]).astype(float), 2, 0)
    np.testing.assert_allclose((256 * high + low) / 256, expected.disparity, atol=1 / 512)
    np.testing.assert_allclose(sure / 255, expected.confidence, atol=1 / 510)
    assert seen["geometry"] == {
        **{"focal": 50, "depth": pytest.approx(10), "doffs": 3},
        **{"cx": 31.5, "cy": 19.5, "guessed": False},
    }


def test_without_metres_there_is_a_shape_and_no_depth(session, matcher):
    found, seen = ask(session, matcher, Geometry(max_depth=100))
    assert seen["geometry"] is None
    assert list(found.downloads) == ["picture", "blender", "everything"]
    assert not any("depth" in name for name in names_in(session))


def test_cameras_by_model(session, matcher):
    oak = CAMERAS["OAK-D"]
    assert oak.calibration((1280, 800)).focal == 882.5
    assert oak.calibration((640, 400)).focal == 441.25
    assert CAMERAS["ZED 2"].calibration((1920, 1080)).focal == 1060
    _, seen = ask(session, matcher, Geometry("OAK-D", max_depth=100))
    assert seen["geometry"]["depth"] == pytest.approx(882.5 / 20 * 0.075)
    assert seen["geometry"]["guessed"] is False
    with pytest.raises(InputError, match="no camera 'Holga'"):
        ask(session, matcher, Geometry("Holga"))


@pytest.mark.parametrize(
    ("camera", "size", "focal"),
    [
        ("OAK-D", (1280, 720), 882.5),  # cut above and below only
        ("OAK-D", (640, 360), 441.25),
        ("OAK-D", (640, 480), None),
        ("ZED 2", (672, 376), 265),
        ("ZED 2", (1104, 621), None),  # from which of its views?
        ("RealSense D435", (1280, 720), 674.4),
        ("RealSense D435", (848, 480), 446.8),
        ("RealSense D435", (640, 480), None),  # cut from 16:9
        ("RealSense D435", (720, 1280), None),
    ],
)
def test_nominal_values_are_for_whole_views(camera, size, focal):
    geometry = Geometry(camera)
    if focal is None:
        with pytest.raises(InputError, match=f"1280x.*these pictures have {size[0]}x{size[1]}"):
            geometry.rig(size)
    else:
        assert geometry.rig(size).geometry(size).focal == pytest.approx(focal, abs=0.1)


def test_a_guessed_scale_is_said_to_be_guessed(session, matcher):
    found, seen = ask(session, matcher, Geometry(UNKNOWN, max_depth=100))
    assert seen["geometry"]["guessed"] is True
    assert any("the scale is guessed" in note for note in found.notes)


CALIB = "cam0=[50 0 31; 0 50 20; 0 0 1]\ncam1=[50 0 33; 0 50 20; 0 0 1]\nbaseline=200\n"


def test_a_calibration_file(root, session, upload, matcher):
    text = f"{CALIB}doffs=2\nwidth=64\nheight=40\n"
    admit_calibration(upload(text.encode(), "calib.txt"), root, session)
    geometry = Geometry(FILE, session.file("calibration"), max_depth=100)
    for pixels, focal in ((10**6, 50), (640, 25)):
        _, seen = ask(session, matcher, geometry, pixels=pixels)
        assert seen["geometry"]["focal"] == focal
        assert seen["geometry"]["depth"] == pytest.approx(focal * 0.2)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("calib.exe", b"MZ", "its name must end with one of"),
        ("calib.txt", bytes(2**20 + 1), "more than 1 MB"),
    ],
)
def test_a_bad_calibration_upload_is_deleted(root, sessions, upload, name, content, words):
    path = upload(content, name)
    with pytest.raises(InputError, match=f"calibration file: .*{words}"):
        admit_calibration(path, root, sessions["a"])
    assert files_below(root) == []


def test_a_calibration_file_that_is_none(root, session, upload, matcher):
    admit_calibration(upload(b"nothing of use", "calib.txt"), root, session)
    with pytest.raises(InputError, match="the calibration file") as error:
        ask(session, matcher, Geometry(FILE, session.file("calibration")))
    assert str(root) not in str(error.value)
    with pytest.raises(InputError, match=r"no calibration file \(any more\)"):
        ask(session, matcher, Geometry(FILE))
    with pytest.raises(InputError, match="the upload is not there"):
        admit_calibration(session.file("left"), root, session)


def test_cameras_of_the_page(session, matcher):
    camera = np.array([[60.0, 0, 32], [0, 60, 20], [0, 0, 1]])
    turned = cv2.Rodrigues(np.array([0, 0, 0.02]))[0]
    lens = Camera(camera, np.zeros(5))
    pair = CameraPair(lens, lens, turned, np.array([-0.1, 0, 0]), (64, 40))
    rectifier = Rectifier(Rig((pair,), "the cameras of this page"))
    _, seen = ask(session, matcher, Geometry(max_depth=100), rectifier)
    calibration = rectifier.calibration((64, 40))
    depth = calibration.focal * calibration.baseline
    assert seen["geometry"]["depth"] == pytest.approx(depth)
    left = decode_image(session.file("answer", "left.png"))
    assert (left != LEFT).any()  # rectified
    _, own = ask(session, matcher, known(), rectifier)  # what is filled in counts
    assert own["geometry"]["depth"] == pytest.approx(10)
    small = Rectifier(Rig((CameraPair(lens, lens, turned, pair.translation, (63, 40)),), "cameras"))
    with pytest.raises(InputError, match=r"cameras: .*63x40, these have 64x40"):
        ask(session, matcher, Geometry(), small)


def test_views_that_cannot_give_depth_give_none(root, sessions, upload, matcher):
    noise = np.random.default_rng(0).integers(0, 256, (120, 260, 3), dtype=np.uint8)
    wide = cv2.GaussianBlur(noise, (0, 0), 1)
    session = sessions["someone else"]
    for picture in (wide[:, :240], np.roll(wide, 6, axis=0)[:, 20:]):
        admit(upload(picture), root, session)
    found, seen = ask(session, matcher, known())
    assert any("no depth in metres of such views (rectified)" in note for note in found.notes)
    assert seen["geometry"] is None
    assert "depth" not in found.downloads


def test_an_engine_without_confidence(session):
    _, seen = ask(session, StereoMatcher.from_pretrained("sgbm"), known(min_confidence=0.5))
    assert seen["confident"] is False
    assert session.file("answer", CLOUD) is not None


def test_no_point_is_a_note(session, matcher):
    found, _ = ask(session, matcher, known(max_depth=1e-6))
    assert "3D: nothing is as near and as sure as asked for" in found.notes
    assert found.distance is None
    assert session.file("answer", CLOUD) is None
    assert "blender" not in found.downloads


def test_points_without_a_surface_are_kept(session, matcher, monkeypatch):
    whole = StereoResult.mesh
    monkeypatch.setattr(
        StereoResult, "mesh", lambda *a, **k: replace(whole(*a, **k), faces=np.empty((0, 3), int))
    )
    found, _ = ask(session, matcher, known())
    assert "3D: points only, no surface is as near and as sure as asked for" in found.notes
    assert session.file("answer", CLOUD) is not None
    assert session.file("answer", MESH) is None
    assert "blender" not in found.downloads


def test_another_failure_is_not_told_as_an_empty_shape(session, matcher, monkeypatch):
    def fail(*_):
        raise InputError("no texture")

    monkeypatch.setattr(Mesh, "save", fail)
    with pytest.raises(InputError, match="no texture"):
        ask(session, matcher, known())


def test_a_limit_in_metres_needs_metres(session, matcher):
    found, _ = ask(session, matcher, Geometry(max_depth=1e-6))
    assert any("counts with depth in metres only" in note for note in found.notes)
    assert "blender" in found.downloads


@pytest.mark.parametrize(
    ("geometry", "words"),
    [
        (known(50, 0), "baseline is 0 or missing"),
        (known(None, 0.1), "focal length is 0 or missing"),
        (known(0, 0), "focal length is 0 or missing"),
        (known(50, -0.1), "baseline must be positive"),
        (known(float("nan"), 0.1), "focal must be positive"),
        (known(50, 0.1, float("inf")), "doffs must be finite"),
    ],
)
def test_bad_calibration(session, matcher, geometry, words):
    before = files_below(session.folder)
    with pytest.raises(InputError, match=words):
        ask(session, matcher, geometry)
    assert files_below(session.folder) == before


@pytest.mark.parametrize("pixels", [10**6, 600])
def test_bad_pairs(root, session, upload, matcher, pixels):
    whole = cv2.imencode(".png", RIGHT)[1].tobytes()
    for content, words in (
        (RIGHT[:-8], "left.* has 64x40, right.* has 64x32"),
        (whole[:200], "right picture: not an image"),
    ):
        session.drop("right")
        admit(upload(content), root, session)
        before = files_below(session.folder)
        with pytest.raises(InputError, match=words) as error:
            ask(session, matcher, Geometry(), pixels=pixels)
        assert str(root) not in str(error.value)
        assert files_below(session.folder) == before
    session.drop("left")
    with pytest.raises(InputError, match="there is no left picture"):
        ask(session, matcher, Geometry())


def test_a_picture_that_goes_meanwhile(root, session, monkeypatch):
    def late(left, right):
        left.unlink()
        return load_pair(left, right)

    monkeypatch.setattr("mobilestereonet.web.uploads.load_pair", late)
    with pytest.raises(InputError, match="left picture: no such file") as error:
        read_views(session, 10**6)
    assert str(root) not in str(error.value)


def test_a_failure_on_the_way_leaves_the_former_answer(session, matcher, monkeypatch):
    ask(session, matcher, known())
    before = files_below(session.folder)

    def full(path, depth):
        write_depth(path, depth)
        raise OSError("no space left")

    monkeypatch.setattr("mobilestereonet.web.answer.write_depth", full)
    with pytest.raises(OSError, match="no space"):
        ask(session, matcher, known())
    assert files_below(session.folder) == before


def test_closing_deletes_everything(root, sessions, session, matcher):
    ask(session, matcher, known())
    other = sessions["other"]
    sessions.close("someone")
    sessions.close("someone")
    assert list((root / "sessions").iterdir()) == [other.folder]
    with pytest.raises(InputError, match="closed"), session.replace("left"):
        pass
    assert sessions["someone"].file("left") is None


@pytest.mark.parametrize("all_of_them", [False, True])
def test_closing_waits_for_what_is_written(root, sessions, all_of_them):
    close, names = (sessions.close_all, ()) if all_of_them else (sessions.close, ("a",))
    closing = Thread(target=close, args=names)
    with sessions["a"].replace("answer") as folder:
        closing.start()
        closing.join(0.1)
        folder.mkdir(parents=True, exist_ok=True)  # as an atomic write does
        (folder / "late.png").write_bytes(b"late")
        assert closing.is_alive()
    closing.join(10)
    assert list((root / "sessions").iterdir()) == []


def test_after_the_end_no_folder_is_made(root, sessions, session):
    sessions.close_all()
    with pytest.raises(InputError, match="closed"), session.replace("left"):
        pass
    for name in ("someone", "other"):
        with pytest.raises(InputError, match="server is being ended"):
            sessions[name]
    assert list((root / "sessions").iterdir()) == []


def test_dropping_waits_for_what_is_written(session):
    dropping = Thread(target=session.drop, args=("left",))
    with session.replace("left") as folder:
        dropping.start()
        dropping.join(0.1)
        assert dropping.is_alive()
        (folder / "left.png").write_bytes(b"new")
    dropping.join(10)
    assert [path.name for path in files_below(session.folder)] == ["right.png"]


def test_folders_are_the_servers_own(root, session):
    folders = [root / "sessions", *(path for path in root.rglob("sessions/**/") if path.is_dir())]
    assert len(folders) >= 4
    assert {folder.stat().st_mode & 0o777 for folder in folders} == {0o700}


def test_idle_sessions_are_closed(root):
    sessions = Sessions(root, max_idle=0)
    first = sessions["a"]
    assert sessions["a"] is first  # who asks for it is not idle
    second = sessions["b"]
    assert list(root.iterdir()) == [second.folder]


def test_the_one_idle_longest_makes_room(root):
    sessions = Sessions(root, max_sessions=2)
    a, b = sessions["a"], sessions["b"]
    assert sessions["a"] is a
    c = sessions["c"]
    assert set(root.iterdir()) == {a.folder, c.folder}
    with pytest.raises(InputError, match="closed"), b.replace("left"):
        pass
