"""The bundled configs and records, for whoever has the package and no checkout."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from bayesdrill.basics import own_files
from bayesdrill.basics.errors import InputError, Problem

PACKAGE = Path(__file__).parents[1]
FILES = (
    *("nominal_step.yaml", "example_rig.yaml", "example_ties.yaml", "example_experiments.yaml"),
    *("example_torque.yaml", "schema.json"),
    *(f"records/{name}.csv" for name in ("nominal_step", "example_rig", "example_ties")),
    *(f"records/{name}.csv" for name in ("example_step", "example_rundown", "example_torque")),
    *(f"paper/{name}.yaml" for name in ("estimates", "measured", "missing_physics")),
    "paper/two_parameters.yaml",
    *(f"paper/records/{name}.csv" for name in ("estimates", "missing_physics", "two_parameters")),
)


def write(folder: Path) -> tuple[Path, ...]:
    """`FILES` in `folder`, which may hold others; raises `InputError` where one of them is there."""
    bundled = _bundled()
    contents = {folder / name: (bundled / name).read_bytes() for name in FILES}
    obstacles = [*_no_folders(folder), *_present(contents)]
    if obstacles:
        raise InputError(obstacles)
    for path, content in contents.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        own_files.write(path, content)
    return tuple(contents)


def _bundled() -> Path:
    """Of a wheel, `examples` in the package; of a checkout, `configs`, which wheels have there."""
    for place in (PACKAGE / "examples", PACKAGE.parent / "configs"):
        if (place / FILES[0]).is_file():
            return place
    raise InputError.one(str(PACKAGE), "came without its examples; install bayesdrill again")


def _no_folders(folder: Path) -> list[Problem]:
    below = [folder / name for name in ("records", "paper", "paper/records")]
    wrong = [path for path in below if own_files.what(path) not in ("", "a folder")]
    if folder.exists() and not folder.is_dir():
        wrong = [folder]
    message = "is no folder, where the examples need one; move it, or give another FOLDER"
    return [Problem(str(path), message) for path in wrong]


def _present(paths: Iterable[Path]) -> list[Problem]:
    message = "is there already; move it, or give another FOLDER"
    return [Problem(str(path), message) for path in paths if own_files.what(path)]
