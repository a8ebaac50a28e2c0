"""What the page does with pictures and numbers, without gradio."""

import base64
import struct
import zlib
from threading import Thread

import cv2
import numpy as np
import pytest
import torch

from mobilestereonet import InputError, StereoMatcher, create_model
from mobilestereonet.data.depth_files import write_depth
from mobilestereonet.data.files import read_pfm
from mobilestereonet.data.image_files import decode_image
from mobilestereonet.data.rig import Camera, CameraPair, Rig
from mobilestereonet.inference import Rectifier, load_pair
from mobilestereonet.web.answer import CLOUD, Geometry, answer
from mobilestereonet.web.sessions import Sessions
from mobilestereonet.web.uploads import UploadLimits, admit

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


@pytest.fixture
def session(root, sessions, upload):
    """A session with a pair."""
    session = sessions["someone"]
    for side, view in (("left", LEFT), ("right", RIGHT)):
        admit(upload(view), root, session, side, UploadLimits())
    return session


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
    kept = admit(path, root, sessions["a"], "left", UploadLimits())
    assert kept.name == "left.png"
    assert kept.is_relative_to(sessions["a"].folder)
    np.testing.assert_array_equal(decode_image(kept), LEFT)
    again = admit(upload(RIGHT), root, sessions["a"], "left", UploadLimits())
    assert files_below(root / "sessions") == [again]


def test_two_visitors_with_the_same_picture(root, sessions, upload):
    path = upload(LEFT)  # one path: gradio names it by its content
    kept = [admit(path, root, sessions[name], "left", UploadLimits()) for name in "ab"]
    sessions.close("a")
    assert files_below(root / "sessions") == kept[1:]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "no PNG, JPEG, WebP or BMP"),
        (b"no picture at all", "no PNG, JPEG, WebP or BMP"),
        (b"<svg xmlns='http://www.w3.org/2000/svg'/>", "no PNG, JPEG, WebP or BMP"),
        (b"GIF89a" + bytes(100), "no PNG, JPEG, WebP or BMP"),
        (png_header(2000, 1200), "2000 x 1200, more than 2.1 megapixels"),
        (png_header(60_000, 60_000), "more than 2.1 megapixels"),
        (png_header(0, 5), "no PNG, JPEG, WebP or BMP"),
        (bytes(2**20 + 1), "more than 1 MB"),
    ],
    ids=["empty", "text", "svg", "gif", "large", "bomb", "nothing", "heavy"],
)
def test_a_bad_upload_is_deleted(root, sessions, upload, content, words):
    path = upload(content)
    with pytest.raises(InputError, match=f"left picture: .*{words}") as error:
        admit(path, root, sessions["a"], "left", UploadLimits(megabytes=1))
    assert str(root) not in str(error.value)
    assert files_below(root) == []


def test_the_size_is_told_without_decoding(root, sessions, upload, monkeypatch):
    monkeypatch.setattr("PIL.ImageFile.ImageFile.load", lambda *_: pytest.fail("decoded"))
    with pytest.raises(InputError, match="megapixels"):
        admit(
            upload(png_header(9000, 9000)),
            root,
            sessions["a"],
            "left",
            UploadLimits(pixels=80_000_000),
        )


def test_only_uploads_are_taken(root, sessions, upload, tmp_path):
    secret = tmp_path / "secret.png"
    secret.write_bytes(cv2.imencode(".png", LEFT)[1].tobytes())
    theirs = admit(upload(LEFT), root, sessions["other"], "left", UploadLimits())
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
            admit(path, root, sessions["a"], "left", UploadLimits())
    assert secret.exists()
    assert theirs.exists()
    assert sessions["a"].file("left") is None


def test_what_is_shown_and_written(session, matcher):
    found = answer(session, matcher, Geometry(focal=50, baseline=0.2, doffs=3, max_depth=100))
    expected = matcher(LEFT[..., ::-1], RIGHT[..., ::-1])
    files = {path.name: path for path in found.files}
    np.testing.assert_array_equal(np.load(files["stereo_disparity.npy"]), expected.disparity)
    np.testing.assert_array_equal(read_pfm(files["stereo_disparity.pfm"]), expected.disparity)
    np.testing.assert_allclose(
        np.load(files["stereo_depth.npy"]), 50 * 0.2 / (expected.disparity + 3), rtol=1e-6
    )
    np.testing.assert_array_equal(decode_image(found.left), LEFT)
    assert decode_image(found.disparity).shape == LEFT.shape
    assert files["stereo_points.ply"].read_bytes().startswith(b"ply")
    assert session.file("answer", CLOUD).read_bytes().startswith(b"glTF")
    assert found.summary.startswith("msnet2d on torch fp32, 64x40: matched in ")
    assert set(files_below(session.folder)) >= set(found.files)


def test_readings_unpack_to_the_disparity(session, matcher):
    found = answer(session, matcher, Geometry(focal=50, baseline=0.2, doffs=3))
    expected = matcher(LEFT[..., ::-1], RIGHT[..., ::-1])
    png = base64.b64decode(found.readings["levels"].partition(",")[2])
    sure, low, high = np.moveaxis(
        cv2.imdecode(np.frombuffer(png, np.uint8), -1).astype(float), 2, 0
    )
    np.testing.assert_allclose((256 * high + low) / 256, expected.disparity, atol=1 / 512)
    np.testing.assert_allclose(sure / 255, expected.confidence, atol=1 / 510)
    assert found.readings["depth"] == pytest.approx(10)
    assert found.readings["doffs"] == 3


def test_without_calibration_there_is_no_depth(session, matcher):
    for empty in (Geometry(), Geometry(0, 0, 0)):
        found = answer(session, matcher, empty)
        assert found.readings["depth"] is None
        assert not any("depth" in path.name or "points" in path.name for path in found.files)
        assert session.file("answer", CLOUD) is None


def test_cameras_of_the_page(session, matcher):
    camera = np.array([[60.0, 0, 32], [0, 60, 20], [0, 0, 1]])
    turned = cv2.Rodrigues(np.array([0, 0, 0.02]))[0]
    lens = Camera(camera, np.zeros(5))
    pair = CameraPair(lens, lens, turned, np.array([-0.1, 0, 0]), (64, 40))
    rectifier = Rectifier(Rig((pair,), "the cameras of this page"))
    found = answer(session, matcher, Geometry(max_depth=100), rectifier)
    known = rectifier.calibration((64, 40))
    assert found.readings["depth"] == pytest.approx(known.focal * known.baseline)
    assert (decode_image(found.left) != LEFT).any()  # rectified
    own = answer(session, matcher, Geometry(50, 0.2), rectifier)  # what is filled in counts
    assert own.readings["depth"] == pytest.approx(10)
    small = Rectifier(Rig((CameraPair(lens, lens, turned, pair.translation, (63, 40)),), "cameras"))
    with pytest.raises(InputError, match=r"cameras: .*63x40, these have 64x40"):
        answer(session, matcher, Geometry(), small)


def test_views_that_cannot_give_depth_give_none(root, sessions, upload, matcher):
    noise = np.random.default_rng(0).integers(0, 256, (120, 260, 3), dtype=np.uint8)
    wide = cv2.GaussianBlur(noise, (0, 0), 1)
    session = sessions["someone else"]
    for side, view in (("left", wide[:, :240]), ("right", np.roll(wide, 6, axis=0)[:, 20:])):
        admit(upload(view), root, session, side, UploadLimits())
    found = answer(session, matcher, Geometry(focal=50, baseline=0.2))
    assert any("no depth and no points of such views (rectified)" in note for note in found.notes)
    assert found.readings["depth"] is None
    assert not any("depth" in path.name or "points" in path.name for path in found.files)


def test_an_engine_without_confidence(session):
    found = answer(session, StereoMatcher.from_pretrained("sgbm"), Geometry(50, 0.2, 0, 100, 0.5))
    assert found.confidence is None
    assert found.readings["confident"] is False
    assert session.file("answer", CLOUD) is not None


def test_no_point_is_a_note(session, matcher):
    found = answer(session, matcher, Geometry(50, 0.2, max_depth=1e-6))
    assert any(note.startswith("points: none") for note in found.notes)
    assert session.file("answer", CLOUD) is None


@pytest.mark.parametrize(
    ("geometry", "words"),
    [
        (Geometry(50, 0), "baseline is 0 or missing"),
        (Geometry(None, 0.1), "focal length is 0 or missing"),
        (Geometry(50, -0.1), "baseline must be positive"),
        (Geometry(float("nan"), 0.1), "focal must be positive"),
        (Geometry(50, 0.1, float("inf")), "doffs must be finite"),
    ],
)
def test_bad_calibration(session, matcher, geometry, words):
    before = files_below(session.folder)
    with pytest.raises(InputError, match=words):
        answer(session, matcher, geometry)
    assert files_below(session.folder) == before


def test_bad_pairs(root, session, upload, matcher):
    whole = cv2.imencode(".png", RIGHT)[1].tobytes()
    for content, words in (
        (RIGHT[:-8], "left picture has 64x40, right picture has 64x32"),
        (whole[:200], "right picture: not an image"),
    ):
        admit(upload(content), root, session, "right", UploadLimits())
        before = files_below(session.folder)
        with pytest.raises(InputError, match=words) as error:
            answer(session, matcher, Geometry())
        assert str(root) not in str(error.value)
        assert files_below(session.folder) == before
    session.drop("right")
    with pytest.raises(InputError, match="there is no right picture"):
        answer(session, matcher, Geometry())


def test_a_picture_that_goes_meanwhile(root, session, matcher, monkeypatch):
    def late(left, right):
        left.unlink()
        return load_pair(left, right)

    monkeypatch.setattr("mobilestereonet.web.answer.load_pair", late)
    with pytest.raises(InputError, match="left picture: no such file") as error:
        answer(session, matcher, Geometry())
    assert str(root) not in str(error.value)


def test_a_failure_on_the_way_leaves_the_former_answer(session, matcher, monkeypatch):
    answer(session, matcher, Geometry(50, 0.2))
    before = files_below(session.folder)

    def full(path, depth):
        write_depth(path, depth)
        raise OSError("no space left")

    monkeypatch.setattr("mobilestereonet.web.answer.write_depth", full)
    with pytest.raises(OSError, match="no space"):
        answer(session, matcher, Geometry(50, 0.2))
    assert files_below(session.folder) == before


def test_closing_deletes_everything(root, sessions, session, matcher):
    answer(session, matcher, Geometry(50, 0.2))
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
