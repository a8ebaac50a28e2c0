import cv2
import numpy as np
import pytest
import torch
from fake_engines import FakeEngine

from mobilestereonet import InputError, StereoMatcher, create_model, save_weights, versions
from mobilestereonet.inference import DEFAULT_MODEL, load_pair
from mobilestereonet.nets.model import IMAGENET, RGB, Prediction

SMALL = {"max_disparity": 32}
MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class Recorder(FakeEngine):
    """An engine that notes what it is given and tells each pixel's place in it."""

    size_multiple = 16
    preprocessing = IMAGENET

    def __call__(self, left, right, confidence=False):
        self.left, self.right = left, right
        rows = torch.arange(left.shape[-2], dtype=torch.float32)[:, None]
        place = 1000 * rows + torch.arange(left.shape[-1], dtype=torch.float32)
        return Prediction(place.expand(len(left), *place.shape))


@pytest.fixture(scope="module")
def net():
    torch.manual_seed(0)
    return create_model("msnet2d", **SMALL)


@pytest.fixture(scope="module")
def matcher(net):
    return StereoMatcher(net)


def random_pair(height, width, seed=0):
    pair = np.random.default_rng(seed).integers(0, 256, (2, height, width, 3), dtype=np.uint8)
    return tuple(pair)


def test_engine_gets_normalised_views_padded_with_their_border_above_and_on_the_right():
    recorder = Recorder()
    left = np.full((30, 50, 3), (255, 0, 51), np.uint8)
    left[0, :, 1] = left[:, -1, 1] = 128
    result = StereoMatcher(recorder)(left, np.zeros_like(left))
    assert recorder.left.shape == recorder.right.shape == (1, 3, 32, 64)
    for channel, value in enumerate((1.0, 0.0, 0.2)):
        expected = (value - MEAN[channel]) / STD[channel]
        torch.testing.assert_close(
            recorder.left[0, channel, 3:, :49], torch.full((29, 49), expected), rtol=0, atol=1e-6
        )
    border = recorder.left[0, 1, 0, 0]
    assert border > expected
    assert (recorder.left[0, 1, :3] == border).all()
    assert (recorder.left[0, 1, :, 49:] == border).all()
    # The first pixel of the result was the first of the third row.
    assert result.disparity.shape == (30, 50)
    assert result.disparity[0, 0] == 2000
    assert result.disparity[-1, -1] == 31_049


def test_engine_may_take_raw_views_of_any_size():
    recorder = Recorder()
    recorder.preprocessing, recorder.size_multiple = RGB, 1
    left, right = random_pair(30, 50)
    StereoMatcher(recorder)(left, right)
    assert recorder.right.equal(torch.from_numpy(right).permute(2, 0, 1)[None] / 255)


def test_small_views_are_padded_to_the_smallest_side():
    recorder = Recorder()
    recorder.min_side = 56
    result = StereoMatcher(recorder)(*random_pair(30, 80))
    assert recorder.left.shape[-2:] == (64, 80)
    assert result.disparity.shape == (30, 80)
    assert result.disparity[0, 0] == 34_000


def test_padding_to_a_given_size():
    recorder = Recorder()
    matcher = StereoMatcher(recorder, padding=(64, 96))
    assert matcher(*random_pair(30, 50)).disparity[0, 0] == 34_000
    assert recorder.left.shape[-2:] == (64, 96)
    # Zeros then, as the authors pad.
    assert not recorder.left[..., :34, :].any()
    assert not recorder.left[..., 50:].any()
    with pytest.raises(InputError, match=r"65 x 50 .* larger than the padding to 64 x 96"):
        matcher(*random_pair(65, 50))


def test_result_is_the_networks(net, matcher):
    left, right = (torch.rand(1, 3, 32, 64) for _ in range(2))
    mean, std = (torch.tensor(v)[:, None, None] for v in (MEAN, STD))
    net.eval()
    with torch.no_grad():
        expected = net((left - mean) / std, (right - mean) / std).disparity
    torch.testing.assert_close(matcher.disparity(left, right), expected, rtol=0, atol=1e-3)
    result = matcher(left, right)
    np.testing.assert_allclose(result.disparity, expected[0].numpy(), rtol=0, atol=1e-3)
    assert result.valid.all()
    info = result.info
    assert (info.model, info.engine, info.precision, info.device) == (
        "msnet2d",
        "torch",
        "fp32",
        "cpu",
    )
    assert (info.width, info.height, info.refined) == (64, 32, False)
    assert info.seconds > 0


@pytest.mark.parametrize("size", [(2, 2), (2, 40), (40, 2), (17, 31), (33, 16)])
@pytest.mark.parametrize("name", ["msnet2d", "msnet3d"])
def test_any_size(name, size):
    result = StereoMatcher(create_model(name, **SMALL))(*random_pair(*size))
    assert result.disparity.shape == result.valid.shape == result.left.shape[:2] == size
    assert result.disparity.dtype == np.float32
    assert result.valid.dtype == bool
    assert 0 <= result.disparity.min() <= result.disparity.max() <= 31


def test_every_form_of_a_view_gives_the_same(matcher, tmp_path):
    left, right = random_pair(20, 40)
    expected = matcher(left, right).disparity

    def as_file(image, name):
        cv2.imwrite(str(tmp_path / name), image[..., ::-1])
        return tmp_path / name

    def with_alpha(image):
        return np.dstack((image, np.full(image.shape[:2], 7, np.uint8)))

    def as_tensor(image):
        return torch.from_numpy(image).permute(2, 0, 1) / 255

    forms = [
        (as_file(left, "l.png"), str(as_file(right, "r.png"))),
        (with_alpha(left), with_alpha(right)),
        (left.astype(np.uint16) * 257, right.astype(np.uint16) * 257),
        (left.astype(np.float32) / 255, right.astype(np.float64) / 255),
        (as_tensor(left), as_tensor(right)[None]),
        (left[::-1].copy()[::-1], right),  # negative strides
    ]
    for form in forms:
        np.testing.assert_allclose(matcher(*form).disparity, expected, rtol=0, atol=1e-3)


def test_grey_is_three_equal_channels(matcher):
    left, right = (view[..., :1] for view in random_pair(20, 40))
    expected = matcher(left.repeat(3, axis=2), right.repeat(3, axis=2))
    for form in ((left, right), (left[..., 0], right[..., 0])):
        result = matcher(*form)
        np.testing.assert_array_equal(result.disparity, expected.disparity)
        np.testing.assert_array_equal(result.left, left.repeat(3, axis=2))


def test_batch(matcher):
    pairs = [random_pair(20, 40, seed) for seed in range(3)]
    results = matcher.batch(pairs)
    assert len(results) == 3
    for (left, right), result in zip(pairs, results, strict=True):
        np.testing.assert_array_equal(result.left, left)
        np.testing.assert_allclose(
            result.disparity, matcher(left, right).disparity, rtol=0, atol=1e-3
        )
    lefts, rights = (
        torch.from_numpy(np.stack(views)).permute(0, 3, 1, 2) / 255
        for views in zip(*pairs, strict=True)
    )
    for others in (
        matcher.batch(zip(lefts, rights, strict=True)),
        matcher.batch(load_pair(*pair) for pair in pairs),
    ):
        for result, other in zip(results, others, strict=True):
            np.testing.assert_allclose(result.disparity, other.disparity, rtol=0, atol=1e-3)
    assert matcher.batch([]) == []
    with pytest.raises(InputError, match="one size, got 40x20, 41x20"):
        matcher.batch([random_pair(20, 40), random_pair(20, 41)])


def test_a_batch_of_one_pair_is_a_list_of_one_result(matcher):
    lefts, rights = torch.rand(2, 1, 3, 20, 40)
    (result,) = matcher.batch(zip(lefts, rights, strict=True))
    single = matcher(lefts, rights)  # one pair with a batch dimension
    np.testing.assert_allclose(single.disparity, result.disparity, rtol=0, atol=1e-3)
    with pytest.raises(InputError, match=r"left view: .*got \(2, 3, 20, 40\).*batch"):
        matcher(torch.rand(2, 3, 20, 40), torch.rand(2, 3, 20, 40))


@pytest.mark.parametrize(
    "pairs",
    [
        torch.rand(2, 2, 3, 20, 40),
        (torch.rand(2, 3, 20, 40), torch.rand(2, 3, 20, 40)),
        ["left.png", "right.png"],
        [("left.png", "right.png", "third.png")],
        np.zeros((2, 20, 40, 3), np.uint8),
    ],
    ids=["tensor", "two tensors", "paths", "three", "array"],
)
def test_what_is_no_list_of_pairs_is_refused(matcher, pairs):
    with pytest.raises(InputError, match=r"list of pairs \(left, right\), got .*zip"):
        matcher.batch(pairs)


@pytest.mark.parametrize(
    ("view", "message"),
    [
        (np.zeros((0, 0, 3), np.uint8), r"left view: .*\(0, 0, 3\)"),
        (np.zeros((20, 0), np.uint8), r"\(20, 0, 1\)"),
        (np.zeros((1, 40, 3), np.uint8), "at least 2x2 pixels, got 40x1"),
        (np.zeros((20, 1), np.uint8), "at least 2x2 pixels, got 1x20"),
        (np.zeros((3, 20, 40), np.uint8), r"\(3, 20, 40\)"),
        (np.zeros((20, 40, 3), np.int64), "int64"),
        (np.zeros((20, 40, 3), bool), "bool"),
        (np.full((20, 40, 3), 255.0), "0..1, got 255"),
        (np.full((20, 40), -0.1), "0..1, got -0.1"),
        (np.full((20, 40), np.nan), "nan"),
        (np.full((20, 40), np.inf), "inf"),
        (torch.full((3, 20, 40), torch.nan), "nan"),
        (torch.full((3, 20, 40), 2.0), "0..1, got 2"),
        (torch.zeros(20, 40), r"\(3, H, W\), got \(20, 40\)"),
        (torch.zeros(3, 0, 40), r"\(3, 0, 40\)"),
        ("absent.png", "absent.png"),
    ],
)
def test_bad_views_are_named(matcher, view, message):
    error = FileNotFoundError if isinstance(view, str) else InputError
    with pytest.raises(error, match=message):
        matcher(view, view)


def test_one_bad_value_is_enough():
    left, right = np.zeros((2, 20, 40), np.float32)
    right[7, 9] = np.nan
    with pytest.raises(InputError, match="right view"):
        load_pair(left, right)


def test_two_sizes_are_both_named(matcher):
    with pytest.raises(InputError, match="left view has 40x20, right view has 48x24"):
        matcher(random_pair(20, 40)[0], random_pair(24, 48)[1])
    with pytest.raises(InputError, match=r"\(1, 3, 20, 40\) and \(1, 3, 20, 48\)"):
        matcher.disparity(torch.rand(1, 3, 20, 40), torch.rand(1, 3, 20, 48))


def test_from_pretrained(net, tmp_path, monkeypatch):
    monkeypatch.setattr(versions, "FOLDER", tmp_path)
    path = tmp_path / "msnet2d.test-1.safetensors"
    save_weights(net, path, card={})
    pair = random_pair(20, 40)
    expected = StereoMatcher(net)(*pair)
    for matcher in (
        StereoMatcher.from_pretrained("msnet2d"),
        StereoMatcher.from_pretrained(path),
        StereoMatcher.from_pretrained(str(path), model="msnet2d", threads=1),
    ):
        result = matcher(*pair)
        np.testing.assert_allclose(result.disparity, expected.disparity, rtol=0, atol=1e-3)
        assert result.info.model == "msnet2d"
    with pytest.raises(InputError, match="holds msnet2d, not msnet3d"):
        StereoMatcher.from_pretrained(path, model="msnet3d")
    with pytest.raises(InputError, match="no weights of 'baseline3d'"):
        StereoMatcher.from_pretrained("baseline3d")
    with pytest.raises(InputError, match="unknown model 'raft'"):
        StereoMatcher.from_pretrained("raft")
    with pytest.raises(InputError, match=r"unknown .* 'abacus'"):
        StereoMatcher.from_pretrained("msnet2d", engine="abacus")


def test_mistakes_are_told_with_the_way_out(net, tmp_path):
    with pytest.raises(InputError, match=r"StereoMatcher\.from_pretrained\('msnet2d'\)"):
        StereoMatcher("msnet2d")
    save_weights(net, tmp_path / "net.safetensors")
    for source in (tmp_path / "net.safetensors", "sgbm"):
        with pytest.raises(InputError, match="no option 'confidnce': did you mean confidence"):
            StereoMatcher.from_pretrained(source, confidnce=True)
    with pytest.raises(InputError, match=r"no value 'estimatr' \(did you mean estimator"):
        StereoMatcher.from_pretrained(tmp_path / "net.safetensors", estimatr="mode")


def test_threads_are_the_refinements_too(net, monkeypatch):
    seen = []

    def refine(disparity, *_):
        seen.append(torch.get_num_threads())
        return disparity

    monkeypatch.setattr("mobilestereonet.inference.predict.refine_disparity", refine)
    before = torch.get_num_threads()
    for threads in (before + 1, None):
        StereoMatcher(net, threads=threads, refine=True)(*random_pair(16, 32))
    assert seen == [before + 1, before]


def test_semi_global_matching_is_a_model_like_any_other():
    # The right view is the left one, moved by 6 px: left (x) matches right (x - 6).
    rng = np.random.default_rng(0)
    wide = cv2.GaussianBlur(rng.integers(0, 256, (64, 166, 3), dtype=np.uint8), (3, 3), 0)
    result = StereoMatcher.from_pretrained("sgbm", max_disparity=32)(wide[:, :160], wide[:, 6:])
    assert result.info.model == result.info.engine == "sgbm"
    assert np.median(result.disparity) == pytest.approx(6, abs=0.1)
    with pytest.raises(InputError, match="sgbm runs by itself: leave precision out"):
        StereoMatcher.from_pretrained("sgbm", precision="bf16")


@pytest.fixture(scope="module")
def mode_net():
    torch.manual_seed(0)
    return create_model("msnet2d", **SMALL, estimator="mode").eval()


def test_both_constructors_give_the_same(mode_net, net, tmp_path):
    for number, model in enumerate((mode_net, net)):
        path = tmp_path / f"{number}.safetensors"
        save_weights(model, path, dtype=torch.float32)
        first, second = StereoMatcher(model), StereoMatcher.from_pretrained(path)
        assert first.refine == second.refine == (model is mode_net)
        assert repr(first) == repr(second) == "StereoMatcher(msnet2d, torch, fp32, cpu)"
        pair = random_pair(40, 60)
        np.testing.assert_array_equal(first(*pair).disparity, second(*pair).disparity)


def test_defaults_are_the_same_on_every_machine(mode_net, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": True})
    matcher = StereoMatcher(mode_net)
    assert (matcher.engine.name, matcher.engine.precision) == ("torch", "fp32")
    assert matcher.device == torch.device("cpu")
    assert DEFAULT_MODEL == "msnet3d-cascade"


def test_infer_takes_and_gives_batches_of_tensors(mode_net):
    matcher = StereoMatcher(mode_net)
    pairs = [random_pair(20, 40, seed) for seed in range(2)]
    lefts, rights = (
        torch.from_numpy(np.stack(views)).permute(0, 3, 1, 2) / 255
        for views in zip(*pairs, strict=True)
    )
    both = matcher.infer(lefts, rights)
    assert both.disparity.shape == both.confidence.shape == (2, 20, 40)
    assert both.disparity.dtype == both.confidence.dtype == torch.float32
    assert 0 <= both.confidence.min() < both.confidence.max() <= 1
    for index, pair in enumerate(pairs):
        one = matcher.infer(lefts[index : index + 1], rights[index : index + 1])
        torch.testing.assert_close(one.disparity[0], both.disparity[index], rtol=0, atol=1e-3)
        result = matcher(*pair)
        np.testing.assert_allclose(result.disparity, one.disparity[0], rtol=0, atol=1e-3)
    torch.testing.assert_close(matcher.disparity(lefts, rights), both.disparity)
    # What comes out can be trained on.
    weight = torch.ones(1, requires_grad=True)
    (weight * both.disparity).sum().backward()
    assert weight.grad == both.disparity.sum()
    assert StereoMatcher(Recorder()).infer(lefts, rights).confidence is None
    with pytest.raises(InputError, match=r"\(B, 3, H, W\), got \(3, 20, 40\)"):
        matcher.infer(lefts[0], rights[0])


def test_the_matcher_goes_to_a_device(net):
    matcher = StereoMatcher(net)
    engine = matcher.engine
    assert matcher.to(torch.device("cpu")) is matcher
    assert matcher.engine is not engine
    assert matcher.device == torch.device("cpu")
    for device in ("warp", "cuda:99", "mps"):
        with pytest.raises(InputError, match=f"device '{device}'"):
            matcher.to(device)
    assert matcher.device == torch.device("cpu")
    with pytest.raises(InputError, match="fake was given as an engine on cpu"):
        StereoMatcher(Recorder()).to("cpu")
    with pytest.raises(InputError, match=r"fake is an engine already: .*precision"):
        StereoMatcher(Recorder(), precision="bf16")


def test_a_device_gives_what_the_cpu_gives(mode_net, device):
    matcher = StereoMatcher(mode_net, confidence=True, left_right=True)
    pair = random_pair(40, 60)
    expected = matcher(*pair)
    result = matcher.to(device)(*pair)
    assert result.info.device.startswith(device)
    assert np.median(np.abs(result.disparity - expected.disparity)) < 0.05
    assert np.median(np.abs(result.confidence - expected.confidence)) < 0.01
    views = [torch.from_numpy(view).permute(2, 0, 1)[None].to(device) / 255 for view in pair]
    found = matcher.infer(*views)
    assert found.disparity.device == found.confidence.device == views[0].device
    np.testing.assert_allclose(found.disparity[0].cpu(), result.disparity, rtol=0, atol=1e-3)


def test_findings_come_with_the_result(matcher):
    left, right = random_pair(40, 60)
    good = matcher(left, right).findings
    assert [(found.check, found.level) for found in good] == [
        ("content", "good"),
        ("exposure", "good"),
        ("geometry", "unknown"),
    ]
    assert matcher(left, right // 3).findings[1].level == "warning"


def test_what_leaves_no_sensible_result_is_told(matcher):
    """By a warning in the caller's own line, and where the result is shown."""
    left, _ = random_pair(40, 60)
    with pytest.warns(UserWarning, match="content: .*same picture") as told:
        result = matcher(left, left)
    assert told[0].filename == __file__
    assert "same picture" in result.findings[0].text
    assert "problem: " in repr(result) and "same picture" in repr(result)
    with pytest.warns(UserWarning, match="same picture"):
        matcher.batch([(left, left)])


class OnDevice(FakeEngine):
    """An engine whose device holds no numbers: what mixes devices fails."""

    device = torch.device("meta")
    has_confidence = True
    size_multiple = 16

    def __call__(self, left, right, confidence=False):
        assert left.device == right.device == self.device
        disparity = left.mean(1)
        return Prediction(disparity, right.mean(1) if confidence else None)


@pytest.mark.parametrize("tile", [None, (576, 416)])
def test_everything_up_to_the_end_happens_on_the_engines_device(tile):
    matcher = StereoMatcher(OnDevice(), confidence=True, tile=tile)
    views = (view.to("meta") for view in torch.rand(2, 2, 3, 600, 500))
    found = matcher.infer(*views)
    assert found.disparity.shape == found.confidence.shape == (2, 600, 500)
    assert found.disparity.device.type == found.confidence.device.type == "meta"


def test_values_that_cannot_be_are_refused():
    with pytest.raises(InputError, match=r"padding must be \(height, width\), got 64"):
        StereoMatcher.from_pretrained("msnet2d", padding=64)
    with pytest.raises(InputError, match="sgbm has no option 'foo'"):
        StereoMatcher.from_pretrained("sgbm", foo=3)
    with pytest.raises(InputError, match="has no value 'tile'"):
        StereoMatcher.from_pretrained("msnet2d", config={"tile": 5})
    matcher = StereoMatcher.from_pretrained("sgbm")
    with pytest.raises(InputError, match=r"floating point in 0\.\.1, got torch\.uint8"):
        matcher.infer(*torch.zeros(2, 1, 3, 32, 64, dtype=torch.uint8))
