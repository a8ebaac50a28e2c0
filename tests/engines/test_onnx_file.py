"""ONNX files of other people: any two views and a disparity, by options or by metadata."""

import json
from dataclasses import asdict

import numpy as np
import pytest
import torch

from mobilestereonet.engines.base import Engine
from mobilestereonet.engines.choose import open_standalone
from mobilestereonet.engines.onnx_file import OnnxFileEngine
from mobilestereonet.engines.sgbm import StereoSGBM
from mobilestereonet.errors import InputError
from mobilestereonet.inference import StereoMatcher
from mobilestereonet.nets import ConfidenceFit

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

from onnx import TensorProto, helper, numpy_helper  # noqa: E402


def write(
    path,
    *,
    inputs=("left", "right"),
    outputs=("disparity",),
    size=("h", "w"),
    type_=TensorProto.FLOAT,
    channels_last=False,
    axes=(1,),
    scale=1.0,
    metadata=None,
):
    """A "network": the sum over ``axes`` of left + 2 * right, times ``scale``."""
    shape = [1, *size, 3] if channels_last else [1, 3, *size]
    nodes = [
        helper.make_node("Cast", [inputs[0]], ["_a"], to=TensorProto.FLOAT),
        helper.make_node("Cast", [inputs[1]], ["_b"], to=TensorProto.FLOAT),
        helper.make_node("Mul", ["_b", "two"], ["b2"]),
        helper.make_node("Add", ["_a", "b2"], ["sum"]),
        helper.make_node("Mul", ["sum", "scale"], ["scaled"]),
        helper.make_node("ReduceSum", ["scaled", "axes"], ["map"], keepdims=1),
    ]
    nodes += [helper.make_node("Identity", ["map"], [name]) for name in outputs]
    constants = {
        "two": np.float32(2),
        "scale": np.float32(scale),
        "axes": np.array([3] if channels_last else axes, np.int64),
    }
    result = [1, *size, 1] if channels_last else [1, 1, *size]
    graph = helper.make_graph(
        nodes,
        "network",
        [helper.make_tensor_value_info(name, type_, shape) for name in inputs],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, result) for name in outputs],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    helper.set_model_props(model, metadata or {})
    onnx.checker.check_model(model)
    onnx.save_model(model, path)
    return path


def match(engine, left, right):
    """As `StereoMatcher` does."""
    return engine(engine.preprocessing(left), engine.preprocessing(right)).disparity


def test_results_name_file_and_engine(tmp_path):
    file = write(tmp_path / "own.onnx")
    matcher = StereoMatcher.from_pretrained(f"onnx:{file},scale=1")
    assert matcher.summary == "own.onnx on onnxruntime fp32"
    assert StereoMatcher(OnnxFileEngine(f"onnx:{file},scale=1")).summary == (
        "own on onnxruntime fp32"
    )


def test_a_foreign_network_by_options(tmp_path):
    file = write(tmp_path / "a,b.onnx", inputs=("x0", "x1"), scale=-1)
    mean, std = [123.675, 116.28, 103.53], [58.395, 57.12, 57.375]
    engine = OnnxFileEngine(
        f"onnx:{file},scale=255,mean=123.675/116.28/103.53,std=58.395/57.12/57.375,"
        "disparity_scale=-1,size_multiple=16,max_disparity=128",
        threads=1,
    )
    assert isinstance(engine, Engine)
    assert (engine.name, engine.model, engine.precision) == ("onnxruntime", "a,b", "fp32")
    assert (engine.size_multiple, engine.max_disparity) == (16, 128)
    assert not engine.has_confidence
    left, right = torch.rand(2, 2, 3, 20, 30)
    prepared = [
        (255 * view - torch.tensor(mean)[:, None, None]) / torch.tensor(std)[:, None, None]
        for view in (left, right)
    ]
    expected = (prepared[0] + 2 * prepared[1]).sum(dim=1)
    found = match(engine, left, right)
    assert found.shape == (2, 20, 30)
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-4)
    assert engine(left, right, confidence=True).confidence is None


def test_its_metadata_say_the_same(tmp_path):
    metadata = {
        "scale": "255",
        "mean": "[1, 2, 3]",
        "std": "4",
        "size_multiple": "8",
        "author": "x",
    }
    file = write(tmp_path / "net.onnx", metadata=metadata)
    engine = OnnxFileEngine(f"onnx:{file}")
    assert engine.preprocessing.mean == (1, 2, 3)
    assert engine.preprocessing.std == (4, 4, 4)
    assert (engine.preprocessing.scale, engine.size_multiple) == (255, 8)
    assert OnnxFileEngine(f"onnx:{file},size_multiple=4").size_multiple == 4
    assert engine.confidence_fit is None


def test_the_fit_of_a_confidence_is_in_the_metadata(tmp_path):
    fit = ConfidenceFit(rise=0.5, fall=0.25, offset=1.0)
    outputs = {"outputs": ("disparity", "confidence"), "scale": 0.1}
    texts = {"scale": "1", "confidence_fit": json.dumps(asdict(fit))}
    matchers = [
        StereoMatcher.from_pretrained(
            f"onnx:{write(tmp_path / name, metadata=metadata, **outputs)}", confidence=True
        )
        for name, metadata in (("raw.onnx", {"scale": "1"}), ("fit.onnx", texts))
    ]
    views = torch.rand(2, 1, 3, 20, 30)
    raw, found = (matcher.infer(*views).confidence for matcher in matchers)
    torch.testing.assert_close(found, fit(raw))


@pytest.mark.parametrize(
    ("written", "options"),
    [
        ({"inputs": ("right_image", "left_image")}, ""),
        ({"inputs": ("a_left", "b")}, ""),
        ({"inputs": ("img2", "img1")}, ",left=img1"),
        ({"inputs": ("img2", "img1")}, ",right=img2,left=img1"),
    ],
)
def test_the_order_of_inputs_is_told_by_their_names(written, options, tmp_path):
    file = write(tmp_path / "net.onnx", **written)
    engine = OnnxFileEngine(f"onnx:{file},scale=1{options}")
    left, right = torch.rand(2, 1, 3, 8, 8)
    first = left if "left" in written["inputs"][0] else right
    second = right if first is left else left
    expected = (first + 2 * second).sum(dim=1)
    torch.testing.assert_close(match(engine, left, right), expected)


def test_channels_last_bytes_and_bgr(tmp_path):
    file = write(tmp_path / "net.onnx", channels_last=True, type_=TensorProto.UINT8)
    engine = OnnxFileEngine(f"onnx:{file},scale=255")
    left, right = torch.randint(256, (2, 1, 3, 8, 9)) / 255
    expected = 255 * (left + 2 * right).sum(dim=1)
    torch.testing.assert_close(match(engine, left, right), expected, rtol=0, atol=1e-2)
    session = OnnxFileEngine(f"onnx:{write(tmp_path / 'bgr.onnx')},scale=1,colour=bgr")
    fed = []
    run = session._session.run
    session._session = type(
        "Spy", (), {"run": lambda _, names, feed: fed.append(feed) or run(names, feed)}
    )()
    match(session, left, right)
    np.testing.assert_array_equal(fed[0]["left"], left.flip(1).numpy())


def test_a_file_of_fixed_size_pads_smaller_views_and_refuses_larger_ones(tmp_path):
    file = write(tmp_path / "net.onnx", size=(32, 64))
    engine = OnnxFileEngine(f"onnx:{file},scale=1")
    assert (engine.fixed_size, engine.size_multiple) == ((32, 64), 1)
    left, right = torch.rand(2, 1, 3, 20, 50)
    torch.testing.assert_close(match(engine, left, right), (left + 2 * right).sum(dim=1))
    message = (
        r"takes views up to 32 x 64 \(height x width\), got 33 x 64: match in tiles of 32 x 64"
    )
    with pytest.raises(InputError, match=message):
        engine(*torch.rand(2, 1, 3, 33, 64))


@pytest.mark.parametrize("outputs", [("low", "disparity"), ("flow", "other")])
def test_one_output_of_several_is_the_disparity(outputs, tmp_path):
    file = write(tmp_path / "net.onnx", outputs=outputs)
    engine = OnnxFileEngine(f"onnx:{file},scale=1,output={outputs[0]}")
    assert engine._output.name == outputs[0]
    if "disparity" in outputs:
        assert OnnxFileEngine(f"onnx:{file},scale=1")._output.name == "disparity"
    else:
        with pytest.raises(InputError, match=r"outputs flow, other: say which one .*,output=other"):
            OnnxFileEngine(f"onnx:{file},scale=1")


@pytest.mark.parametrize(
    ("written", "options", "message"),
    [
        ({}, "", "does not say how it takes the views: add the options, such as ,scale=1"),
        ({}, ",scale=big", "scale cannot be 'big'"),
        ({}, ",scale=1,mean=1/2", "mean cannot be '1/2'"),
        ({}, ",scale=1,std=0", "std must not be 0"),
        ({}, ",scale=1,colour=grey", "colour must be rgb or bgr, got 'grey'"),
        ({}, ",scale=1,speed=2", "unknown option 'speed': there are scale, mean"),
        ({}, ",normalise=yes", "normalise must be imagenet, got 'yes'"),
        ({}, ",scale=1,size_multiple=0", "size_multiple must be at least 1, got 0"),
        ({}, ",scale=1,left=picture", "its inputs are left and right, not picture and right"),
        ({"inputs": ("a", "b")}, ",scale=1,left=a,right=a", "its inputs are a and b, not a and a"),
        ({"size": (8, 8), "channels_last": True}, ",scale=1,output=x", "say which one"),
    ],
)
def test_bad_options_are_named(written, options, message, tmp_path):
    file = write(tmp_path / "net.onnx", **written)
    with pytest.raises(InputError, match=message):
        OnnxFileEngine(f"onnx:{file}{options}")


def test_bad_files_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.onnx: no such file"):
        OnnxFileEngine("onnx:none.onnx,scale=1")
    file = tmp_path / "net.onnx"
    file.write_text("no network")
    with pytest.raises(InputError, match="ONNX Runtime cannot load it"):
        OnnxFileEngine(f"onnx:{file},scale=1")
    write(file, axes=(1, 2))
    with pytest.raises(InputError, match=r"has the shape .*, not one map of 8 x 8"):
        match(OnnxFileEngine(f"onnx:{file},scale=1"), *torch.rand(2, 1, 3, 8, 8))
    with pytest.raises(InputError, match="takes two views of shape"):
        OnnxFileEngine(f"onnx:{file},scale=1")(torch.rand(1, 3, 8, 8), torch.rand(1, 3, 8, 9))
    with pytest.raises(InputError, match="onnxruntime has no device 'mps' here"):
        OnnxFileEngine(f"onnx:{file},scale=1", device="mps")


def test_models_that_are_engines_by_themselves(tmp_path):
    file = write(tmp_path / "net.onnx")
    assert isinstance(open_standalone("sgbm"), StereoSGBM)
    assert isinstance(open_standalone(f"onnx:{file},scale=1"), OnnxFileEngine)
    assert open_standalone("msnet2d") is None


def test_commands_take_it(msnet, tmp_path):
    from mobilestereonet.data.disparity_files import read_disparity_pfm
    from mobilestereonet.data.files import write_png

    file = write(tmp_path / "their.onnx")
    views = [tmp_path / f"{side}.png" for side in ("left", "right")]
    for view in views:
        write_png(view, np.full((20, 30, 3), 51, np.uint8))
    model = ("--model", f"onnx:{file},scale=1,size_multiple=16")
    code, out, err = msnet("predict", *views, "-o", tmp_path, *model)
    assert code == 0, err
    assert "their" in out and "30x20" in out
    (map_,) = tmp_path.glob("*.pfm")
    np.testing.assert_allclose(read_disparity_pfm(map_)[0], 0.2 * 3 + 0.4 * 3, rtol=1e-5)
    code, out, _ = msnet("bench", *model, "--size", 20, 30, "--repeats", 1)
    assert code == 0 and "their.onnx" in "".join(out.split())  # the table wraps long paths
    code, _, err = msnet("predict", *views, "-o", tmp_path, *model, "--runtime", "openvino")
    assert code == 0 and "runs in ONNX Runtime alone: --runtime has no effect" in err
    code, _, err = msnet("predict", *views, "-o", tmp_path, "--model", f"onnx:{file}")
    assert code == 2 and "does not say how it takes the views" in err
