"""No command ever replaces a file that it reads, whatever it is asked for and by whatever name."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support import command_line, finished_runs
from support.case_tables import run_cases
from typer.main import get_command

from bayesdrill import output_files
from bayesdrill.cli import app
from bayesdrill.tasks.identify import MARK

SHEET = "k_s: 0.3\n"
RECORD_IN_OUT = ("file: small.csv", "file: out/{name}")


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig with runs of it that other commands read."""
    place = tmp_path_factory.mktemp("rig")
    config = command_line.small_config(place)
    (place / "sheet.yaml").write_text(SHEET)
    for name, changes in (("posterior_run", ()), ("other", (("seed: 7", "seed: 8"),))):
        ran = finished_runs.posterior(tmp_path_factory, place, name, *changes)
        assert ran.status == 0, ran.text
    ran = command_line.cli("map", config, "-o", place / "map_run", "--processes", "1")
    assert ran.status == 0, ran.text
    return place


def copied(done: Path, tmp_path: Path) -> Path:
    shutil.copytree(done, tmp_path / "rig")
    return tmp_path / "rig"


home = pytest.fixture(copied, name="home")


def read_by(command: str, home: Path) -> Iterator[tuple[list[str | Path], list[Path]]]:
    """A command without its output, and what it reads."""
    run, config = home / "posterior_run", home / "small.yaml"
    of_config = [config, home / "small.csv"]
    files = [path for path in sorted(run.rglob("*")) if path.is_file() and path.name != ".lock"]
    match command:
        case "init":
            yield ["init", home / "small.csv"], [home / "small.csv"]
            sheet = ["init", home / "small.csv", "--sheet", home / "sheet.yaml"]
            yield sheet, [home / "small.csv", home / "sheet.yaml"]
        case "simulate":
            yield ["simulate", config], of_config
        case "export":
            yield ["export", run, "--to", "json"], [*of_config[1:], *files]
        case "check":
            yield ["check", config], of_config
        case "map" | "posterior" | "calibrate" | "ladder" | "identify":
            yield [command, config], of_config
        case "report":
            yield ["report", run], files
            yield ["report", run, home / "other"], files
        case "compare":
            yield ["compare", run, home / "other"], files
        case "paper":
            yield ["paper", home], of_config
        case _:  # these write nothing
            assert command in ("example", "verify", "schema", "cite", "cache"), command


def untouched(home: Path, files: list[Path]) -> Callable[[], None]:
    before = {path: path.read_bytes() for path in files}

    def check() -> None:
        for path, content in before.items():
            assert path.read_bytes() == content, f"{path.relative_to(home)} was replaced"

    return check


@run_cases("command", [*get_command(app).commands], home=copied)  # type: ignore[attr-defined]
def test_an_output_is_never_a_file_that_a_command_reads(
    command: str, done: Path, tmp_path: Path, home: Path
) -> None:
    """By its own name and by another one of it, with --force too."""
    for arguments, files in read_by(command, home):
        kept = untouched(home, files)
        for k, path in enumerate(files):
            hard = home / f"hard_{k}{path.suffix}"
            os.link(path, hard)
            for target in (path, hard, home / "posterior_run" / ".." / path.relative_to(home)):
                option = "--figure" if command == "check" else "--output"
                force = [] if command == "check" else ["--force"]
                ran = command_line.cli(*arguments, option, target, *force)
                assert ran.status == 2, (arguments, target, ran.text)
                kept()
            hard.unlink()


@run_cases(
    "command, names",
    [
        ("map", ["map.csv", "prediction.csv", "report.html", "config.yaml"]),
        (
            "posterior",
            ["summary.csv", "chain.h5", "figures/corner.png", ".pieces/ensemble_1_1.npz"],
        ),
        ("calibrate", ["ranks.csv", ".refits/000001.json", "summary.md"]),
        ("ladder", ["comparison.csv", "recommended.yaml", "model_1/summary.csv"]),
        ("identify", ["figures/spectrum.png", "identify.md"]),
    ],
    home=copied,
)
def test_a_folder_of_results_never_replaces_the_record_of_its_config(
    command: str, names: list[str], done: Path, tmp_path: Path, home: Path
) -> None:
    """A record that bears the name of a result, where an earlier run of that job has left its mark."""
    out = home / "out"
    quick = ("seed: 7\n", "seed: 7\ncalibration: {refits: 10}\n")
    options = ("--processes", "1") if command != "identify" else ()
    out.mkdir()
    mark = {"job": command, "fingerprint": {}, "status": "finished"}
    (out / "run.json").write_text(output_files.dumps_checksummed(mark))
    if command == "identify":
        (out / "run.json").rename(out / "identify.md")
        (out / "identify.md").write_text(MARK)
    for name in names:
        record = out / name
        record.parent.mkdir(exist_ok=True)
        before = record.read_bytes() if record.exists() else None
        record.write_text(command_line.small_record())
        entry = f"file: out/{name}\n  format: csv"
        config = command_line.small_config(
            home, quick, ("file: small.csv", entry), name="quick.yaml"
        )
        kept = untouched(home, [record])
        ran = command_line.cli(command, config, "-o", out, "--force", *options)
        assert ran.status == 2, ran.text
        kept()
        record.unlink()
        if before is not None:
            record.write_bytes(before)


def test_a_figure_of_a_rig_is_never_the_record_itself(tmp_path: Path) -> None:
    config = command_line.small_config(
        tmp_path, ("file: small.csv", "file: small.svg\n  format: csv")
    )
    (tmp_path / "small.svg").write_text(command_line.small_record())
    kept = untouched(tmp_path, [tmp_path / "small.svg"])
    ran = command_line.cli("check", config, "--figure", tmp_path / "small.svg")
    assert ran.status == 2
    assert "never replaced" in ran.err
    kept()
