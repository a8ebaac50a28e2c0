"""What `msnet export web` refuses before anything is written."""

import pytest

from mobilestereonet import InputError
from mobilestereonet.export.web import export_page
from mobilestereonet.nets import build_model


def page(folder, runtime):
    net = build_model("msnet2d", max_disparity=32, hourglasses=1, width=8)
    return export_page(net, folder, runtime=runtime, model="small")


def test_a_missing_runtime_is_named_with_its_packages(tmp_path):
    (tmp_path / "node_modules").mkdir()
    with pytest.raises(InputError, match=r"has no onnxruntime-web/dist/ort.*npm install onnxrunt"):
        page(tmp_path / "site", tmp_path / "node_modules")
    assert [path.name for path in tmp_path.iterdir()] == ["node_modules"]


def test_a_folder_with_something_else_stays(tmp_path):
    (tmp_path / "work").write_text("of years")
    for folder in (tmp_path, tmp_path / "work"):
        with pytest.raises(InputError, match="holds something else than such a page"):
            page(folder, tmp_path)
    assert (tmp_path / "work").read_text() == "of years"


@pytest.mark.parametrize("foreign", ["CNAME", ".git/HEAD", "runtime/notes.txt"])
def test_what_lies_beside_a_page_stays(tmp_path, foreign):
    for name in ("page.json", "sw.js", "worker.js", "model.onnx"):
        (tmp_path / name).touch()
    (tmp_path / "runtime").mkdir()
    path = tmp_path / foreign
    page_alone = sorted(tmp_path.iterdir())
    if foreign == "CNAME":  # the page alone passes: the runtime is what is missing
        with pytest.raises(InputError, match="npm install"):
            page(tmp_path, tmp_path / "runtime")
    path.parent.mkdir(exist_ok=True)
    path.write_text("of years")
    with pytest.raises(InputError, match=rf"such a page \({foreign.split('/')[0]}.*another folder"):
        page(tmp_path, tmp_path / "runtime")
    assert path.read_text() == "of years"
    assert set(page_alone) <= set(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("web",), "web needs DIR, the folder to write"),
        (("web", "site"), "web needs --runtime-dir node_modules"),
        (("web", "site", "-o", "net.onnx"), "--output is not for web"),
        (("onnx", "site"), "site is for web"),
    ],
)
def test_arguments_of_the_command(words, message, msnet):
    code, _, err = msnet("export", *words)
    assert code == 2
    assert message in err
