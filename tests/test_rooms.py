"""The order of the rooms: a room imports only from rooms before it, and no two from each other."""

import ast
import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "src/mobilestereonet"

BASE = ("errors", "atomic", "interruption", "memory", "settings", "text", "timing", "versions")
"""Files that every room may import; they import one another alone."""

ROOMS = (
    "nets",
    "weights",
    "accelerate",
    "data",
    "scenes",
    "metrics",
    "plots",
    "costs",
    "engines",
    "inference",
    "evaluation",
    "training",
    "paper",
    "export",
    "streams",
    "web",
    "cli",
)
"""From the ground up."""


UPWARD = {"inference/matcher.py": "mobilestereonet.streams.matched"}
"""The one import upward: `StereoMatcher.stream`, when it is called, for users look for it there."""


def imports(path):
    """Modules of this package that a file imports, each with its line; ``a.b`` for both forms."""
    for module, line in all_imports(path):
        if module.rpartition(".")[0] != UPWARD.get(path.relative_to(PACKAGE).as_posix()):
            yield module, line


def all_imports(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("mobilestereonet"):
            for alias in node.names:
                yield f"{node.module}.{alias.name}", node.lineno
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.startswith("mobilestereonet"):
                    yield alias.name, node.lineno


def room_of(path):
    part = path.relative_to(PACKAGE).parts[0]
    return part.removesuffix(".py")


FILES = sorted(p for p in PACKAGE.rglob("*.py") if room_of(p) not in ("__init__", "__main__"))


def test_every_file_is_in_a_room():
    assert {room_of(path) for path in FILES} <= {*BASE, *ROOMS}


def test_rooms_import_downward():
    place = dict.fromkeys(BASE, -1) | {room: index for index, room in enumerate(ROOMS)}
    upward = []
    for path in FILES:
        own = room_of(path)
        for module, line in imports(path):
            parts = module.split(".")
            if parts[1:] in ([], ["__version__"]):  # the version
                continue
            if parts[1] not in place:
                upward.append(f"{path.name}:{line} imports a public name: name its room")
            elif place[parts[1]] > place[own]:
                upward.append(f"{path.relative_to(PACKAGE)}:{line} imports {module}")
    assert not upward, "\n".join(upward)


def modules():
    """Each module and the modules that it imports, packages' own files apart."""
    graph = {}
    names = {
        ".".join(("mobilestereonet", *p.relative_to(PACKAGE).with_suffix("").parts)): p
        for p in FILES
    }
    names = {name.removesuffix(".__init__"): path for name, path in names.items()}
    for name, path in names.items():
        graph[name] = set()
        for module, _ in imports(path):
            # A name of a module, or a module: the longest that is a file.
            found = module if module in names else module.rpartition(".")[0]
            if found in names and found != name:
                graph[name].add(found)
    return graph


def test_no_two_files_import_each_other():
    try:
        TopologicalSorter(modules()).prepare()
    except CycleError as error:
        pytest.fail(f"a circle of imports: {' <- '.join(error.args[1])}")


FAMILIES = r"\bnets(\.| import .*\b)\w*msnet|\bPSMNet|\bNetConfig\("


def test_other_rooms_know_the_interface_alone():
    naming = [
        str(path.relative_to(PACKAGE))
        for path in FILES
        if re.search(FAMILIES, path.read_text(encoding="utf-8"))
        and room_of(path) not in ("accelerate", "nets")
    ]
    assert not naming
