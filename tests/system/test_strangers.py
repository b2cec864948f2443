"""The command line let loose where files of others lie: they stay as they are, byte for byte."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from support import command_line
from support.case_tables import run_cases
from support.command_line import cli, listing

from bayesdrill import output_files
from bayesdrill.basics.errors import InputError
from bayesdrill.config.records import simulation
from bayesdrill.output_files import POSTERIOR


def refused(*arguments: str | Path, below: Path, says: str) -> None:
    """Status 2 in one line that holds `says`; nothing below `below` changes."""
    before = listing(below)
    ran = cli(*arguments)
    assert ran.status == 2, ran.text
    assert says in ran.err
    assert len(ran.err.splitlines()) == 1
    assert listing(below) == before


def write(folder: Path, name: str, text: str = "mine") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


# --- folders of results --------------------------------------------------------------------------


@run_cases("option", ["", "--force", "--resume"])
def test_a_folder_is_known_by_more_than_the_name_of_a_file_in_it(
    option: str, tmp_path: Path
) -> None:
    config = command_line.small_config(tmp_path / "rig")
    for name in ("run.json", "summary.csv", "figures/corner.pdf"):
        write(tmp_path / "out", name, '{"status": "finished"}')
    for command in ("posterior", "calibrate"):
        told = [command, config, "-o", tmp_path / "out", *option.split()]
        refused(*told, below=tmp_path, says="run.json: is damaged, or not of this bayesdrill")
    refused("report", tmp_path / "out", below=tmp_path, says="run.json: is damaged")


@run_cases("option", ["", "--force", "--resume"])
def test_a_calibration_and_a_posterior_do_not_mix(option: str, tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path / "rig")
    for command, kind in (("posterior", output_files.CALIBRATE), ("calibrate", POSTERIOR)):
        folder = command_line.write_results(tmp_path / kind.job, kind)
        says = f"these are results of `bayesdrill {kind.job}`; give another --output"
        refused(command, config, "-o", folder, *option.split(), below=tmp_path, says=says)


# --- identify ------------------------------------------------------------------------------------


def test_identify_overwrites_its_own_files_when_told_to(tmp_path: Path) -> None:
    config, out = command_line.small_config(tmp_path), tmp_path / "out"
    command = ("identify", config, "-o", out)
    write(out, "notes.md")
    assert cli(*command, "--profile", "k_e").status == 0
    written = {name for name in listing(out) if (out / name).is_file()}
    drawn = output_files.figure_files("spectrum", "profiles")
    assert written == {"notes.md", "identify.md", *drawn}
    first = (out / "identify.md").read_bytes()
    refused(*command, below=tmp_path, says="exists already; give --force")
    write(out, "figures/photo.jpg")
    assert cli(*command, "--force").status == 0
    left = {name for name in listing(out) if (out / name).is_file()}
    assert left == written - set(output_files.figure_files("profiles")) | {"figures/photo.jpg"}
    assert (out / "identify.md").read_bytes() != first


@run_cases("option", ["", "--force"])
@run_cases("name", ["identify.md", "figures/spectrum.png", "figures/profiles.pdf"])
def test_identify_leaves_what_it_has_not_made(name: str, option: str, tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path)
    write(tmp_path / "out", name)
    says = "was not written by" if option else f"{name}: exists already"
    command = ("identify", config, "-o", tmp_path / "out", *option.split())
    refused(*command, below=tmp_path, says=says)


@run_cases("option", ["", "--force"])
def test_identify_writes_through_no_link(option: str, tmp_path: Path) -> None:
    config, out = command_line.small_config(tmp_path), tmp_path / "out"
    (tmp_path / "pictures").mkdir()
    out.mkdir()
    (out / "figures").symlink_to("../pictures")
    refused("identify", config, "-o", out, *option.split(), below=tmp_path, says="a link, ")
    mine = write(tmp_path, "mine")
    refused("identify", config, "-o", mine, *option.split(), below=tmp_path, says="in the way")


# --- simulate ------------------------------------------------------------------------------------


def test_simulate_repeats_itself_and_overwrites_another_simulation_when_told_to(
    tmp_path: Path,
) -> None:
    config, other = command_line.small_config(tmp_path), tmp_path / "other.csv"
    record = (tmp_path / "small.csv").read_bytes()
    assert cli("simulate", config, "-o", other).status == 0
    assert other.read_bytes() == record
    command = ("simulate", config, "-o", other, "--seed", "8")
    refused(*command, below=tmp_path, says="other.csv: exists already; give --force")
    assert cli(*command, "--force").status == 0
    assert other.read_bytes() != record
    (tmp_path / "small.csv").unlink()
    assert cli("simulate", config).status == 0
    assert (tmp_path / "small.csv").read_bytes() == record


@run_cases("option", ["", "--force"])
@run_cases("given", [None, "small.csv", "../rig/small.csv", "hard.csv"])
def test_simulate_never_overwrites_the_record_that_a_config_names(
    given: str | None, option: str, tmp_path: Path
) -> None:
    config = command_line.small_config(tmp_path / "rig")
    os.link(tmp_path / "rig" / "small.csv", tmp_path / "rig" / "hard.csv")
    output = [] if given is None else ["-o", tmp_path / "rig" / given]
    command = ("simulate", config, *output, *option.split())
    refused(*command, below=tmp_path, says="or named by its config, and never replaced")


@run_cases("force", [False, True])
@run_cases("name", ["thesis.tex", "longer", "empty", "pipe", "link", "folder"])
def test_simulate_replaces_nothing_but_a_record(name: str, force: bool, tmp_path: Path) -> None:
    write(tmp_path, "thesis.tex", "t,theta")
    write(tmp_path, "longer", "t,theta_1,w_1\n0,0,0\n")
    write(tmp_path, "empty", "")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("thesis.tex")
    (tmp_path / "folder").mkdir()
    never = {"pipe": "a device or pipe, ", "link": "a link, ", "folder": "a folder, "}
    says = never.get(name, "is no record with these columns" if force else "exists already")
    before = listing(tmp_path)
    with pytest.raises(InputError, match=says):
        simulation.check_target(
            "t,theta_1\n0,0\n", tmp_path / name, [tmp_path / "none.csv"], force=force
        )
    assert listing(tmp_path) == before
