"""Bags of ROS as sources and as sinks, read and written with two libraries."""

import re
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from noise_pairs import centre, make_pair
from ros_bags import (
    BASELINE_M,
    FOCAL_PX,
    FORMATS,
    START_NS,
    VIEWS,
    BagWriter,
    projection,
    write_bag,
)

from extras import need_extra
from mobilestereonet.cli import early
from mobilestereonet.cli.sinks import TopicOptions
from mobilestereonet.errors import InputError
from mobilestereonet.streams import bag_file, bag_writer, open_stream, stereo_bag
from mobilestereonet.streams.ros_input import calibration_of, check_encoding, picture_of

SGBM = ("--model", "sgbm", "--max-disparity", 64)


@pytest.fixture
def rosbags():
    return need_extra("rosbags")


def topics(left, right):
    return "--left", left, "--right", right


def read_mcap(path):
    """Messages by topic, read with the format's own library."""
    need_extra("mcap_ros2")
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    messages = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, record, message in reader.iter_decoded_messages():
            messages.setdefault((channel.topic, schema.name), []).append((record, message))
    return messages


def read_ros1(path):
    from rosbags.highlevel import AnyReader

    messages = {}
    with AnyReader([path]) as reader:
        for connection, time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            key = connection.topic, connection.msgtype
            messages.setdefault(key, []).append((SimpleNamespace(log_time=time), message))
    return messages


def values_of(image, dtype):
    return np.frombuffer(image.data, dtype).reshape(image.height, image.width)


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("compressed", ["", "/compressed"])
def test_a_bag_gives_disparity_and_depth(rosbags, msnet, tmp_path, name, compressed):
    views = [view + compressed for view in VIEWS]
    bag = write_bag(tmp_path / name, views, frames=2)
    if name == "run":
        bag = next(bag.glob("*.db3")) if compressed else bag  # the folder, or the file in it
    code, out, err = msnet("video", bag, *topics(*views), "--frames", tmp_path / "maps", *SGBM)
    assert (code, err) == (0, "")
    assert "2 frames" in out
    for frame in range(2):
        path = tmp_path / "maps" / f"{frame:06d}"
        disparity = centre(cv2.imread(f"{path}_disparity.png", -1)) / 256
        assert np.median(disparity) == pytest.approx(10 + frame, abs=0.1)
        depth = centre(cv2.imread(f"{path}_depth.png", -1))
        assert np.median(depth) == pytest.approx(
            1000 * FOCAL_PX * BASELINE_M / (10 + frame), rel=0.01
        )


def test_raw_images_are_rectified(rosbags, msnet, tmp_path):
    raw = [view.replace("rect", "raw") for view in VIEWS]
    lens = [-0.2, 0.05, 0.004, 0.002, 0]
    write_bag(tmp_path / "raw.mcap", raw, frames=1, distortion=lens)
    write_bag(tmp_path / "rect.mcap", frames=1)
    frames = [
        next(open_stream(str(tmp_path / name), left_topic=left, right_topic=right).frames)
        for name, (left, right) in (("raw.mcap", raw), ("rect.mcap", VIEWS))
    ]
    for side in ("left_image", "right_image"):
        got, true = (getattr(frame.pair, side).astype(float)[10:-10, 20:-20] for frame in frames)
        assert np.corrcoef(got.ravel(), true.ravel())[0, 1] > 0.9
    code, _, _ = msnet(
        "video", tmp_path / "raw.mcap", *topics(*raw), "--frames", tmp_path / "m", *SGBM
    )
    assert code == 0
    depth = centre(cv2.imread(str(tmp_path / "m/000000_depth.png"), -1))
    assert np.median(depth) == pytest.approx(1000 * FOCAL_PX * BASELINE_M / 10, rel=0.02)


LENS = [-0.2, 0.05, 0.004, 0.002, 0]
RAW = [view.replace("rect", "raw") for view in VIEWS]


def write_rig(path):
    """The cameras of `write_bag`'s raw pictures as OpenCV's file."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    camera, lens = projection()[:, :3], np.float64(LENS)
    values = {"M1": camera, "D1": lens, "M2": camera, "D2": lens, "R": np.eye(3)}
    for name, value in (values | {"T": np.float64([-BASELINE_M, 0, 0])}).items():
        storage.write(name, value)
    storage.release()
    return path


@pytest.mark.parametrize("out", ["out.mcap", "out.bag"])
@pytest.mark.parametrize("rig", [False, True])
def test_a_raw_bag_becomes_a_rectified_one(rosbags, msnet, tmp_path, out, rig):
    source = write_bag(tmp_path / "raw.mcap", RAW, frames=2, distortion=LENS, calibrated=not rig)
    given = ("--rig", write_rig(tmp_path / "rig.yml")) if rig else ()
    new = tmp_path / "new" / out
    code, told, err = msnet("rectify", source, *topics(*RAW), *given, "-o", new)
    assert (code, told, err) == (0, f"{new}\n", "")
    assert list(new.parent.iterdir()) == [new]
    messages = read_mcap(new) if new.suffix == ".mcap" else read_ros1(new)
    kinds = {"image_rect": "sensor_msgs/msg/Image", "camera_info": "sensor_msgs/msg/CameraInfo"}
    sides = ("left", "right")
    assert set(messages) == {(f"/stereo/{s}/{n}", k) for s in sides for n, k in kinds.items()}
    for view, side in enumerate(sides):
        for name, kind in kinds.items():
            sent = messages[f"/stereo/{side}/{name}", kind]
            for frame, (record, message) in enumerate(sent):
                stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                assert stamp == START_NS + frame * 10**8 + view * 2 * 10**6 == record.log_time
                assert message.header.frame_id == f"{side}_camera"
        info = messages[f"/stereo/{side}/camera_info", kinds["camera_info"]][0][1]
        p = np.reshape(getattr(info, "p", getattr(info, "P", None)), (3, 4))
        assert p[0, 3] == pytest.approx(-view * p[0, 0] * BASELINE_M)
        assert not np.any(getattr(info, "d", getattr(info, "D", None)))
    # What was rectified is a source like any other, and is not rectified again.
    stream = open_stream(str(new), left_topic=VIEWS[0], right_topic=VIEWS[1])
    known = stream.calibration
    assert (known.baseline, known.size) == (pytest.approx(BASELINE_M), (160, 48))
    pair = next(stream.frames).pair
    stream.frames.close()
    image = messages["/stereo/left/image_rect", kinds["image_rect"]][0][1]
    sent = np.frombuffer(image.data, np.uint8).reshape(48, 160, 3)
    np.testing.assert_array_equal(pair.left_image, sent)
    if not rig:  # by camera_info the projection is the one that the pictures had
        write_bag(tmp_path / "rect.mcap", frames=1)
        whole = open_stream(str(tmp_path / "rect.mcap"), left_topic=VIEWS[0], right_topic=VIEWS[1])
        true = next(whole.frames).pair.left_image.astype(float)[10:-10, 20:-20]
        got = sent.astype(float)[10:-10, 20:-20]
        assert np.corrcoef(got.ravel(), true.ravel())[0, 1] > 0.9


def test_a_bag_is_rectified_to_folders_too(rosbags, msnet, tmp_path):
    source = write_bag(tmp_path / "raw.bag", RAW, frames=2, distortion=LENS, skipped=[(1, 1)])
    code, told, err = msnet("rectify", source, *topics(*RAW), "-o", tmp_path / "new")
    names = ["left/000000.png", "right/000000.png", "calib.txt"]
    assert told.splitlines() == [str(tmp_path / "new" / name) for name in names]
    assert code == 1
    assert re.fullmatch(r"msnet: 000001 skipped: .*/right/image_raw has no image within .*\n", err)


def test_sixteen_bits_stay_sixteen(rosbags, msnet, tmp_path):
    grey = make_pair(9)[0][..., 0].astype(np.uint16) * 200
    with BagWriter(tmp_path / "raw.mcap") as bag:
        for topic in ("/cam/left_image", "/cam/right_image"):  # of one namespace
            bag.image(topic, START_NS, grey, "mono16")
    rig = "--rig", write_rig(tmp_path / "rig.yml")
    sides = topics("/cam/left_image", "/cam/right_image")
    code, _, _ = msnet("rectify", tmp_path / "raw.mcap", *sides, *rig, "-o", tmp_path / "a.mcap")
    assert code == 0
    messages = read_mcap(tmp_path / "a.mcap")
    image = messages["/cam/left_image/image_rect", "sensor_msgs/msg/Image"][0][1]
    assert image.encoding == "mono16"
    assert values_of(image, "<u2").max() > 40_000
    assert ("/cam/right_image/camera_info", "sensor_msgs/msg/CameraInfo") in messages


@pytest.mark.parametrize("transport", ["", "/compressed"])
def test_rectified_images_of_one_namespace(rosbags, tmp_path, transport):
    views = [f"/cam/left_image{transport}", f"/cam/right_image{transport}"]
    bag = bag_file.RectifiedBag(tmp_path / "a.mcap", views)
    assert bag.namespaces == ["/cam/left_image", "/cam/right_image"]


def test_what_cannot_be_rectified_is_told(rosbags, msnet, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_bag(tmp_path / "rect.mcap", frames=1)
    write_bag(tmp_path / "bare.mcap", RAW, frames=1, calibrated=False)
    rig = "--rig", write_rig(tmp_path / "rig.yml")
    cv2.imwrite("a.png", make_pair(9)[0])
    pair, rect = ("a.png", "a.png", *rig), ("rect.mcap", *topics(*VIEWS))
    before = {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")}
    for words, message in (
        ((*rect, *rig, "-o", "a"), "is rectified already, as its camera_info tells"),
        (("bare.mcap", *topics(*RAW), "-o", "a"), "no calibration in it (camera_info): give --rig"),
        (("rect.mcap", "-o", "a"), "rect.mcap: name both views"),
        ((*pair, "-o", "a.mcap"), "a.mcap: a bag is written of a bag alone: name a folder"),
        ((*pair, "--left", "/a", "-o", "a"), "--tolerance are of a bag"),
        ((*rect, "-o", "rect.mcap"), "rect.mcap: this call reads it"),
    ):
        code, out, err = msnet("rectify", *words)
        assert (code, out) == (2, "")
        assert re.fullmatch(rf"msnet: .*{re.escape(message)}.*\n", err)
    assert before == {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")}


def test_a_rig_comes_before_a_bags_camera_info(rosbags, msnet, tmp_path):
    source = write_bag(tmp_path / "raw.mcap", RAW, frames=1, distortion=LENS)
    rig = "--rig", write_rig(tmp_path / "rig.yml")
    depth = []
    for words in ((), rig):
        maps = tmp_path / f"maps{len(words)}"
        code, _, err = msnet("video", source, *topics(*RAW), *words, "--frames", maps, *SGBM)
        assert (code, err) == (0, "")
        depth.append(np.median(centre(cv2.imread(str(maps / "000000_depth.png"), -1))))
    assert depth[0] == pytest.approx(depth[1], rel=0.02)
    code, _, err = msnet(
        "video", write_bag(tmp_path / "r.mcap", frames=1), *topics(*VIEWS), *rig, "--frames", maps
    )
    assert code == 2
    assert "rectified already" in err


@pytest.mark.parametrize(
    ("topic", "rectified"),
    [
        ("/stereo/{}/image_rect", True),
        ("/stereo/{}/image_rect_color/compressed", True),
        ("/stereo/{}/image_rect_raw", True),
        ("/rect/{}/image", True),
        ("/zed/{}/image_rectified", True),
        ("/zed/{}_rectified/image", True),
        ("/direct/{}/image_raw", False),
        ("/{}/image_unrectified", False),
        ("/rectangle/{}/image", False),
        ("/{}/image_raw", False),
    ],
)
def test_names_of_rectified_images(topic, rectified):
    views = [topic.format(side) for side in ("left", "right")]
    assert stereo_bag.are_rectified(Path("run.bag"), views) == rectified
    with pytest.raises(InputError, match="name two topics with rectified images, or two with raw"):
        stereo_bag.are_rectified(Path("run.bag"), ["/left/image_rect", "/right/image_raw"])


@pytest.mark.parametrize("ending", [".mcap", ".bag"])
def test_results_go_to_a_bag(rosbags, msnet, tmp_path, ending):
    source, out = write_bag(tmp_path / "run.mcap", frames=2), tmp_path / f"new/out{ending}"
    code, _, err = msnet("video", source, *topics(*VIEWS), "--bag", out, *SGBM)
    assert (code, err) == (0, "")
    assert list(out.parent.iterdir()) == [out]
    messages = read_mcap(out) if ending == ".mcap" else read_ros1(out)
    kinds = {
        ("/stereo/disparity", "stereo_msgs/msg/DisparityImage"),
        ("/stereo/depth", "sensor_msgs/msg/Image"),
        ("/stereo/points2", "sensor_msgs/msg/PointCloud2"),
        ("/stereo/camera_info", "sensor_msgs/msg/CameraInfo"),  # those of both cameras are there
    }
    assert set(messages) == kinds
    for (_, kind), sent in messages.items():
        assert len(sent) == 2
        for frame, (record, message) in enumerate(sent):
            stamp = message.header.stamp
            assert stamp.sec * 10**9 + stamp.nanosec == START_NS + frame * 10**8 == record.log_time
            assert message.header.frame_id == "left_camera"
            if kind.endswith("DisparityImage"):
                assert message.image.header == message.header
    check_disparity_and_depth(
        messages["/stereo/disparity", "stereo_msgs/msg/DisparityImage"][1][1],
        messages["/stereo/depth", "sensor_msgs/msg/Image"][1][1],
    )
    check_points(messages["/stereo/points2", "sensor_msgs/msg/PointCloud2"][1][1])


def check_disparity_and_depth(message, depth_image):
    assert message.image.encoding == depth_image.encoding == "32FC1"
    assert message.image.step == 4 * message.image.width
    disparity, depth = values_of(message.image, "<f4"), values_of(depth_image, "<f4")
    assert np.median(centre(disparity)) == pytest.approx(11, abs=0.1)
    baseline = message.t if hasattr(message, "t") else message.T
    assert (message.f, baseline) == pytest.approx((FOCAL_PX, BASELINE_M))
    assert (message.min_disparity, message.max_disparity) == (0, 63)
    assert 0 < message.delta_d < 0.1
    window = message.valid_window
    assert (window.x_offset, window.y_offset, window.width, window.height) == (0, 0, 160, 48)
    known = disparity > 1 / 128
    np.testing.assert_allclose(depth[known], message.f * baseline / disparity[known], rtol=1e-5)
    assert np.isnan(depth[disparity < message.min_disparity]).all()


def check_points(message):
    assert [field.name for field in message.fields] == ["x", "y", "z", "rgb"]
    assert len(message.data) == message.row_step == message.width * message.point_step
    points = np.frombuffer(message.data, "<f4").reshape(-1, 4)
    assert np.isfinite(points).all()
    assert np.median(points[:, 2]) == pytest.approx(FOCAL_PX * BASELINE_M / 11, rel=0.02)
    colours = np.frombuffer(message.data, np.uint8).reshape(-1, 16)[:, 12:]
    assert colours[:, 3].max() == 0
    assert colours[:, :3].std() > 10


def test_what_is_unknown_lies_below_the_range(rosbags, tmp_path):
    from mobilestereonet import Calibration, StereoResult
    from mobilestereonet.streams import BagFile, StereoFrame

    disparity = np.array([[4, np.inf, 2, 0]], np.float32)
    result = StereoResult(
        left=np.zeros((1, 4, 3), np.uint8),
        disparity=disparity,
        valid=np.isfinite(disparity),
        confidence=np.array([[1, 0, 0.5, 0]], np.float32),
    )
    with BagFile(tmp_path / "a.mcap", 64, max_depth=2) as bag:
        frame = StereoFrame(3, "3", 1.5, None)
        bag.write(frame, result, Calibration(focal=10, baseline=0.5, doffs=1))
    messages = {topic: sent[0][1] for (topic, _), sent in read_mcap(tmp_path / "a.mcap").items()}
    message = messages["/stereo/disparity"]
    assert values_of(message.image, "<f4").tolist() == [[5, 0, 3, 1]]
    assert (message.min_disparity, message.max_disparity) == (1, 64)
    np.testing.assert_allclose(
        values_of(messages["/stereo/depth"], "<f4"), [[1, np.nan, 5 / 3, 5]], rtol=1e-6
    )
    assert messages["/stereo/points2"].width <= 2
    assert messages["/stereo/confidence"].encoding == "mono8"
    assert list(messages["/stereo/confidence"].data) == [255, 0, 128, 0]
    stamp = message.header.stamp
    assert (stamp.sec, stamp.nanosec, message.header.frame_id) == (
        1,
        500_000_000,
        bag_file.FRAME_ID,
    )


def test_a_bag_that_fails_leaves_nothing(rosbags, msnet, tmp_path):
    bag = write_bag(tmp_path / "run.mcap", frames=1)
    calibration = tmp_path / "calib.txt"  # of a smaller picture
    calibration.write_text("cam0=[9 0 4; 0 9 4; 0 0 1]\nbaseline=100\ndoffs=0\nwidth=8\nheight=8\n")
    new = "--bag", tmp_path / "out.mcap", "--calib", calibration
    code, _, err = msnet("video", bag, *topics(*VIEWS), *new, *SGBM)
    assert code == 2
    assert "of pictures of 8x8" in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["calib.txt", "run", "run.mcap"]


def test_images_without_a_partner_are_reported(rosbags, msnet, tmp_path):
    bag = write_bag(tmp_path / "run.mcap", skipped=[(1, 1), (0, 3)])
    code, out, err = msnet("video", bag, *topics(*VIEWS), "--frames", tmp_path / "maps", *SGBM)
    assert code == 0
    assert "2 frames" in out
    assert "2 broken frames skipped" in out
    assert re.search(rf"frame 000001 skipped: {VIEWS[0]} at .* {VIEWS[1]} has no image within", err)
    assert re.search(rf"frame 000003 skipped: {VIEWS[1]} at .* {VIEWS[0]} has no image within", err)
    tight = "--tolerance", 0.001, "--frames", tmp_path / "maps"
    assert "no frame could be matched" in msnet("video", bag, *topics(*VIEWS), *tight, *SGBM)[2]


def test_results_bring_the_camera_info_that_their_source_lacks(rosbags, msnet, tmp_path):
    source = write_bag(tmp_path / "raw.mcap", RAW, frames=2, calibrated=False)
    out, rig = tmp_path / "out.mcap", write_rig(tmp_path / "rig.yml")
    code, _, err = msnet("video", source, *topics(*RAW), "--rig", rig, "--bag", out, *SGBM)
    assert (code, err) == (0, "")
    sent = {topic: [message for _, message in told] for (topic, _), told in read_mcap(out).items()}
    for side, late in (("", 0), ("left/", 0), ("right/", 2 * 10**6)):
        infos = sent[f"/stereo/{side}camera_info"]
        assert len(infos) == 2
        info, disparity = infos[1], sent["/stereo/disparity"][1]
        stamp = info.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == START_NS + 10**8 + late
        assert info.header.frame_id == f"{side.rstrip('/') or 'left'}_camera"
        assert (info.width, info.height) == (160, 48)
        focal, offset = info.p[0], info.p[3]
        assert focal == pytest.approx(disparity.f)
        assert -offset / focal == pytest.approx(disparity.t if side == "right/" else 0)


@pytest.mark.parametrize("name", ["run.mcap", "run.bag"])
@pytest.mark.parametrize("frame", [0, 1])
def test_a_damaged_message_is_told(rosbags, tmp_path, name, frame):
    path = write_bag(tmp_path / name, frames=2)
    data = bytearray(path.read_bytes())
    marks = [found.start() for found in re.finditer(rb"\0\0\0rgb8", data)]
    data[marks[2 * frame] - 1 : marks[2 * frame] + 3] = b"\xff\xff\xff\x7f"
    path.write_bytes(data)
    with pytest.raises(InputError, match=f"{name}: the bag is damaged: .*copy it again"):
        list(stereo_bag.StereoBag.open(path, *VIEWS).pairs())


def test_what_the_reader_says_of_damage_is_told(rosbags, tmp_path, monkeypatch):
    from rosbags import highlevel, rosbag1

    bag = stereo_bag.StereoBag.open(write_bag(tmp_path / "run.bag", frames=1), *VIEWS)

    def fail(*_, **__):
        raise rosbag1.ReaderError("a broken chunk")

    monkeypatch.setattr(highlevel.AnyReader, "messages", fail)
    with pytest.raises(InputError, match=r"run\.bag: the bag is damaged: a broken chunk"):
        list(bag.pairs())


def test_a_loop_over_a_bag(rosbags, matcher, tmp_path):
    rect = write_bag(tmp_path / "rect.bag", frames=2)
    raw = write_bag(tmp_path / "raw.mcap", RAW, frames=2, distortion=LENS, calibrated=False)
    rig = write_rig(tmp_path / "rig.yml")
    for bag, (left, right), given in ((rect, VIEWS, None), (raw, RAW, rig)):
        loop = matcher.stream(bag, left_topic=left, right_topic=right, rig=given)
        for frame, result in enumerate(loop):
            assert result.frame.stamp == START_NS + frame * 10**8
            true = FOCAL_PX * BASELINE_M / (10 + frame)
            assert np.median(centre(result.depth())) == pytest.approx(true, rel=0.03)
        assert frame == 1


def test_results_of_exchanged_topics_are_of_the_left_camera(rosbags, msnet, tmp_path):
    bag = write_bag(tmp_path / "run.mcap", frames=1, calibrated=False)
    code, _, err = msnet("video", bag, *topics(*VIEWS[::-1]), "--bag", tmp_path / "a.mcap", *SGBM)
    assert code == 0
    assert "have been exchanged" in err
    (message,) = [sent[0][1] for sent in read_mcap(tmp_path / "a.mcap").values()]
    assert message.header.frame_id == "left_camera"
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == START_NS
    assert np.median(centre(values_of(message.image, "<f4"))) == pytest.approx(10, abs=0.1)


def test_topics_that_camera_info_has_in_the_other_order(rosbags, msnet, tmp_path):
    """The views are exchanged by the first look; how depth is had, too, is said."""
    bag = write_bag(tmp_path / "run.mcap", frames=1)
    code, _, err = msnet("video", bag, *topics(*VIEWS[::-1]), "--bag", tmp_path / "a.mcap", *SGBM)
    assert code == 0
    assert f"by it {VIEWS[0]} is the left view: exchange --left and --right" in err
    assert "no calibration, so disparities and no depth" in err
    assert [topic for topic, _ in read_mcap(tmp_path / "a.mcap")] == ["/stereo/disparity"]


def test_limits_of_depth_need_a_calibration(rosbags, msnet, tmp_path):
    bag = write_bag(tmp_path / "run.mcap", frames=1, calibrated=False)
    words = ("video", bag, *topics(*VIEWS), "--bag", tmp_path / "a.mcap", *SGBM)
    code, _, err = msnet(*words, "--max-depth", 3)
    assert (code, "--max-depth needs --rig FILE" in err) == (2, True)
    assert not (tmp_path / "a.mcap").exists()


def test_an_uncalibrated_bag_gives_disparity_alone(rosbags, msnet, tmp_path):
    bag = write_bag(tmp_path / "run.mcap", frames=1, calibrated=False)
    assert open_stream(str(bag), left_topic=VIEWS[0], right_topic=VIEWS[1]).calibration is None
    code, _, _ = msnet("video", bag, *topics(*VIEWS), "--bag", tmp_path / "out.mcap", *SGBM)
    assert code == 0
    assert [topic for topic, _ in read_mcap(tmp_path / "out.mcap")] == ["/stereo/disparity"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("run.mcap",),
            rf"run.mcap: name both views, .*; images in it: {VIEWS[0]} \(1 of Image\), ",
        ),
        (("run.mcap", "--left", VIEWS[0]), "run.mcap: name both views"),
        (("run.mcap", *topics(VIEWS[0], "/other")), "no images on the topic /other; images in it"),
        (("run.mcap", *topics(VIEWS[0], VIEWS[0])), "is both the left and the right view"),
        (("run.mcap", *topics("/stereo/left/camera_info", VIEWS[0])), "no images on the topic"),
        (("run.mcap", "run.mcap", *topics(*VIEWS)), "a bag has both views, give it alone"),
        (("absent.bag", *topics(*VIEWS)), "absent.bag: no such bag"),
        (("text.bag", *topics(*VIEWS)), "text.bag: not a bag that can be read"),
        (("bytes.bag", *topics(*VIEWS)), "bytes.bag: not a bag that can be read"),
        (("text.mcap", *topics(*VIEWS)), "text.mcap: not a bag that can be read"),
        (("text.db3", *topics(*VIEWS)), "text.db3: not a bag that can be read"),
        (("folder", *topics(*VIEWS)), "folder: not a bag that can be read"),
        (("left", "right", *topics(*VIEWS)), "topics are those of a bag"),
        (
            ("run.mcap", *topics(*VIEWS), "--bag", "run.mcap"),
            "run.mcap: this call reads it",
        ),
        (("run.mcap", *topics(*VIEWS), "--bag", "out.db3"), "bags are written as .mcap, .bag"),
    ],
)
def test_bad_input_ends_with_one_line(rosbags, msnet, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    write_bag(tmp_path / "run.mcap", frames=1)
    for ending in ("bag", "mcap", "db3"):
        (tmp_path / f"text.{ending}").write_text("no bag\n")
    (tmp_path / "bytes.bag").write_bytes(b"\x89MCAP0\r\n" * 2)
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder/metadata.yaml").write_text("rosbag2_bagfile_information: 3\n")
    code, out, err = msnet("video", *arguments, "--frames", "maps", *SGBM)
    assert (code, out) == (2, "")
    assert re.fullmatch(rf"msnet: .*{message}.*\n", err)
    assert not (tmp_path / "maps").exists()


RGB = np.random.default_rng(0).integers(0, 256, (4, 6, 3), dtype=np.uint8)
GREY = RGB[..., 0]
ALPHA = np.dstack((RGB, GREY))


@pytest.mark.parametrize(
    ("encoding", "pixels", "expected"),
    [
        ("rgb8", RGB, RGB),
        ("bgr8", RGB[..., ::-1], RGB),
        ("rgba8", ALPHA, RGB),
        ("bgra8", ALPHA[..., [2, 1, 0, 3]], RGB),
        ("8UC3", RGB[..., ::-1], RGB),
        ("mono8", GREY, GREY),
        ("8UC1", GREY, GREY),
        ("mono16", GREY.astype(np.uint16) * 257, GREY.astype(np.uint16) * 257),
        ("bgr16", RGB[..., ::-1].astype(np.uint16) * 257, RGB.astype(np.uint16) * 257),
    ],
)
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("padding", [0, 5])
def test_encodings(encoding, pixels, expected, big, padding):
    rows = pixels.astype(pixels.dtype.newbyteorder(">" if big else "<")).view(np.uint8)
    rows = np.pad(np.ascontiguousarray(rows).reshape(4, -1), ((0, 0), (0, padding)))
    message = SimpleNamespace(
        encoding=encoding,
        height=4,
        width=6,
        step=rows.shape[1],
        is_bigendian=int(big),
        data=rows.tobytes(),
    )
    picture = picture_of(message)
    assert picture.dtype == expected.dtype
    np.testing.assert_array_equal(picture, expected)
    message.data = message.data[: -padding - 1]
    with pytest.raises(InputError, match="a damaged image"):
        picture_of(message)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_bayer_patterns(pattern, dtype):
    colour = np.array([200, 120, 40], dtype)
    tile = [colour["rgb".index(letter)] for letter in pattern]
    mosaic = np.tile(np.array(tile, dtype).reshape(2, 2), (4, 4))
    message = SimpleNamespace(
        encoding=f"bayer_{pattern}{8 * mosaic.itemsize}",
        height=8,
        width=8,
        step=0,  # as some drivers leave it
        is_bigendian=0,
        data=mosaic.tobytes(),
    )
    np.testing.assert_array_equal(picture_of(message)[2:-2, 2:-2], np.tile(colour, (4, 4, 1)))
    _, png = cv2.imencode(".png", mosaic)
    message = SimpleNamespace(format=f"bayer_{pattern}8; png compressed", data=png.tobytes())
    np.testing.assert_array_equal(picture_of(message)[2:-2, 2:-2], np.tile(colour, (4, 4, 1)))


@pytest.mark.parametrize(("encoding", "order"), [("yuv422", "uyvy"), ("yuv422_yuy2", "yuyv")])
def test_yuv(encoding, order):
    values = {"y": 81, "u": 90, "v": 240}  # red
    data = bytes(values[letter] for letter in order) * 8
    message = SimpleNamespace(
        encoding=encoding, height=4, width=4, step=8, is_bigendian=0, data=data
    )
    picture = picture_of(message)
    assert picture.shape == (4, 4, 3)
    np.testing.assert_allclose(picture[0, 0], (255, 0, 0), atol=3)


@pytest.mark.parametrize("data", [b"", b"no image"])
def test_what_is_no_image_is_told(data):
    with pytest.raises(InputError, match=r"a compressed image \(jpeg\): not an image"):
        picture_of(SimpleNamespace(format="jpeg", data=data))
    message = SimpleNamespace(encoding="32FC1", height=1, width=1, step=4, data=data)
    with pytest.raises(InputError, match="encoding '32FC1' cannot be read, only mono8"):
        picture_of(message)


@pytest.mark.parametrize(
    ("message", "told"),
    [
        ({"encoding": "nv12"}, "'nv12' cannot be read: the node image_format_converter of isaac"),
        ({"encoding": "NV21"}, "'NV21' cannot be read: the node image_format_converter"),
        ({"format": "h264"}, "'h264' are packets of a video"),
        ({"format": "bgr8; H.265 compressed"}, "packets of a video"),
    ],
)
def test_videos_and_planes_are_refused_by_name(message, told):
    for call in (picture_of, check_encoding):
        with pytest.raises(InputError, match=told):
            call(SimpleNamespace(**message, data=b"", height=2, width=2, step=0, is_bigendian=0))


def test_a_topic_of_packets_is_refused_before_the_first_frame(rosbags, tmp_path):
    path = tmp_path / "run.mcap"
    with BagWriter(path) as bag:
        for topic in ("/left", "/right"):
            header = bag.header(START_NS, "camera")
            data = np.zeros(8, np.uint8)
            kind = "sensor_msgs/msg/CompressedImage"
            bag.write(topic, START_NS, kind, header=header, format="h264", data=data)
    with pytest.raises(InputError, match=r"run.mcap: /left: .*'h264' are packets of a video"):
        open_stream(str(path), left_topic="/left", right_topic="/right")
    kinds = dict.fromkeys(("/a", "/b"), ("ffmpeg_image_transport_msgs/msg/FFMPEGPacket", 5))
    with pytest.raises(InputError, match=r"/a holds packets of a video: the node republish"):
        stereo_bag._image_topics(path, kinds, "/a", "/b")


def image_message(encoding, height, width, data=bytes(64)):
    return SimpleNamespace(
        encoding=encoding, height=height, width=width, step=0, is_bigendian=0, data=data
    )


@pytest.mark.parametrize("encoding", ["yuv422", "yuyv"])
def test_an_odd_width_of_yuv(encoding):
    with pytest.raises(InputError, match=f"3x2 pixels, uint8, cannot be one of {encoding}"):
        picture_of(image_message(encoding, 2, 3))


@pytest.mark.parametrize(("height", "width"), [(0, 4), (4, 0), (0, 0)])
def test_images_without_pixels(height, width):
    with pytest.raises(InputError, match=f"a damaged image: 64 bytes for {width}x{height} pixels"):
        picture_of(image_message("mono8", height, width))


def test_compressed_images_of_an_unknown_encoding():
    _, png = cv2.imencode(".png", GREY)
    message = SimpleNamespace(format="bayer_rggb12; png compressed", data=png.tobytes())
    with pytest.raises(InputError, match="encoding 'bayer_rggb12' cannot be read, only mono8"):
        picture_of(message)


@pytest.mark.parametrize("ending", ["jpg", "png"])
def test_compressed_images_that_are_cut_off(ending):
    picture = np.random.default_rng(1).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    _, data = cv2.imencode(f".{ending}", picture)
    whole = SimpleNamespace(format=f"rgb8; {ending} compressed bgr8", data=data)
    assert picture_of(whole).shape == picture.shape
    whole.data = data[: len(data) // 2]
    with pytest.raises(InputError, match=r"compressed image \(rgb8; .*not an image that is whole"):
        picture_of(whole)


def camera(p, *, size=(160, 48), binning=(0, 0), window=(0, 0, 0, 0)):
    roi = SimpleNamespace(x_offset=window[0], y_offset=window[1], width=window[2], height=window[3])
    binning_x, binning_y = binning
    p = np.asarray(p, float)
    return SimpleNamespace(
        p=p.ravel(),
        k=p.reshape(3, 4)[:, :3].ravel(),
        d=np.zeros(5),
        r=np.eye(3).ravel(),
        distortion_model="plumb_bob",
        width=size[0],
        height=size[1],
        binning_x=binning_x,
        binning_y=binning_y,
        roi=roi,
    )


def test_camera_info_of_either_camera_has_the_baseline():
    right = calibration_of(camera(projection()), camera(projection(0.2)))
    left = calibration_of(camera(projection(-0.2)), camera(projection()))  # OAK
    assert right == left
    assert (right.focal, right.baseline, right.doffs, right.size) == (100, 0.2, 0, (160, 48))
    assert (right.cx, right.cy) == (80, 24)
    with pytest.raises(InputError, match="are the cameras swapped"):
        calibration_of(camera(projection(0.2)), camera(projection()))
    assert calibration_of(camera(np.zeros(12)), camera(projection())) is None


def test_binning_and_region_of_interest():
    half = {"binning": (2, 2), "window": (20, 4, 100, 40)}
    found = calibration_of(camera(projection(), **half), camera(projection(0.2), **half))
    assert (found.focal, found.baseline, found.doffs, found.size) == (50, 0.2, 0, (50, 20))
    assert (found.cx, found.cy) == (30, 10)
    # Two windows that do not begin in one column move the principal points apart.
    moved = camera(projection(0.2), window=(28, 4, 100, 40))
    found = calibration_of(camera(projection(), window=(20, 4, 100, 40)), moved)
    assert (found.doffs, found.size) == (-8, (100, 40))


def test_the_command_line_knows_the_names_of_the_library():
    assert early.BAG_ENDINGS == bag_writer.BAG_ENDINGS
    assert TopicOptions().tolerance == stereo_bag.TOLERANCE_S
