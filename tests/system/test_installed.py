"""What is released works where no checkout is: on each Python that is here, and as an image runs it."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

import pytest
from support import command_line, release_builds
from support.release_builds import PINNED, Dist, Installed

import bayesdrill

ROOT = command_line.ROOT
PYTHONS = ("3.12", "3.13", "3.14", "3.15")


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Dist:
    return release_builds.build(tmp_path_factory.mktemp("release"))


@pytest.mark.slow
@pytest.mark.parametrize("version", PYTHONS)
def test_the_wheel_works_where_no_checkout_is(version: str, dist: Dist, tmp_path: Path) -> None:
    """On each Python that is here: installed with pinned versions, then what a newcomer types."""
    at = release_builds.empty(version, tmp_path)
    release_builds.reach_packages(at)
    at.run("pip", "install", "-q", "--constraint", PINNED, dist.wheel)
    at.run("pip", "check")
    number = f"bayesdrill {bayesdrill.__version__}\n"
    assert at.run("bayesdrill", "--version") == number
    assert at.run("python", "-m", "bayesdrill", "--version") == number
    _brings_what_it_says(at)
    _begins(at)
    assert "bayesdrill" in at.run("bayesdrill", "cite")


def _brings_what_it_says(at: Installed) -> None:
    script = """
        import importlib.util, pathlib, bayesdrill as bd
        place = pathlib.Path(bd.__file__).parent
        assert "site-packages" in place.parts, place
        assert (place / "py.typed").is_file()
        assert not (place / "examples" / "paper").exists() and not importlib.util.find_spec("studies")
        for name in bd.__all__:
            getattr(bd, name)
    """
    at.run("python", "-c", "\n".join(line[8:] for line in script.splitlines()))


def _begins(at: Installed) -> None:
    """Examples, a record, and a posterior of it, which all belong together."""
    at.run("bayesdrill", "example")
    at.run("bayesdrill", "check", "configs/example_rig.yaml")
    assert "determine" in at.run("bayesdrill", "identify", "configs/nominal_step.yaml")
    (at.folder / "small.yaml").write_text(command_line.SMALL)
    at.run("bayesdrill", "simulate", "small.yaml")
    at.run("bayesdrill", "posterior", "small.yaml")
    assert (at.folder / "results" / "small" / "summary.md").is_file()
    assert "belong together" in at.run("bayesdrill", "verify", "results/small")
    script = "import bayesdrill as bd; print(bd.load('configs/nominal_step.yaml').preview())"
    assert "unknown: " in at.run("python", "-c", script)


@pytest.mark.slow
def test_the_source_installs_as_the_wheel_does(dist: Dist, tmp_path: Path) -> None:
    """File by file; it says its version without any other package."""
    found = []
    for archive in (dist.wheel, dist.sdist):
        at = release_builds.empty(
            f"{sys.version_info[0]}.{sys.version_info[1]}", tmp_path / archive.suffix
        )
        release_builds.reach_packages(at)
        at.run("pip", "install", "-q", "--no-deps", "--no-compile", archive)
        (place,) = (at.bin.parent / "lib").glob("python*/site-packages")
        record = next(place.glob("bayesdrill-*.dist-info")) / "RECORD"
        lines = record.read_text().splitlines()
        found.append({line for line in lines if line.startswith("bayesdrill/")})
    assert found[0] == found[1]


def instructions() -> list[tuple[str, str]]:
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    return [tuple(line.split(" ", 1)) for line in lines if line and not line.startswith("#")]


def test_the_image_is_of_what_it_is_given_and_not_of_root() -> None:
    """No Docker is asked: instructions that are known, files that are there and not ignored."""
    found = instructions()
    known = {"FROM", "WORKDIR", "COPY", "RUN", "ENV", "USER", "ENTRYPOINT", "CMD"}
    assert {name for name, _ in found} <= known
    assert all(
        re.match(r"python:3\.\d+-slim( AS \w+)?$", what) for name, what in found if name == "FROM"
    )
    (user,) = [what for name, what in found if name == "USER"]
    assert user == "bayesdrill"
    assert any(
        name == "RUN" and what.startswith(f"useradd --create-home {user} ") for name, what in found
    )
    assert ("ENTRYPOINT", '["bayesdrill"]') in found
    lines = (ROOT / ".dockerignore").read_text().splitlines()
    given = [line[1:] for line in lines if line.startswith("!")]
    assert lines[1] == "*"
    assert all((ROOT / name).exists() for name in given)
    assert {"pyproject.toml", "requirements.lock", "bayesdrill", "configs"} <= {*given}


@pytest.mark.slow
def test_what_the_image_runs_runs_by_hand(dist: Dist, tmp_path: Path) -> None:
    """Its pip and python lines, one after the other, of the files that it is given alone."""
    version = re.search(r"python:(3\.\d+)", instructions()[0][1]).group(1)
    at = release_builds.empty(version, tmp_path)
    release_builds.reach_packages(at)
    source, wheel = at.folder / "source", at.folder / "wheel"
    for line in (ROOT / ".dockerignore").read_text().splitlines():
        if line.startswith("!"):
            of, to = dist.tree / line[1:], source / line[1:]
            to.parent.mkdir(exist_ok=True)
            shutil.copytree(of, to) if of.is_dir() else shutil.copy(of, to)
    ran = 0
    for name, what in instructions():
        if name == "RUN" and not what.startswith("useradd"):
            if "/wheel/requirements.lock" in what:
                shutil.copy(source / "requirements.lock", wheel)
            here = what.replace("/wheel", str(wheel))
            at.run(Path("/bin/sh"), "-c", f"cd {source} && {here}")
            ran += 1
    assert ran == 3
    shutil.rmtree(source)
    assert at.run("bayesdrill", "--help").count("posterior") > 0
    at.run("bayesdrill", "example")
    at.run("bayesdrill", "check", "configs/nominal_step.yaml")
