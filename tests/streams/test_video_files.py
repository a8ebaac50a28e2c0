"""Video files through PyAV."""

import re
import warnings
from fractions import Fraction

import numpy as np
import pytest
from noise_pairs import make_pair

from extras import need_extra
from mobilestereonet.errors import InputError
from mobilestereonet.streams import open_stream
from mobilestereonet.streams.video_files import VideoFile, open_videos, write_video

av = need_extra("av")


def joined(count):
    return [np.concatenate(make_pair(10 + index, index), axis=1) for index in range(count)]


def write(path, pictures, fps=10):
    write_video(path, ((index / fps, picture) for index, picture in enumerate(pictures)))
    return path


def damage(path, packets, share=1.0):
    """Overwrite the last part of some packets with noise; the container stays whole."""
    with av.open(str(path)) as container:
        places = {
            packet.pts: (packet.pos, packet.size)
            for packet in container.demux(video=0)
            if packet.size
        }
    content = bytearray(path.read_bytes())
    for shown in packets:
        position, size = places[sorted(places)[shown]]
        part = int(size * share)
        noise = np.random.default_rng(shown).integers(0, 256, part, dtype=np.uint8)
        content[position + size - part : position + size] = noise.tobytes()
    path.write_bytes(content)


@pytest.mark.parametrize("ending", ["mp4", "mkv"])
def test_what_is_written_is_read_back(tmp_path, ending):
    pictures = [np.full((48, 320, 3), (200, 20 * index, 40), np.uint8) for index in range(9)]
    path = write(tmp_path / f"v.{ending}", pictures)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    video = VideoFile(path)
    assert (video.size, len(video.stamps)) == ((320, 48), 9)
    moments = list(video)
    assert [seconds for seconds, _ in moments] == pytest.approx(np.arange(9) / 10, abs=1e-3)
    for (_, picture), original in zip(moments, pictures, strict=True):
        assert np.abs(picture.astype(int) - original).max() < 8


def test_an_odd_size_gets_a_border(tmp_path):
    path = write(tmp_path / "v.mp4", [np.full((47, 159, 3), 90, np.uint8)] * 2)
    _, picture = next(iter(VideoFile(path)))
    assert picture.shape == (48, 160, 3)
    assert abs(picture.astype(int) - 90).max() < 4


# The encoder shows frames in another order than it stores them, so a damaged packet does not come
# out as an error in its place.
@pytest.mark.parametrize(("packets", "share"), [([5], 1.0), ([7, 8], 1.0), ([0], 0.5), ([11], 1.0)])
def test_damaged_frames_are_told_in_their_place(tmp_path, packets, share):
    path = write(tmp_path / "v.mp4", joined(12))
    damage(path, packets, share)
    frames = list(open_stream(str(path)).frames)
    assert [frame.index for frame in frames] == list(range(12))
    broken = [frame.index for frame in frames if frame.pair is None]
    assert broken == packets
    assert all("damaged" in frames[index].problem for index in broken)


def test_two_files_stay_in_step_over_a_damaged_frame(tmp_path):
    left, right = zip(*(make_pair(10, seed) for seed in range(8)), strict=True)
    first, second = write(tmp_path / "l.mp4", left), write(tmp_path / "r.mp4", right)
    damage(second, [3])
    frames = list(open_videos([first, second]).frames)
    assert [frame.index for frame in frames if frame.pair is None] == [3]
    last = frames[7].pair.right.permute(1, 2, 0).numpy() * 255
    errors = [np.abs(last - picture).mean() for picture in right]
    assert int(np.argmin(errors)) == 7


def test_views_that_do_not_belong_together(tmp_path):
    eight = write(tmp_path / "8.mp4", joined(8))
    small = write(tmp_path / "small.mp4", [picture[:, :64] for picture in joined(8)])
    with pytest.raises(InputError, match=r"one size: .*8.mp4 has 320x48, .*small.mp4 has 64x48"):
        open_videos([eight, small])


def write_at(path, pictures, stamps, degrees=0):
    """Write pictures shown at some times, in ms, with a note that players turn them."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"crf": "18", "bf": "0"})
        stream.height, stream.width, stream.pix_fmt = *pictures[0].shape[:2], "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        if degrees:
            stream.set_display_rotation(degrees)
        for picture, stamp in zip(pictures, stamps, strict=True):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            frame.pts, frame.time_base = stamp, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_pictures_are_turned_as_players_turn_them(tmp_path, degrees, write_capture):
    shown = np.zeros((64, 128, 3), np.uint8)
    shown[:32, :64], shown[32:, 64:] = (200, 20, 20), (20, 20, 200)
    stored = np.rot90(shown, -degrees // 90)
    path = write_at(tmp_path / "v.mp4", [stored] * 2, [0, 40], degrees)
    video = VideoFile(path)
    assert video.size == (128, 64)
    for address in (str(path), f"file://{path}"):  # a file, and OpenCV's capture of it
        for frame in open_stream(address).frames:
            both = np.hstack([frame.pair.left_image, frame.pair.right_image])
            assert np.abs(both.astype(int) - shown)[8:24, 8:56].max() < 30
            assert np.abs(both.astype(int) - shown)[40:56, 72:120].max() < 30


def moving(stamps, disparity):
    """Views of a scene that moves down by 1 row per ms, at some times."""
    left, right = make_pair(disparity)
    return [[np.roll(view, stamp, axis=0) for stamp in stamps] for view in (left, right)]


@pytest.mark.parametrize(
    ("first", "second", "expected", "lost"),
    [
        ([0, 33, 67, 100], [0, 67, 133, 200], [0, 67], "2 of 4 .* 2 of 4"),  # two rates
        ([0, 40, 80, 120], [0, 80, 120], [0, 80, 120], "1 of 4 .* 0 of 3"),  # one lost
        ([40, 80, 120], [0, 40, 80, 120], [40, 80, 120], "0 of 3 .* 1 of 4"),  # the first one lost
        ([0, 30, 100, 130], [2, 31, 97, 131], [0, 30, 100, 130], None),  # variable
    ],
)
def test_two_files_are_paired_by_time(tmp_path, first, second, expected, lost):
    paths = [
        write_at(tmp_path / f"{side}.mkv", moving(stamps, 10)[side], stamps)
        for side, stamps in enumerate((first, second))
    ]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        stream = open_videos(paths)
    told = [str(warning.message) for warning in caught]
    assert len(told) == (lost is not None)
    assert lost is None or re.search(lost, told[0])
    frames = list(stream.frames)
    assert stream.total == len(frames) == len(expected)
    for frame, stamp in zip(frames, expected, strict=True):
        views = [wanted[0] for wanted in moving([stamp], 10)]
        errors = [
            np.abs(found.astype(int) - view).mean()
            for found, view in zip(
                (frame.pair.left_image, frame.pair.right_image), views, strict=True
            )
        ]
        assert max(errors) < 35, errors  # 50 and more if it is of another time


def test_recordings_of_two_rates_that_opencv_opens(tmp_path):
    paths = [
        write_at(tmp_path / f"{side}.mp4", moving(stamps, 10)[side], stamps)
        for side, stamps in enumerate(([0, 33, 67, 100], [0, 67, 133, 200]))
    ]
    with pytest.warns(UserWarning, match=r"2 frames of .*0.mp4 and 0 of .*1.mp4 have no partner"):
        frames = list(open_stream(*(f"file://{path}" for path in paths)).frames)
    assert [frame.seconds for frame in frames] == pytest.approx([0, 0.067], abs=0.002)


def test_videos_without_a_common_moment(tmp_path):
    times = [0, 100, 200], [50, 150, 250]
    pictures = make_pair(10)
    left, right = (
        write_at(tmp_path / f"{n}.mkv", [pictures[n]] * 3, [t + 400 * n for t in times[n]])
        for n in (0, 1)
    )
    with pytest.raises(InputError, match=r"no two frames were taken within 0.050 s"):
        open_videos([left, right])


def test_what_is_no_video_is_an_error(tmp_path):
    whole = write(tmp_path / "v.mp4", joined(4)).read_bytes()
    for name, content in (("cut.mp4", whole[:-300]), ("text.mp4", b"no video"), ("no.mp4", b"")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=f"{name}: not a video that can be read"):
            open_stream(str(tmp_path / name))
    with pytest.raises(FileNotFoundError, match=r"absent.mp4"):
        open_stream(str(tmp_path / "absent.mp4"))
    with av.open(str(tmp_path / "odd.mkv"), "w") as container:
        stream = container.add_stream("mjpeg", rate=10)
        stream.width, stream.height, stream.pix_fmt = 161, 48, "yuvj444p"
        picture = np.zeros((48, 161, 3), np.uint8)
        container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    with pytest.raises(InputError, match=r"odd.mkv is 161 px wide, .*--layout top-bottom says"):
        open_stream(str(tmp_path / "odd.mkv"))


def test_one_view_above_the_other_in_a_video_of_an_odd_width(tmp_path):
    views = [view[:, :159] for view in make_pair(9)]

    def write_odd(name, picture):
        with av.open(str(tmp_path / name), "w") as container:
            stream = container.add_stream("mjpeg", rate=10)
            stream.height, stream.width = picture.shape[:2]
            stream.pix_fmt = "yuvj444p"
            for _ in range(2):
                container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            container.mux(stream.encode())
        return str(tmp_path / name)

    path = write_odd("odd.mkv", np.vstack(views))
    for source in (path, f"file://{path}"):
        frames = list(open_stream(source, layout="top-bottom").frames)
        assert [frame.pair.left_image.shape for frame in frames] == [(48, 159, 3)] * 2
        assert np.abs(frames[0].pair.right_image.astype(int) - views[1]).mean() < 30
    path = write_odd("high.mkv", np.vstack(views)[1:, :158])
    with pytest.raises(InputError, match=r"high.mkv is 95 px high, .*--layout side-by-side says"):
        open_stream(path, layout="top-bottom")


def test_a_file_that_ends_early_says_so(tmp_path):
    path = tmp_path / "v.mp4"
    with av.open(str(path), "w", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=5)
        stream.width, stream.height, stream.pix_fmt = 320, 48, "yuv420p"
        for picture in joined(30):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.warns(UserWarning, match=r"frames end at .* of 6.0 s"):
        video = VideoFile(path)
    moments = list(video)
    assert 5 < len(moments) < 25
    assert len(moments) == len(video.stamps)


def test_nothing_is_left_of_a_video_that_fails(tmp_path):
    def failing():
        yield 0.0, joined(1)[0]
        raise OSError("the camera is gone")

    with pytest.raises(OSError, match="gone"):
        write_video(tmp_path / "v.mp4", failing())
    with pytest.raises(InputError, match="no frame"):
        write_video(tmp_path / "v.mp4", [])
    with pytest.raises(InputError, match=r"v.gif: videos are written as .mp4"):
        write_video(tmp_path / "v.gif", [])
    assert list(tmp_path.iterdir()) == []
