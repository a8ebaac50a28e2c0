"""Cameras of RealSense, OAK and ZED, with stand-ins for their makers' libraries."""

import sys
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from noise_pairs import HEIGHT, WIDTH, centre, make_pair

from mobilestereonet import InputError
from mobilestereonet.inference import Rectifier
from mobilestereonet.streams import devices, open_stream


class Anything(SimpleNamespace):
    """Takes every call and has every attribute; gives itself."""

    def __getattr__(self, name):
        return self

    def __getitem__(self, name):
        return self

    def __call__(self, *arguments, **options):
        return self


INTRINSICS = SimpleNamespace(fx=100.0, fy=100.0, ppx=80.5, ppy=24.5, width=WIDTH, height=HEIGHT)


@pytest.fixture
def stopped():
    return []


@pytest.fixture
def realsense(monkeypatch, stopped):
    """A camera that sees noise again and again; tells which streams were asked for."""
    views = [cv2.cvtColor(view, cv2.COLOR_RGB2GRAY) for view in make_pair(12)]
    frames = SimpleNamespace(
        get_infrared_frame=lambda index: SimpleNamespace(get_data=lambda: views[index - 1])
    )
    profile = SimpleNamespace(
        get_intrinsics=lambda: INTRINSICS,
        get_extrinsics_to=lambda other: SimpleNamespace(translation=[-0.05, 0, 0]),
    )
    started = SimpleNamespace(
        get_device=Anything(),
        get_stream=lambda kind, index: SimpleNamespace(as_video_stream_profile=lambda: profile),
    )
    config = Anything(asked=[])
    config.enable_stream = lambda *stream: config.asked.append(stream)
    pipeline = SimpleNamespace(
        start=lambda config: started,
        wait_for_frames=lambda: frames,
        stop=lambda: stopped.append(True),
    )
    library = SimpleNamespace(
        pipeline=lambda: pipeline,
        config=lambda: config,
        stream=SimpleNamespace(infrared="infrared"),
        format=SimpleNamespace(y8="y8"),
        option=Anything(),
    )
    monkeypatch.setitem(sys.modules, "pyrealsense2", library)
    return config


def test_realsense_gives_depth_at_once(realsense, matcher, stopped):
    loop = matcher.stream("realsense:")
    result = next(loop)
    loop.close()
    assert stopped == [True]
    assert [stream[:2] for stream in realsense.asked] == [("infrared", 1), ("infrared", 2)]
    assert np.median(centre(result.disparity)) == pytest.approx(12, abs=0.1)
    known = result.calibration
    assert (known.focal, known.baseline, known.cx, known.size) == (100, 0.05, 80.5, (WIDTH, HEIGHT))
    assert np.median(centre(result.depth())) == pytest.approx(5 / 12, rel=0.01)


def test_a_camera_that_is_unplugged_ends_the_stream(realsense, stopped):
    pipeline = sys.modules["pyrealsense2"].pipeline()
    frames = [pipeline.wait_for_frames()]

    def wait():
        if frames:
            return frames.pop()
        raise RuntimeError("Frame didn't arrive within 5000")

    pipeline.wait_for_frames = wait
    with pytest.warns(UserWarning, match="realsense: gave no more pictures after 1 frames .*5000"):
        assert len(list(open_stream("realsense:").frames)) == 1
    assert stopped == [True]


def test_a_camera_that_fails_after_its_start_is_stopped(realsense, stopped):
    def fail():
        raise RuntimeError("no such option")

    sys.modules["pyrealsense2"].pipeline().start(None).get_device = fail
    with pytest.raises(InputError, match="cannot be opened"):
        open_stream("realsense:")
    assert stopped == [True]


class Handler:
    """The factory's calibration as depthai tells it, of cameras that are turned and distort."""

    lens = np.array([-0.2, 0.05, 0.001, 0, 0] + [0] * 9)
    model = "Perspective"
    turn = cv2.Rodrigues(np.array([0.01, 0.02, -0.01]))[0]

    def getCameraIntrinsics(self, socket, width, height):  # noqa: N802
        return [[400.0, 0, width / 2], [0, 400.0, height / 2], [0, 0, 1]]

    def getDistortionModel(self, socket):  # noqa: N802
        return SimpleNamespace(name=self.model)

    def getDistortionCoefficients(self, socket):  # noqa: N802
        return self.lens.tolist()

    def getCameraExtrinsics(self, source, target):  # noqa: N802
        assert (source, target) == ("B", "C")
        pose = np.eye(4)
        pose[:3, :3] = self.turn
        pose[:3, 3] = self.turn @ [-7.5, 0, 0]  # cm
        return pose.tolist()


def test_oaks_calibration_is_in_centimetres():
    rig = devices.oak_rig(Handler(), ("B", "C"), (640, 400))
    (cameras,) = rig.geometries
    np.testing.assert_allclose(cameras.translation, Handler.turn @ [-0.075, 0, 0])
    assert (cameras.size, cameras.left.fisheye) == ((640, 400), False)
    calibration = Rectifier(rig).calibration((640, 400))
    assert calibration.baseline == pytest.approx(0.075)
    assert calibration.focal == pytest.approx(400, rel=0.2)


def test_the_lens_model_of_an_oak():
    handler = Handler()
    handler.model = "Fisheye"
    (cameras,) = devices.oak_rig(handler, ("B", "C"), (640, 400)).geometries
    for camera in (cameras.left, cameras.right):
        assert camera.fisheye
        np.testing.assert_array_equal(camera.distortion, Handler.lens[:4])
    for model in ("Equirectangular", "RadialDivision"):
        handler.model = model
        with pytest.raises(InputError, match=f"socket B has a lens of the model {model}"):
            devices.oak_rig(handler, ("B", "C"), (640, 400))


def test_oak_gives_rectified_pictures(monkeypatch, matcher, stopped):
    views = dict(zip(("left", "right"), make_pair(9), strict=True))
    group = {
        name: SimpleNamespace(getCvFrame=lambda view=view: cv2.resize(view[..., 0], (640, 400)))
        for name, view in views.items()
    }
    library = Anything(CameraBoardSocket=SimpleNamespace(CAM_B="B", CAM_C="C"))
    library.Device = lambda: SimpleNamespace(readCalibration=Handler)
    pipeline = Anything(stop=lambda: stopped.append(True), get=lambda: group)
    library.Pipeline = lambda device: pipeline
    monkeypatch.setitem(sys.modules, "depthai", library)
    stream = open_stream("oak:")
    frame = next(stream.frames)
    stream.frames.close()
    assert (frame.pair.width, frame.pair.height) == (640, 400)
    assert stopped == [True]
    assert stream.live


class Status:
    """A ZED's answers: names, as its library prints them."""

    SUCCESS = "SUCCESS"
    CAMERA_NOT_DETECTED = "CAMERA NOT DETECTED"


def zed_parameters():
    """Calibration of rectified pictures in the form in which the maker's library tells it."""
    lens = SimpleNamespace(
        fx=262.94,
        fy=262.94,
        cx=328.37,
        cy=186.16,
        image_size=SimpleNamespace(width=672, height=376),
    )
    return SimpleNamespace(left_cam=lens, right_cam=lens, get_camera_baseline=lambda: 0.11997)


@pytest.fixture
def zed(monkeypatch, stopped):
    """A camera that sees noise; its pictures are BGRA and lie in one array, again and again."""
    size = (672, 376)
    views = {
        side: cv2.cvtColor(cv2.resize(view, size), cv2.COLOR_RGB2BGRA)
        for side, view in zip(("left", "right"), make_pair(12), strict=True)
    }
    memory = np.zeros((376, 672, 4), np.uint8)
    configuration = SimpleNamespace(calibration_parameters=zed_parameters())

    def retrieve(picture, view):
        memory[...] = views[view]
        return Status.SUCCESS

    camera = SimpleNamespace(
        open=lambda wanted: Status.SUCCESS,
        get_camera_information=lambda: SimpleNamespace(camera_configuration=configuration),
        grab=lambda: Status.SUCCESS,
        retrieve_image=retrieve,
        close=lambda: stopped.append(True),
    )
    wanted = Anything(serials=[])
    wanted.set_from_serial_number = wanted.serials.append
    library = SimpleNamespace(
        Camera=lambda: camera,
        InitParameters=lambda: wanted,
        Mat=lambda: SimpleNamespace(get_data=lambda: memory),
        DEPTH_MODE=SimpleNamespace(NONE="none"),
        UNIT=SimpleNamespace(METER="metre"),
        VIEW=SimpleNamespace(LEFT="left", RIGHT="right"),
        ERROR_CODE=Status,
    )
    monkeypatch.setitem(sys.modules, "pyzed", SimpleNamespace(sl=library))
    return SimpleNamespace(camera=camera, wanted=wanted, views=views)


def test_zed_gives_rectified_pictures_and_metres(zed, stopped):
    stream = open_stream("zed:30573852")
    assert zed.wanted.serials == [30573852]
    assert (zed.wanted.depth_mode, zed.wanted.coordinate_units) == ("none", "metre")
    known = stream.calibration
    assert (known.focal, known.baseline, known.doffs, known.size) == (
        262.94,
        0.11997,
        0,
        (672, 376),
    )
    assert (known.cx, known.cy, known.focal_y) == (328.37, 186.16, None)
    frame = next(stream.frames)
    stream.frames.close()
    assert stopped == [True]
    for side in ("left", "right"):
        expected = cv2.cvtColor(zed.views[side], cv2.COLOR_BGRA2RGB)
        np.testing.assert_array_equal(getattr(frame.pair, f"{side}_image"), expected)


def test_zeds_that_fail(zed, stopped, monkeypatch):
    zed.camera.grab = lambda: Status.CAMERA_NOT_DETECTED
    with pytest.warns(UserWarning, match="zed: gave no more pictures after 0 .*NOT DETECTED"):
        assert not list(open_stream("zed:").frames)
    assert stopped == [True]
    zed.camera.open = lambda wanted: Status.CAMERA_NOT_DETECTED
    with pytest.raises(InputError, match=r"zed:: this camera .*: CAMERA NOT DETECTED"):
        open_stream("zed:")
    with pytest.raises(InputError, match="the serial number of a ZED is digits"):
        open_stream("zed:front")
    monkeypatch.setitem(sys.modules, "pyzed", None)
    with pytest.raises(InputError, match=r"pyzed .* ZED SDK, .*get_python_api.py .*/usr/local/zed"):
        open_stream("zed:")


@pytest.mark.parametrize("maker", ["realsense", "oak"])
def test_a_camera_that_is_not_there(monkeypatch, maker):
    def refuse(*arguments):
        raise RuntimeError("No device connected")

    library = SimpleNamespace(pipeline=refuse, config=Anything(), Device=refuse)
    module = {"realsense": "pyrealsense2", "oak": "depthai"}[maker]
    monkeypatch.setitem(sys.modules, module, library)
    with pytest.raises(InputError, match=f"{maker}:: this camera .*: No device connected"):
        open_stream(f"{maker}:")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=rf'pip install "mobilestereonet\[{maker}\]"'):
        open_stream(f"{maker}:")
    with pytest.raises(InputError, match="has both views: leave 1 out"):
        open_stream(f"{maker}:", "1")
