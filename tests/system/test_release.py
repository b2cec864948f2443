"""A release: one version, the files of `dist/`, and what they do where no checkout is."""

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from dataclasses import dataclass
from pathlib import Path

import pytest
from support import command_line

import bayesdrill
from bayesdrill.api import files as api_files

ROOT = command_line.ROOT
LARGEST = {".whl": 1_200_000, ".gz": 4_000_000}  # bytes
# What work in a checkout leaves there.
MADE = (".venv", ".venv-bench", ".git", "results", "dist", ".hypothesis")
PINNED = ROOT / "requirements.lock"


@dataclass(frozen=True)
class Dist:
    """`tree`: the copy that the two files are made of."""

    tree: Path
    wheel: Path
    sdist: Path


def build(folder: Path) -> Dist:
    """As `make dist` does, of a checkout in which work was done."""
    tree = folder / "bayesdrill"
    shutil.copytree(ROOT, tree, ignore=_made)
    for name in (
        "results/mine/chain.h5",
        "results/published/run/report.html",
        ".venv/pyvenv.cfg",
        "bayesdrill/__pycache__/cli.pyc",
    ):
        (tree / name).parent.mkdir(parents=True)
        (tree / name).write_text("not to be released")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", "dist"]
    done = subprocess.run(command, cwd=tree, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (wheel,), (sdist,) = (tree / "dist").glob("*.whl"), (tree / "dist").glob("*.tar.gz")
    return Dist(tree, wheel, sdist)


def _made(folder: str, names: list[str]) -> set[str]:
    top = MADE if Path(folder) == ROOT else ()
    return {name for name in names if name in (*top, "__pycache__") or name.endswith("_cache")}


def interpreter(version: str) -> str | None:
    """One of this version that runs: on PATH, or of pyenv."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    places = [
        shutil.which(f"python{version}"),
        *sorted(map(str, pyenv.glob(f"{version}.*/bin/python"))),
    ]
    for place in places:
        if place is not None:
            ask = [place, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
            told = subprocess.run(ask, capture_output=True, text=True, check=False)
            if told.stdout.strip() == version:
                return place
    return None


@dataclass(frozen=True)
class Installed:
    """An environment with bayesdrill and what it needs, and a folder that is no checkout."""

    bin: Path
    folder: Path

    def run(self, *command: str | Path, status: int = 0) -> str:
        clean = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
        done = subprocess.run(
            [self.bin / command[0], *command[1:]],
            cwd=self.folder,
            env={**clean, "PATH": f"{self.bin}{os.pathsep}{os.defpath}", "MPLBACKEND": "agg"},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == status, f"{command}\n{done.stdout}\n{done.stderr}"
        assert "Traceback" not in done.stderr
        return done.stdout


def empty(version: str, folder: Path) -> Installed:
    """An environment of nothing but pip."""
    python = interpreter(version)
    if python is None:
        pytest.skip(f"there is no Python {version} here")
    (folder / "work").mkdir(parents=True)
    subprocess.run([python, "-m", "venv", folder / "venv"], check=True, capture_output=True)
    return Installed(folder / "venv" / "bin", folder / "work")


def reach_packages(at: Installed) -> None:
    """Skips where pip finds no packages at all; what is wrong after that is wrong with ours."""
    pin = PINNED.read_text().splitlines()[0]
    probe = [at.bin / "pip", "download", "-q", "--no-deps", "-d", at.folder.parent / "probe", pin]
    done = subprocess.run(probe, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"pip finds no packages here: {done.stderr.strip().splitlines()[-1]}")


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Dist:
    return build(tmp_path_factory.mktemp("release"))


def test_the_version_stands_in_one_place() -> None:
    number = bayesdrill.__version__
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert project["project"]["dynamic"] == ["version"]
    assert project["tool"]["hatch"]["version"]["path"] == "bayesdrill/__init__.py"
    code = (
        path for path in (ROOT / "bayesdrill").rglob("*.py") if f'"{number}"' in path.read_text()
    )
    assert [path.relative_to(ROOT).as_posix() for path in code] == ["bayesdrill/__init__.py"]


def test_the_changelog_has_this_version() -> None:
    """With headings as in `keep a changelog`, and the date of the citation."""
    text = (ROOT / "CHANGELOG.md").read_text()
    first, newest, *_ = re.findall(r"^## (.*)$", text, re.M)
    assert first == "Unreleased"
    day = re.search(r"^date-released: '(.*)'$", (ROOT / "CITATION.cff").read_text(), re.M)
    assert day is not None
    assert newest == f"{bayesdrill.__version__} - {day[1]}"
    sections = set(re.findall(r"^### (.*)$", text, re.M))
    assert sections <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}


@pytest.mark.slow
def test_the_sdist_holds_what_tests_and_docs_need_and_no_results(dist: Dist) -> None:
    for path in (dist.wheel, dist.sdist):
        assert path.stat().st_size < LARGEST[path.suffix], path.name
    with tarfile.open(dist.sdist) as archive:
        names = [name.split("/", 1)[1] for name in archive.getnames()]
    assert not [n for n in names if re.match(r"(results/.+/|\.venv|dist|\.git/)|.*__pycache__", n)]
    needed = {"Makefile", "requirements.lock", "CITATION.cff", "CHANGELOG.md", "docs/release.md"}
    assert needed | {"tests/support/command_line.py", "configs/records/nominal_step.csv"} <= {
        *names
    }


PYTHONS = ("3.12", "3.13", "3.14", "3.15")


@pytest.mark.slow
@pytest.mark.parametrize("version", PYTHONS)
def test_the_wheel_works_where_no_checkout_is(version: str, dist: Dist, tmp_path: Path) -> None:
    """On each Python that is here, with pinned versions: the first commands of a newcomer."""
    at = empty(version, tmp_path)
    reach_packages(at)
    at.run("pip", "install", "-q", "--constraint", PINNED, dist.wheel)
    at.run("pip", "check")
    number = f"bayesdrill {bayesdrill.__version__}\n"
    assert at.run("bayesdrill", "--version") == number
    assert at.run("python", "-m", "bayesdrill", "--version") == number
    assert_complete(at)
    assert_runs(at)
    assert "bayesdrill" in at.run("bayesdrill", "cite")


def assert_complete(at: Installed) -> None:
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


def assert_runs(at: Installed) -> None:
    """Examples, a simulated record, and a posterior of it that passes `verify`."""
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


def instructions() -> list[tuple[str, str]]:
    """Return names and arguments of the Dockerfile's instructions."""
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    return [tuple(line.split(" ", 1)) for line in lines if line and not line.startswith("#")]


def test_the_dockerfile_copies_files_that_are_there_and_runs_as_a_user() -> None:
    """Checked without Docker."""
    listed = instructions()
    known = {"FROM", "WORKDIR", "COPY", "RUN", "ENV", "USER", "ENTRYPOINT", "CMD"}
    assert {name for name, _ in listed} <= known
    assert all(
        re.match(r"python:3\.\d+-slim( AS \w+)?$", what) for name, what in listed if name == "FROM"
    )
    (user,) = [what for name, what in listed if name == "USER"]
    assert user == "bayesdrill"
    assert any(
        name == "RUN" and what.startswith(f"useradd --create-home {user} ") for name, what in listed
    )
    assert ("ENTRYPOINT", '["bayesdrill"]') in listed
    lines = (ROOT / ".dockerignore").read_text().splitlines()
    given = [line[1:] for line in lines if line.startswith("!")]
    assert lines[1] == "*"
    assert all((ROOT / name).exists() for name in given)
    assert {"pyproject.toml", "requirements.lock", "bayesdrill", "configs"} <= {*given}


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


@pytest.mark.slow
def test_the_commands_of_the_dockerfile_run_by_hand(dist: Dist, tmp_path: Path) -> None:
    """One after the other, with no other files than those that the image gets."""
    version = re.search(r"python:(3\.\d+)", instructions()[0][1]).group(1)
    at = empty(version, tmp_path)
    reach_packages(at)
    source, wheel = at.folder / "source", at.folder / "wheel"
    for line in (ROOT / ".dockerignore").read_text().splitlines():
        if line.startswith("!"):
            of, to = dist.tree / line[1:], source / line[1:]
            to.parent.mkdir(exist_ok=True)
            shutil.copytree(of, to) if of.is_dir() else shutil.copy(of, to)
    count = 0
    for name, what in instructions():
        if name == "RUN" and not what.startswith("useradd"):
            if "/wheel/requirements.lock" in what:
                shutil.copy(source / "requirements.lock", wheel)
            here = what.replace("/wheel", str(wheel))
            at.run(Path("/bin/sh"), "-c", f"cd {source} && {here}")
            count += 1
    assert count == 3
    shutil.rmtree(source)
    assert at.run("bayesdrill", "--help").count("posterior") > 0
    at.run("bayesdrill", "example")
    at.run("bayesdrill", "check", "configs/nominal_step.yaml")
