"""Versions of the trained weights: which come with the package, and where former ones are."""

from __future__ import annotations

from pathlib import Path

from mobilestereonet.text import read_json

FOLDER = Path(__file__).parent / "weights"


def packaged_file(version: str) -> Path:
    """The file with a version's weights, beside which its card is."""
    return FOLDER / f"{version}.safetensors"


def packaged_versions(model: str | None = None) -> list[str]:
    """Names of the weights in the package, such as "msnet2d.procedural-1".

    Args:
        model: Those of one network, such as "msnet2d".
    """
    names = sorted(path.stem for path in FOLDER.glob("*.*.safetensors"))
    return [name for name in names if model in (None, name.partition(".")[0])]


def recorded_versions() -> dict[str, dict[str, str]]:
    """All versions that there were, from ``weights/versions.json``.

    Returns:
        By name: ``sha256`` of the weights file, ``package``, the first version of the package that
        has it, and for a version that does not come with the package any more ``commit``, one of
        the repository's that has it.
    """
    file = FOLDER / "versions.json"
    records: dict[str, dict[str, str]] = read_json(file) if file.is_file() else {}
    return records


def explain_missing(name: str) -> str:
    """What to tell who asks for a version that does not come with the package, and how to get it.

    Args:
        name: Such as "msnet3d.procedural-1", of a network with weights in the package.
    """
    here = ", ".join(packaged_versions(name.partition(".")[0]))
    record = recorded_versions().get(name)
    if record is None:
        return f"no version {name!r} comes with the package: only {here}"
    package = f"mobilestereonet=={record['package']}"
    text = (
        f"{name} came with {package}, and now there is {here}: install that one, or pass the file"
    )
    if "commit" in record:
        file = f"{name}.safetensors"
        place = f"{record['commit']}:src/mobilestereonet/weights/{file}"
        text += f", which the repository has: git show {place} > {file}"
    return text
