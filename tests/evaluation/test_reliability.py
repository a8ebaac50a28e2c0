"""Confidence as a probability: its fit, the reliability diagram, and the way to a result."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

from mobilestereonet import (
    InputError,
    StereoMatcher,
    StereoSample,
    create_model,
    load_model,
    save_weights,
)
from mobilestereonet.cli.fit_confidence import SEED
from mobilestereonet.evaluation import (
    confidences,
    fit_confidence,
    reliability,
)
from mobilestereonet.nets import ConfidenceFit
from mobilestereonet.weights import average_weights, save_pretrained

FIT = ConfidenceFit(rise=1.4, fall=0.6, offset=-0.3)


@pytest.fixture
def net():
    torch.manual_seed(0)
    return create_model("msnet2d", max_disparity=32, estimator="mode", width=8, hourglasses=1)


@pytest.fixture
def views():
    return torch.rand(2, 1, 3, 48, 96, generator=torch.Generator().manual_seed(1))


def drawn(fit, count=200_000):
    """Confidences, and errors that come true as often as a fit says."""
    rng = np.random.default_rng(0)
    raw = rng.beta(2, 1, count).astype(np.float32)
    return raw, rng.random(count) < fit(torch.from_numpy(raw)).numpy()


def drawn_sample():
    """A pair of noise with made-up ground truth, some of it beyond what the network finds."""
    rng = torch.Generator().manual_seed(2)
    left, right = torch.rand(2, 3, 32, 64, generator=rng)
    disparity = 40 * torch.rand(32, 64, generator=rng)
    return StereoSample(left, right, disparity, valid=disparity > 4)


@pytest.mark.parametrize("true", [FIT, ConfidenceFit(0.5, 1.5, 1.0), ConfidenceFit(1.0, 0.0, 0.0)])
def test_the_fit_finds_what_the_errors_were_drawn_from(true):
    raw, correct = drawn(true)
    found = fit_confidence(raw, correct)
    assert asdict(found) == pytest.approx(asdict(true), abs=0.05)
    probability = found(torch.from_numpy(raw)).numpy()
    assert reliability(probability, correct).error < 0.005
    assert probability.mean() == pytest.approx(correct.mean(), abs=1e-3)


def test_a_fit_never_falls():
    rng = np.random.default_rng(0)
    raw = rng.random(10_000)
    for fit in (FIT, fit_confidence(raw, rng.random(10_000) < 1 - raw)):  # the wrong way round
        assert (fit(torch.linspace(0, 1, 1001)).diff() >= 0).all()
    assert fit.rise == fit.fall == 0
    assert torch.isfinite(FIT(torch.tensor([0.0, 1.0]))).all()


def test_reliability_counts_what_came_true():
    confidence = np.repeat([0.25, 0.85, 1.0], [100, 50, 50])
    correct = np.concatenate([np.arange(100) < 45, np.arange(50) < 40, np.arange(50) < 50])
    found = reliability(confidence.reshape(2, 100), correct.reshape(2, 100))
    assert found.pixels.tolist() == [0, 0, 100, 0, 0, 0, 0, 0, 50, 50]
    assert found.true[[2, 8, 9]] == pytest.approx([0.45, 0.8, 1.0])
    assert found.error == pytest.approx((100 * 0.2 + 50 * 0.05) / 200)
    assert found.table()[0] == {"from": 0.2, "pixels": 100, "said": 0.25, "true": 0.45}


def test_what_cannot_be_fitted_is_refused():
    raw = np.array([0.2, 0.9])
    with pytest.raises(InputError, match=r"errors below and above 3 px, and all are below"):
        fit_confidence(raw, np.array([True, True]))
    for count in (fit_confidence, reliability):
        with pytest.raises(InputError, match=r"one shape .* got \(2,\) and \(3,\)"):
            count(raw, np.zeros(3, bool))
    for values in ((-1, 0, 0), (0, -1, 0), (0, 0, float("nan")), ("1", 0, 0)):
        with pytest.raises(InputError, match="three numbers"):
            ConfidenceFit(*values)


def test_results_have_the_probability_and_the_same_disparity(net, views):
    raw = StereoMatcher(net, confidence=True).infer(*views)
    net.confidence_fit = FIT
    found = StereoMatcher(net, confidence=True).infer(*views)
    torch.testing.assert_close(found.confidence, FIT(raw.confidence))
    assert not torch.equal(found.confidence, raw.confidence)
    assert torch.equal(found.disparity, raw.disparity)  # the refinement takes the network's own
    small = StereoMatcher(net, confidence=True, scale=0.5)
    net.confidence_fit = None
    own = StereoMatcher(net, confidence=True, scale=0.5).infer(*views).confidence
    right = 1 - (1 - FIT(own)) ** 0.5  # the errors are half as large in the small views
    torch.testing.assert_close(small.infer(*views).confidence, right)
    pair = [(view[0].permute(1, 2, 0) * 255).byte().numpy() for view in views]
    result = small(*pair)
    assert result.confidence.shape == (48, 96)


def test_the_fit_is_in_the_weights(net, tmp_path):
    path = tmp_path / "net.safetensors"
    save_weights(net, path)
    assert load_model(path).confidence_fit is None
    net.confidence_fit = FIT
    save_weights(net, path)
    save_pretrained(net, tmp_path / "folder")
    for source in (path, tmp_path / "folder"):
        assert load_model(source).confidence_fit == FIT
    assert load_model(path, estimator="mode").confidence_fit == FIT
    assert load_model(path, estimator="mean").confidence_fit is None
    assert average_weights([path, path]).confidence_fit is None


@pytest.mark.parametrize("text", ['{"rise": 1}', '{"rise": -1, "fall": 1, "offset": 0}', "[1]"])
def test_a_damaged_fit_is_refused(net, tmp_path, text, monkeypatch):
    path = tmp_path / "net.safetensors"
    net.confidence_fit = FIT
    monkeypatch.setattr("mobilestereonet.weights.files.asdict", lambda _: json.loads(text))
    monkeypatch.setattr("mobilestereonet.weights.files.model_reference", lambda _: "msnet2d")
    save_weights(net, path)
    with pytest.raises(InputError, match=r"net.safetensors: its confidence_fit does not fit"):
        load_model(path)


def test_confidences_are_those_of_pixels_with_ground_truth(net):
    sample = drawn_sample()
    matcher = StereoMatcher(net, confidence=True)
    raw, correct = confidences(matcher, [sample])
    prediction = matcher.infer(sample.left[None], sample.right[None])
    near = sample.valid & (sample.disparity < 32)
    assert raw.shape == correct.shape == (int(near.sum()),)
    error = (prediction.disparity[0] - sample.disparity)[near].abs().numpy()
    np.testing.assert_array_equal(correct, error < 3)
    with pytest.raises(InputError, match="no pixel has ground truth"):
        confidences(matcher, [replace(sample, disparity=None)])
    with pytest.raises(InputError, match="sgbm has no confidence"):
        confidences(StereoMatcher.from_pretrained("sgbm"), [sample])


def test_command(net, msnet, tmp_path, monkeypatch):
    samples = [drawn_sample()]
    monkeypatch.setattr("mobilestereonet.scenes.ProceduralScenes", lambda config: samples)
    path, output = tmp_path / "net.safetensors", tmp_path / "fitted.safetensors"
    save_weights(net, path, card={"licence": "mine"})
    size = ("--scenes", 1, "--height", 32, "--width", 64)
    code, out, err = msnet("fit-confidence", path, "-o", output, *size)
    assert code == 0, err
    assert "calibration error" in out
    assert out.endswith(f"{output}\n")
    card = json.loads(output.with_suffix(".json").read_text())
    facts = card["confidence"]
    assert (card["licence"], facts["seed"], facts["scenes"]) == ("mine", SEED, 1)
    fitted = load_model(output)
    assert fitted.confidence_fit == ConfidenceFit(**facts["fit"])
    own = load_model(path).state_dict()
    assert all(value.equal(own[name]) for name, value in fitted.state_dict().items())
    again = msnet("fit-confidence", output, "-o", tmp_path / "again.safetensors", *size)[1]
    assert again.splitlines()[:-1] == out.splitlines()[:-1]  # of the network's own confidence
