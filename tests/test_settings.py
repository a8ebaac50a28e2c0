from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import pytest

from mobilestereonet.errors import InputError
from mobilestereonet.settings import (
    build,
    check_arguments,
    differences,
    override,
    parse_assignments,
    parse_variations,
)


@dataclass(frozen=True)
class Camera:
    height: int = 480
    exposure: tuple[float, float] | None = None
    kind: Literal["grey", "colour"] = "colour"

    def __post_init__(self) -> None:
        if self.height < 1:
            raise InputError(f"camera: height must be positive, got {self.height}")


@dataclass(frozen=True)
class Rig:
    name: str
    baseline: float = 0.1
    rectified: bool = True
    camera: Camera = field(default_factory=Camera)
    options: Mapping[str, Any] = field(default_factory=dict)
    curve: tuple[tuple[float, float], ...] = ()
    folder: str | Path | None = None
    tags: dict[str, Any] | None = None


RIG = Rig("front")


def test_build():
    rig = build(
        Rig,
        {
            "name": "rear",
            "baseline": 1,
            "camera": {"exposure": [1, 2], "kind": "grey"},
            "curve": [[0, 1], [1, 0.5]],
        },
        "rig",
    )
    camera = Camera(exposure=(1.0, 2.0), kind="grey")
    assert rig == Rig("rear", 1.0, camera=camera, curve=((0.0, 1.0), (1.0, 0.5)))
    assert isinstance(rig.baseline, float) and isinstance(rig.camera.exposure[0], float)


def test_override_leaves_the_rest():
    before = override(RIG, {"options.a": 1}, "rig")
    after = override(before, {"options.b": [2], "camera.height": 10, "tags.x": 1}, "rig")
    assert after.options == {"a": 1, "b": [2]} and after.camera == Camera(height=10)
    assert after.tags == {"x": 1} and before.options == {"a": 1} and before.camera.height == 480
    assert override(after, {"options": {}}, "rig").options == {}
    assert override(RIG, {}, "rig") == RIG


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"colour": 1}, "rig has no value 'colour', only name, baseline, rectified, camera, "),
        ({"baselin": 1}, r"rig has no value 'baselin' \(did you mean baseline\?\)"),
        ({"heigth": 1}, r"did you mean camera.height\?"),
        ({"camera.heigth": 1}, r"camera has no value 'heigth' \(did you mean height\?\), only"),
        ({"estimator": 1}, r"did you mean net.estimator\?"),
        ({"baseline.x": 1}, "there is no baseline.x: baseline has no parts"),
        ({"camera": 5}, "camera must be a JSON object with some of height, exposure, kind, got 5"),
        ({"camera.height": True}, "camera.height must be a whole number, got True"),
        ({"camera.height": 1.5}, "camera.height must be a whole number, got 1.5"),
        ({"camera.height": 0}, "^camera: height must be positive, got 0$"),
        ({"baseline": "far"}, "baseline must be a number, got 'far'"),
        ({"baseline": None}, "baseline must be a number, got None"),
        ({"rectified": 1}, "rectified must be true or false, got 1"),
        ({"name": 7}, "name must be text, got 7"),
        ({"camera.kind": "red"}, "camera.kind must be one of grey, colour, got 'red'"),
        ({"camera.exposure": [1, 2, 3]}, r"must be \[a number, a number\] or null, got \[1, 2, 3"),
        ({"camera.exposure": ["a", 2]}, r"exposure must be \[a number, a number\] or null"),
        ({"curve": [[0, 1], 2]}, r"curve must be \[a number, a number\], got 2"),
        ({"folder": 3}, "folder must be text or a path or null, got 3"),
        ({"options": "{a: 1}"}, r"options must be a JSON object such as .*, got '\{a: 1\}'"),
    ],
)
def test_refused(values, words):
    with pytest.raises(InputError, match=words):
        override(RIG, values, "rig", also_known=["net.estimator"])


def test_a_value_without_a_default_is_needed():
    with pytest.raises(InputError, match="rig lacks name"):
        build(Rig, {"baseline": 2}, "rig")
    with pytest.raises(InputError, match="rig must be a JSON object with some of name, "):
        build(Rig, [1], "rig")


def test_what_a_dataclass_refuses_in_its_own_words():
    @dataclass(frozen=True)
    class Even:
        number: int

        def __post_init__(self) -> None:
            if self.number % 2:
                raise ValueError("odd")

    with pytest.raises(InputError, match="even: odd"):
        build(Even, {"number": 1}, "even")


def test_arguments_of_a_function():
    def scan(root: str | Path, split: str | None = None, *, scale: float | None = None,
             grey: bool = False) -> None: ...  # fmt: skip

    def check(**arguments):
        return check_arguments(scan, arguments, "kitti", reserved=["root"])

    assert check(split="val", scale=2, grey=True) == {"split": "val", "scale": 2.0, "grey": True}
    for arguments, words in (
        ({"root": "x"}, "kitti has no option 'root', only split, scale, grey"),
        ({"spilt": "x"}, r"kitti has no option 'spilt' \(did you mean split\?\)"),
        ({"scale": "four"}, "kitti: scale must be a number or null, got 'four'"),
        ({"scale": True}, "scale must be a number or null, got True"),
        ({"grey": 1}, "kitti: grey must be true or false, got 1"),
    ):
        with pytest.raises(InputError, match=words):
            check(**arguments)


def test_differences():
    other = override(RIG, {"baseline": 2, "camera.kind": "grey", "options.a": 1}, "rig")
    assert differences(RIG, other) == {
        "baseline": (0.1, 2.0),
        "camera.kind": ("colour", "grey"),
        "options.a": ("unset", 1),
    }
    assert differences(other, other) == {}
    assert differences({"a": 1, "b": {}}, {"a": 1, "b": None}) == {"b": ({}, None)}


def test_assignments():
    given = ["lr=5e-4", "a.b=[1, 2]", "model=msnet3d", "steps=null", "on=true", "url=a=b"]
    assert parse_assignments(given) == {
        "lr": 5e-4, "a.b": [1, 2], "model": "msnet3d", "steps": None, "on": True, "url": "a=b",
    }  # fmt: skip
    with pytest.raises(InputError, match="'lr': write it as key=value"):
        parse_assignments(["lr"])


def test_variations_are_cut_outside_brackets():
    given = ["crop=[1,2],x", 'net={"a": [1, 2]},[3,[4,5]],y', "lr=1e-3,5e-4", "model=a,b"]
    assert parse_variations(given) == {
        "crop": [[1, 2], "x"],
        "net": [{"a": [1, 2]}, [3, [4, 5]], "y"],
        "lr": [1e-3, 5e-4],
        "model": ["a", "b"],
    }
