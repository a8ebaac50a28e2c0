"""Video files through PyAV."""

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
    eight, seven = write(tmp_path / "8.mp4", joined(8)), write(tmp_path / "7.mp4", joined(7))
    small = write(tmp_path / "small.mp4", [picture[:, :64] for picture in joined(8)])
    with pytest.raises(InputError, match=r"number of frames: .*8.mp4 has 8, .*7.mp4 has 7"):
        open_videos([eight, seven])
    with pytest.raises(InputError, match=r"one size: .*8.mp4 has 320x48, .*small.mp4 has 64x48"):
        open_videos([eight, small])


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
    with pytest.raises(InputError, match=r"odd.mkv is 161 px wide"):
        open_stream(str(tmp_path / "odd.mkv"))


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
