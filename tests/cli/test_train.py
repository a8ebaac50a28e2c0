"""The commands around training, as a user runs them; what they do is tested elsewhere."""

import pytest


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["train", "RUN", "--set", "colour=red"], "no value 'colour'"),
        (["train", "RUN", "--set", "lr"], "'lr': write it as key=value"),
        (["train", "RUN", "--set", "lr=fast"], "lr must be a number, got 'fast'"),
        (["train", "RUN", "--recipe", "fast"], "--recipe fast: there are deeppruner-"),
        (["train", "RUN", "--recipe", "paper-kitti2015"], "--root DIR"),
        (["train", "RUN", "--set", "model=msnet4d"], "unknown model"),
        (["train", "RUN", "--set", "net.max_disparity=100"], "multiple of 16"),
        (["train", "RUN", "--weights", "RUN/none.safetensors"], "none.safetensors"),
        (["train", "RUN", "--textures", "RUN/none"], "no folder RUN/none"),
        (["train", "RUN", "--resume"], "RUN holds no run: there is no recipe.json"),
        (["train", "RUN", "--precision", "fp99"], "fp99"),
        (["ablate", "RUN", "--table", "7"], "--table 7: there are 2, 3a"),
        (["ablate", "RUN", "--models", "msnet2d, msnet4d"], "unknown model 'msnet4d'"),
        (["ablate", "RUN", "--set", "weights=msnet2d"], "not from msnet2d: leave weights out"),
        (["plot-run", "RUN"], "no folder RUN"),
        (["data", "preview", "kitti2015", "-o", "RUN/x.png"], "--root DIR"),
    ],
)
def test_bad_input_is_one_line(arguments, words, msnet, tmp_path):
    run = tmp_path / "run"
    code, out, err = msnet(*(text.replace("RUN", str(run)) for text in arguments))
    assert code == 2 and out == ""
    assert err.startswith("msnet: ") and err.count("\n") == 1
    assert words.replace("RUN", str(run)) in err
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


@pytest.mark.parametrize("command", ["train", "ablate", "plot-run", "data", "data preview"])
def test_help(command, msnet):
    code, out, _ = msnet(*command.split(), "--help")
    assert code == 0 and "Usage" in out
