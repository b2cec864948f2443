"""No command replaces a file that it reads, or one of others, under whatever name it is given."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support import command_line, finished_runs
from support.case_tables import run_cases
from support.command_line import assert_refused_unchanged, cli, listing
from support.finished_runs import copied
from typer.main import get_command

from bayesdrill import output_files
from bayesdrill.cli import app


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig with runs of it that other commands read, not to be changed."""
    place = tmp_path_factory.mktemp("rig")
    config = command_line.small_config(place)
    (place / "sheet.yaml").write_text("k_s: 0.3\n")
    (place / "many.yaml").write_text("name: many\nbase: small.yaml\nruns: [{file: small.csv}]\n")
    for name, changes in (("posterior_run", ()), ("other", (("seed: 7", "seed: 8"),))):
        result = finished_runs.posterior(tmp_path_factory, place, name, *changes)
        assert result.status == 0, result.text
    result = cli("map", config, "-o", place / "map_run", "--processes", "1")
    assert result.status == 0, result.text
    return place


def commands_and_inputs(command: str, home: Path) -> Iterator[tuple[list[str | Path], list[Path]]]:
    """Yield the command without its output, and the files that it reads."""
    run, config, record = home / "posterior_run", home / "small.yaml", home / "small.csv"
    files = [path for path in sorted(run.rglob("*")) if path.is_file() and path.name != ".lock"]
    match command:
        case "init":
            sheet = home / "sheet.yaml"
            yield ["init", record], [record]
            yield ["init", record, "--sheet", sheet], [record, sheet]
        case "export":
            yield ["export", run, "--to", "json"], [record, *files[::4]]
        case (
            "check"
            | "simulate"
            | "map"
            | "posterior"
            | "calibrate"
            | "ladder"
            | "identify"
            | "design"
        ):
            yield [command, config], [config, record]
        case "campaign" | "watch":
            yield [command, home / "many.yaml"], [home / "many.yaml", config, record]
        case "report":
            yield ["report", run], files[3::4]
            yield ["report", run, home / "other"], files[1::4]
        case "compare":
            yield ["compare", run, home / "other"], files[2::4]
        case "paper":
            yield ["paper", home], [config, record]
        case _:  # these write nothing
            assert command in ("example", "verify", "schema", "cite", "cache"), command


def unchanged(home: Path, files: list[Path]) -> Callable[[], None]:
    """Return a check that the files have the bytes that they have now."""
    before = {path: path.read_bytes() for path in files}

    def check() -> None:
        for path, content in before.items():
            assert path.read_bytes() == content, f"{path.relative_to(home)} was replaced"

    return check


@run_cases("command", [*get_command(app).commands], home=copied)  # type: ignore[attr-defined]
def test_an_output_is_never_a_file_that_a_command_reads(command: str, home: Path) -> None:
    """By its own name and by another one of it, with --force too."""
    option = {"check": ["--figure"], "watch": ["--output"]}.get(command, ["--force", "--output"])
    for arguments, files in commands_and_inputs(command, home):
        check = unchanged(home, files)
        for k, path in enumerate(files):
            hard = home / f"hard_{k}{path.suffix}"
            os.link(path, hard)
            roundabout = home / "posterior_run" / ".." / path.relative_to(home)
            for target in (path, hard, roundabout)[: 3 if k == 0 else 2]:
                result = cli(*arguments, *option, target)
                assert result.status == 2, (arguments, target, result.text)
                check()
            hard.unlink()


@run_cases(
    "command, names",
    [
        ("map", ["map.csv", "prediction.csv", "report.html", "config.yaml"]),
        ("posterior", ["summary.csv", "chain.h5", "figures/corner.png", ".pieces/ensemble_1_1.h5"]),
        ("calibrate", ["ranks.csv", ".refits/000001.json", "summary.md"]),
        ("ladder", ["comparison.csv", "recommended.yaml", "model_1/summary.csv"]),
        ("identify", ["figures/spectrum.png", "identify.md"]),
    ],
    home=copied,
)
def test_results_never_replace_a_record_that_has_the_name_of_a_result(
    command: str, names: list[str], home: Path
) -> None:
    """In a folder where an earlier run of that command has left its mark."""
    out = home / "out"
    options = ("--processes", "1") if command != "identify" else ()
    out.mkdir()
    mark = {"job": command, "fingerprint": {}, "status": "finished"}
    (out / "run.json").write_text(output_files.dumps_checksummed(mark))
    if command == "identify":
        (out / "run.json").rename(out / "identify.md")
        mark = output_files.text_mark(output_files.IDENTIFY)
        (out / "identify.md").write_text(mark)
    few_refits = ("seed: 7\n", "seed: 7\ncalibration: {refits: 10}\n")
    for name in names:
        record = out / name
        record.parent.mkdir(exist_ok=True)
        before = record.read_bytes() if record.exists() else None
        record.write_text(command_line.small_record())
        entry = ("file: small.csv", f"file: out/{name}\n  format: csv")
        config = command_line.small_config(home, few_refits, entry, name="quick.yaml")
        check = unchanged(home, [record])
        result = cli(command, config, "-o", out, "--force", *options)
        assert result.status == 2, result.text
        check()
        record.unlink()
        if before is not None:
            record.write_bytes(before)


def write(folder: Path, name: str, text: str = "mine") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_identify_overwrites_its_own_files_with_force_only(tmp_path: Path) -> None:
    config, out = command_line.small_config(tmp_path), tmp_path / "out"
    command = ("identify", config, "-o", out)
    write(out, "notes.md")
    assert cli(*command, "--profile", "k_e").status == 0
    written = {name for name in listing(out) if (out / name).is_file()}
    figures = output_files.figure_files("spectrum", "profiles")
    assert written == {"notes.md", "identify.md", *figures}
    first = (out / "identify.md").read_bytes()
    assert_refused_unchanged(tmp_path, "exists already; give --force", *command)
    write(out, "figures/photo.jpg")
    assert cli(*command, "--force").status == 0
    left = {name for name in listing(out) if (out / name).is_file()}
    assert left == written - set(output_files.figure_files("profiles")) | {"figures/photo.jpg"}
    assert (out / "identify.md").read_bytes() != first


@run_cases("option", ["", "--force"])
def test_identify_replaces_no_file_of_others_and_writes_through_no_link(
    option: str, tmp_path: Path
) -> None:
    config = command_line.small_config(tmp_path)
    for name in ("identify.md", "figures/spectrum.png", "figures/profiles.pdf"):
        write(tmp_path / name, name)
        message = "was not written by" if option else f"{name}: exists already"
        command = ("identify", config, "-o", tmp_path / name, *option.split())
        assert_refused_unchanged(tmp_path, message, *command)
    (tmp_path / "pictures").mkdir()
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / "figures").symlink_to("../pictures")
    for target, message in (
        (tmp_path / "linked", "a link, "),
        (write(tmp_path, "mine"), "in the way"),
    ):
        command = ("identify", config, "-o", target, *option.split())
        assert_refused_unchanged(tmp_path, message, *command)
