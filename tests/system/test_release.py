"""What is released: one version, the files of `dist/`, and what they do where no checkout is."""

from __future__ import annotations

import re
import tarfile
import tomllib
import zipfile

import pytest
from support import command_line, release_builds
from support.release_builds import Dist

import bayesdrill
from bayesdrill.api import files as api_files

ROOT = command_line.ROOT
LARGEST = {".whl": 1_200_000, ".gz": 4_000_000}  # bytes; on the way to whoever installs it


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Dist:
    return release_builds.build(tmp_path_factory.mktemp("release"))


def test_the_version_stands_in_one_place() -> None:
    """Whatever else names it is compared with it here, or in the test of what is cited."""
    number = bayesdrill.__version__
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert project["project"]["dynamic"] == ["version"]
    assert project["tool"]["hatch"]["version"]["path"] == "bayesdrill/__init__.py"
    code = (
        path for path in (ROOT / "bayesdrill").rglob("*.py") if f'"{number}"' in path.read_text()
    )
    assert [path.relative_to(ROOT).as_posix() for path in code] == ["bayesdrill/__init__.py"]


def test_the_changelog_tells_of_this_version() -> None:
    """By the headings of `keep a changelog`: the newest is this one, of the day that is cited."""
    text = (ROOT / "CHANGELOG.md").read_text()
    first, newest, *_ = re.findall(r"^## (.*)$", text, re.M)
    assert first == "Unreleased"
    day = re.search(r"^date-released: '(.*)'$", (ROOT / "CITATION.cff").read_text(), re.M)
    assert day is not None
    assert newest == f"{bayesdrill.__version__} - {day[1]}"
    sections = set(re.findall(r"^### (.*)$", text, re.M))
    assert sections <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}


@pytest.mark.slow
def test_the_wheel_holds_the_package_and_its_examples_alone(dist: Dist) -> None:
    with zipfile.ZipFile(dist.wheel) as wheel:
        names = wheel.namelist()
    about = f"bayesdrill-{bayesdrill.__version__}.dist-info"
    assert {name.split("/")[0] for name in names} == {"bayesdrill", about}
    files = [path for path in (ROOT / "bayesdrill").rglob("*.*") if path.is_file()]
    own = {path.relative_to(ROOT).as_posix() for path in files if path.suffix != ".pyc"}
    bundled = {f"bayesdrill/examples/{name}" for name in api_files.FILES}
    assert own | bundled | {"bayesdrill/py.typed"} <= {*names}
    assert not [name for name in names if "pycache" in name or "test" in name]
    assert f"{about}/licenses/LICENSE" in names


def test_the_source_holds_what_tests_and_docs_need_and_nothing_that_was_made(dist: Dist) -> None:
    with tarfile.open(dist.sdist) as archive:
        names = [name.split("/", 1)[1] for name in archive.getnames()]
    assert not [n for n in names if re.match(r"(results/.+/|\.venv|dist|\.git/)|.*__pycache__", n)]
    needed = {"Makefile", "requirements.lock", "CITATION.cff", "CHANGELOG.md", "docs/release.md"}
    assert needed | {"tests/support/command_line.py", "configs/records/nominal_step.csv"} <= {
        *names
    }


def test_files_stay_small(dist: Dist) -> None:
    for path in (dist.wheel, dist.sdist):
        assert path.stat().st_size < LARGEST[path.suffix], path.name
