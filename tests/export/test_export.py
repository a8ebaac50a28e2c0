"""Every format: the file in its own runtime gives what torch gives, or nothing is written."""

import json

import pytest
import torch
from torch import nn

from mobilestereonet import InputError, save_weights
from mobilestereonet.data.motorcycle import motorcycle_views
from mobilestereonet.engines.onnx_file import OnnxFileEngine
from mobilestereonet.export import FORMATS, calibration_pairs, export_model
from mobilestereonet.export.base import Format
from mobilestereonet.export.metadata import describe
from mobilestereonet.nets import ConfidenceFit, build_model
from mobilestereonet.nets.model import Prediction, Preprocessing, StereoModel
from small_views import for_small_views, with_statistics

SMALL = {"max_disparity": 32, "hourglasses": 1, "width": 8}
SIZE = (32, 64)


@pytest.fixture(scope="module")
def net():
    """A small network whose batch norms do something."""
    torch.manual_seed(0)
    net = build_model("msnet2d", **SMALL, estimator="mode").eval()
    net.zero_residuals()  # fresh weights would amplify rounding
    with torch.no_grad():
        for module in net.modules():
            if isinstance(module, nn.BatchNorm2d | nn.BatchNorm3d):
                module.bias.normal_(0, 0.1)
                module.running_mean.normal_(0, 0.1)
                module.running_var.uniform_(0.5, 1.5)
    net.confidence_fit = ConfidenceFit(rise=1.5, fall=0.5, offset=-1.0)
    return net


def expected(net, left, right):
    with torch.no_grad():
        return net(*map(net.preprocessing, (left, right)))


def assert_like_torch(found, net, left, right, *, disparity=1e-3, confidence=1e-3):
    """Disparity in px, and the confidence of a network that has one."""
    for name, tolerance in (("disparity", disparity), ("confidence", confidence)):
        found_map, wanted = getattr(found, name), getattr(expected(net, left, right), name)
        assert (found_map is None) == (wanted is None)
        if wanted is not None:
            torch.testing.assert_close(
                found_map, wanted, rtol=0, atol=tolerance, check_stride=False
            )


def needs(name, *, precision="fp32"):
    format_ = FORMATS[name]
    missing = [package for package, found in format_.versions(precision).items() if not found]
    if missing:
        pytest.skip(f"{', '.join(missing)} not installed")
    return format_


@pytest.mark.parametrize("name", ["onnx", "openvino", "executorch", "litert"])
def test_the_file_gives_what_torch_gives_and_describes_itself(name, net, tmp_path):
    format_ = needs(name)
    output = tmp_path / "net" / f"small{format_.ending}"
    done = export_model(name, net, output, model="small", size=SIZE)
    assert done.path == output
    files = list(output.parent.iterdir())
    assert done.size == sum(file.stat().st_size for file in files)
    assert done.mean <= 1e-4
    assert done.seconds > 0
    assert done.ratio > 0

    run = format_.open(output)
    sizes = [SIZE, (48, 112)] if format_.dynamic else [SIZE]
    for size in sizes:
        left, right = torch.rand(2, 1, 3, *size)
        assert_like_torch(run(left, right), net, left, right)

    metadata = format_.read_metadata(output)
    assert metadata["model"] == "small"
    assert metadata["colour_order"] == "RGB"
    assert metadata["mean"] == "0.485, 0.456, 0.406"
    assert metadata["disparity_range"] == "0..31"
    assert metadata["confidence"].startswith("the network's own: probability that the")
    assert metadata["confidence_fit"] == '{"rise": 1.5, "fall": 0.5, "offset": -1.0}'
    assert metadata["size"] == ("any" if format_.dynamic else "32 x 64 (height x width)")


COARSE = {"coarse_pass": True, "coarse_levels": 2, "max_disparity": 64}
CASCADE = {**COARSE, "coarse_hourglasses": 1, "band": 8}


EVERY = pytest.mark.exhaustive


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        pytest.param("onnx", CASCADE, id="onnx-cascade"),
        pytest.param("openvino", COARSE, id="openvino-coarse_pass"),
        pytest.param("onnx", COARSE, id="onnx-coarse_pass", marks=EVERY),
        pytest.param("openvino", CASCADE, id="openvino-cascade", marks=EVERY),
        *((name, fields) for name in ("executorch", "litert") for fields in (CASCADE, COARSE)),
    ],
)
def test_files_of_networks_with_a_coarse_pass(name, fields, tmp_path):
    format_ = needs(name)
    torch.manual_seed(0)
    net = build_model("msnet3d", **{**SMALL, "groups": 8, **fields}).eval()
    net.zero_residuals()
    torch.nn.init.normal_(net.guide.weight)
    output = tmp_path / f"small{format_.ending}"
    assert export_model(name, net, output, model="small", size=(32, 96)).mean <= 1e-4
    left, right = torch.rand(2, 1, 3, 32, 96)
    assert_like_torch(format_.open(output)(left, right), net, left, right)
    assert format_.read_metadata(output)["size_multiple"] == "32"


def test_an_onnx_file_in_half_precision(net, tmp_path):
    needs("onnx")
    net = replace_estimator(net, "mean")
    output = tmp_path / "half.onnx"
    done = export_model("onnx", net, output, model="small", precision="fp16", size=SIZE)
    assert 0 < done.mean < 0.05
    left, right = torch.rand(2, 1, 3, 48, 112)
    found = FORMATS["onnx"].open(output)(left, right)
    assert_like_torch(found, net, left, right, disparity=0.2, confidence=0.02)
    weights = sum(weight.numel() for weight in net.parameters())
    assert OnnxFileEngine(f"onnx:{output}").precision == "fp16"
    assert output.stat().st_size < 2 * weights + 500_000


def replace_estimator(net, estimator):
    other = build_model("msnet2d", **SMALL, estimator=estimator).eval()
    other.load_state_dict(net.state_dict())
    return other


@pytest.mark.parametrize("name", ["onnx", "openvino"])
def test_int8_stays_near(name, net, tmp_path):
    needs(name, precision="int8")
    # Of a network without training the likeliest neighbourhood is anybody's guess.
    net = replace_estimator(net, "mean")
    folder = tmp_path / "pairs"
    write_pairs(folder)
    output = tmp_path / f"small{FORMATS[name].ending}"
    done = export_model(
        name, net, output, model="small", precision="int8", size=SIZE, calibration=folder
    )
    assert 0 < done.mean < 0.5
    assert FORMATS[name].read_metadata(output)["precision"] == "int8"


def test_core_ml_is_converted(net, tmp_path):
    needs("coreml")
    output = tmp_path / "small.mlpackage"
    done = export_model("coreml", net, output, model="small", precision="fp32", size=SIZE)
    assert done.mean is None
    assert FORMATS["coreml"].read_metadata(output)["model"] == "small"


class Wrong(Format):
    """Its files always say 3 px."""

    name, ending, extra, packages = "wrong", ".bin", "wrong", ()
    precisions = ("fp32", "int8")
    value = 3.0

    def write(self, job, path):
        path.write_text("new")
        path.with_name("other").write_text("new")

    def open(self, path):
        return lambda left, right: Prediction(torch.full((1, *left.shape[-2:]), self.value))

    def read_metadata(self, path):
        return {}


@pytest.mark.parametrize("value", [3.0, float("nan")])
def test_a_file_that_differs_is_not_written(value, net, tmp_path, monkeypatch):
    wrong = Wrong()
    wrong.value = value
    monkeypatch.setitem(FORMATS, "wrong", wrong)
    output = tmp_path / "net.bin"
    output.write_text("old")
    with pytest.raises(InputError, match="wrong: the file's disparity differs from torch's by"):
        export_model("wrong", net, output, model="small", size=SIZE)
    assert [path.name for path in tmp_path.iterdir()] == ["net.bin"]
    assert output.read_text() == "old"


def test_a_failed_conversion_leaves_nothing(net, tmp_path, monkeypatch):
    class Failing(Wrong):
        def write(self, job, path):
            path.write_text("half")
            raise RuntimeError("no such operator\nand much more")

    monkeypatch.setitem(FORMATS, "wrong", Failing())
    with pytest.raises(InputError, match=r"conversion failed: RuntimeError: no such operator$"):
        export_model("wrong", net, tmp_path / "net.bin", model="small", size=SIZE)
    assert not list(tmp_path.iterdir())


def test_a_missing_package_is_named_with_its_extra(net, tmp_path, monkeypatch):
    class Missing(Wrong):
        packages = ("a-package-that-is-not-there",)

    monkeypatch.setitem(FORMATS, "wrong", Missing())
    with pytest.raises(InputError) as caught:
        export_model("wrong", net, tmp_path / "net.bin", model="small", size=SIZE)
    assert "needs a-package-that-is-not-there" in str(caught.value)
    assert 'pip install "mobilestereonet[wrong]"' in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"format_": "gif"}, "unknown format 'gif'"),
        ({"output": "net.onnx"}, "net.onnx: a file for pt2 must end in .pt2"),
        ({"size": (40, 64)}, "height must be a multiple of 16, got 40: take 32 or 48"),
        ({"size": (32, 0)}, "width must be a multiple of 16, got 0: take 48 or 64"),
        ({"size": (32, 32)}, "width must be at least 48 for 32 disparities, got 32"),
        ({"precision": "int8"}, "pt2 has no precision 'int8', only fp32"),
        ({"calibration": "pairs"}, "calibration pairs are for precision int8, not fp32"),
    ],
)
def test_bad_arguments_are_refused(arguments, message, net):
    given = {"format_": "pt2", "output": "net.pt2", "model": "small", **arguments}
    with pytest.raises(InputError, match=message):
        export_model(net=net, **given)


def write_pairs(folder):
    import cv2
    import numpy as np

    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
        for index in range(2):
            picture = np.random.default_rng(index).integers(0, 255, (40, 90, 3), dtype=np.uint8)
            assert cv2.imwrite(str(folder / side / f"{index}.png"), picture)


def test_pairs_have_the_size_that_is_asked_for(tmp_path):
    write_pairs(tmp_path)
    for size in (SIZE, (80, 96)):
        pairs = [motorcycle_views(size), *calibration_pairs(size, tmp_path)]
        assert len(pairs) == 3
        for pair in pairs:
            for view in pair:
                assert view.shape == (1, 3, *size)
                assert 0 <= view.min() < view.max() <= 1
    assert len(list(calibration_pairs(SIZE))) > 10
    with pytest.raises(FileNotFoundError):
        list(calibration_pairs(SIZE, tmp_path / "none"))


def test_metadata_say_whose_the_weights_are():
    net = build_model("msnet2d")
    arguments = {"precision": "fp32", "size": None, "min_width": 208}
    assert describe(net, "msnet2d", embedded=True, **arguments)["licence"] == "Apache-2.0"
    assert describe(net, "msnet2d", embedded=False, **arguments)["licence"] != "Apache-2.0"
    assert describe(net, "msnet2d", embedded=True, **arguments)["smallest_width"] == "208"


class Direct(StereoModel):
    """A network without scores whose graph has sizes in it, and whose input is no ImageNet's."""

    size_multiple = 8
    preprocessing = Preprocessing(mean=(100, 110, 120), std=(50, 50, 50), scale=255)

    def __init__(self, config):
        super().__init__(config)
        self.conv = nn.Conv2d(6, 1, 3, stride=2, padding=1)

    def forward(self, left, right):
        x = self.conv(torch.cat((left, right), dim=1))
        x = nn.functional.interpolate(x, size=left.shape[-2:], mode="bilinear")
        return Prediction(10 + x.squeeze(1))


def direct():
    torch.manual_seed(0)
    return Direct(build_model("msnet2d", **SMALL).config).eval()


@pytest.mark.parametrize("name", ["onnx", "openvino", "pt2"])
def test_any_network_is_exported_at_one_size(name, tmp_path):
    format_ = needs(name)
    net, output = direct(), tmp_path / f"direct{format_.ending}"
    done = export_model(name, net, output, model="direct", size=SIZE)
    assert done.mean <= 1e-4 and not done.any_size
    pair = torch.rand(2, 1, 3, *SIZE)
    assert_like_torch(format_.open(output)(*pair), net, *pair)
    metadata = format_.read_metadata(output)
    assert metadata["size"] == "32 x 64 (height x width)"
    assert (metadata["scale"], metadata["mean"]) == ("255", "100, 110, 120")


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param("deeppruner-best", marks=EVERY), "deeppruner-fast"])
def test_the_particles_of_deeppruner_are_in_the_file(name, tmp_path):
    needs("onnx")
    torch.manual_seed(0)
    net = for_small_views(build_model(name))
    net = with_statistics(net, *torch.randn(2, 1, 3, 64, 64))
    done = export_model("onnx", net, tmp_path / "net.onnx", model=name, size=(64, 64))
    assert done.mean <= 1e-3 and not done.any_size
    left, right = torch.rand(2, 1, 3, 64, 64)
    found = FORMATS["onnx"].open(done.path)(left, right)
    torch.testing.assert_close(found, expected(net, left, right), rtol=0, atol=0.02)


@pytest.mark.parametrize("kind", ["msnet", "direct"])
def test_an_exported_onnx_file_is_an_engine_without_options(kind, net, tmp_path):
    needs("onnx")
    net, output = (net if kind == "msnet" else direct()), tmp_path / "net.onnx"
    export_model("onnx", net, output, model=kind, size=SIZE)
    engine = OnnxFileEngine(f"onnx:{output}")
    assert engine.max_disparity == net.max_disparity
    assert engine.fixed_size == (None if kind == "msnet" else SIZE)
    assert engine.size_multiple == (16 if kind == "msnet" else 1)
    pair = torch.rand(2, 1, 3, *SIZE)
    assert engine.has_confidence == (kind == "msnet")
    assert_like_torch(engine(*map(engine.preprocessing, pair), True), net, *pair)
    assert engine(*map(engine.preprocessing, pair)).confidence is None
    engine(*torch.rand(2, 1, 3, 16, 24))  # narrower than the graph takes: padded


def test_the_network_stays_as_it_was(net, tmp_path):
    net.train()
    modes = [module.training for module in net.modules()]
    try:
        export_model("pt2", net, tmp_path / "small.pt2", model="small", size=SIZE)
        assert [module.training for module in net.modules()] == modes
        assert all(weight.requires_grad for weight in net.parameters())
    finally:
        net.eval()


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_network_on_a_gpu_is_exported_from_there(tmp_path):
    net = direct().cuda()
    export_model("pt2", net, tmp_path / "small.pt2", model="small", size=SIZE)
    assert next(net.parameters()).is_cuda


def test_a_folder_is_never_replaced(net, tmp_path, monkeypatch):
    monkeypatch.setitem(FORMATS, "wrong", Wrong())
    kept = tmp_path / "net.bin" / "kept"
    kept.parent.mkdir()
    kept.write_text("work of years")
    with pytest.raises(InputError, match=r"net\.bin is a folder, and stays"):
        export_model("wrong", net, kept.parent, model="small", size=SIZE)
    assert kept.read_text() == "work of years"


def test_nor_is_one_with_the_name_of_a_file_beside(net, tmp_path, monkeypatch):
    class Right(Wrong):
        def open(self, path):
            return lambda left, right: expected(net, left, right)

    monkeypatch.setitem(FORMATS, "wrong", Right())
    kept = tmp_path / "other" / "kept"
    kept.parent.mkdir()
    kept.write_text("work of years")
    with pytest.raises(InputError, match="other is a folder, and stays"):
        export_model("wrong", net, tmp_path / "net.bin", model="small", size=SIZE)
    assert [file.name for file in tmp_path.iterdir()] == ["other"]
    assert kept.read_text() == "work of years"


def test_command(msnet, net, tmp_path):
    weights = tmp_path / "small.safetensors"
    save_weights(net, weights, dtype=torch.float32)
    output = tmp_path / "a" / "small.pt2"
    code, out, _ = msnet(
        *("export", "pt2", "--weights", weights, "-o", output, "--height", 32, "--width", 64)
    )
    assert code == 0
    assert f"{output}: {output.stat().st_size / 1e6:.2f} MB" in out
    assert f"torch {torch.__version__}" in out
    assert "32 x 64 (height x width): " in out
    files = {"metadata.json": ""}
    program = torch.export.load(output, extra_files=files)
    assert json.loads(files["metadata.json"])["disparity_range"] == "0..31"
    torch.manual_seed(0)  # two disparities as likely as one another are a matter of rounding
    left, right = torch.rand(2, 1, 3, *SIZE)
    assert_like_torch(Prediction(*program.module()(left, right)), net, left, right)


def test_command_lists_the_formats(msnet):
    code, out, _ = msnet("export", "--list")
    assert code == 0
    assert all(name in out for name in FORMATS)
    assert msnet("export")[0] == 2
    assert msnet("export", "gif")[0] == 2
