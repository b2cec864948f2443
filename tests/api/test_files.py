"""The examples are written into a folder: all of them, and over nothing of others."""

from pathlib import Path

import pytest
from support import command_line
from support.case_tables import run_cases

import bayesdrill as bd
from bayesdrill.api import files

CONFIGS = command_line.ROOT / "configs"


def test_the_examples_are_those_of_the_checkout_and_run(tmp_path: Path) -> None:
    folder = tmp_path / "my rig"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    ran = command_line.cli("example", folder)
    assert ran.status == 0
    assert (folder / "notes.txt").read_text() == "mine"
    (folder / "notes.txt").unlink()
    there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert there == {*files.FILES}
    assert all((folder / name).read_bytes() == (CONFIGS / name).read_bytes() for name in there)
    assert f"bayesdrill check '{folder}/nominal_step.yaml'" in ran.out  # as a shell takes it
    assert command_line.cli("check", folder / "nominal_step.yaml").status == 0


def test_every_config_of_the_checkout_is_an_example() -> None:
    """Whoever adds one adds it to the list."""
    named = {CONFIGS / "schema.json", *CONFIGS.glob("example_*.yaml")}
    assert {path.relative_to(CONFIGS).as_posix() for path in named} <= {*files.FILES}


def test_nothing_is_overwritten_and_nothing_written_beside_it(tmp_path: Path) -> None:
    (tmp_path / "records").mkdir()
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "example_rig.yaml").write_text("mine")
    (tmp_path / "records" / "nominal_step.csv").symlink_to("nowhere")
    before = command_line.listing(tmp_path)
    ran = command_line.cli("example", tmp_path)
    assert ran.status == 2
    assert len(ran.err.splitlines()) == 2  # each of them, and a way out
    assert "example_rig.yaml: is there already; move it" in ran.err
    assert command_line.listing(tmp_path) == before


@run_cases("name", ["", "records"])
def test_a_link_or_file_in_the_place_of_a_folder_is_refused(name: str, tmp_path: Path) -> None:
    folder, elsewhere = tmp_path / "here", tmp_path / "elsewhere"
    elsewhere.mkdir()
    if name:
        folder.mkdir()
        (folder / name).symlink_to(elsewhere)
    else:
        folder.write_text("a file")
    ran = command_line.cli("example", folder)
    assert ran.status == 2
    assert "is not a folder" in ran.err
    assert not [*elsewhere.iterdir()]


def test_a_package_without_its_examples_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "PACKAGE", tmp_path / "bayesdrill")
    with pytest.raises(bd.InputError, match="install bayesdrill again"):
        bd.example(tmp_path / "here")
    assert not [*tmp_path.iterdir()]
