"""Files of others in a results folder: none is removed, replaced or written through."""

import stat
from pathlib import Path

import pytest
from support.case_tables import run_cases
from support.command_line import listing, write_results
from support.foreign_files import SPOIL, put

from bayesdrill import output_files
from bayesdrill.basics.errors import InputError
from bayesdrill.output_files import POSTERIOR, RECORD, RUN, Kind, loads_checksummed
from bayesdrill.results.run_folder import Folder, WriteMode

KINDS = [
    *(POSTERIOR, output_files.CALIBRATE, output_files.LADDER),
    *(output_files.MAP, output_files.OVERLAY),
]
MODES: list[WriteMode] = ["fresh", "resume", "force", "report"]
# In a results folder of any kind; a trailing slash: an empty folder.
FOREIGN_FILES = [
    *("notes.md", "mydata.csv", "summary.xlsx", "summary.md.bak", "fit.annotated.png"),
    *("run.json~", "model_1.csv", "summary.old/mine.csv", "chain.h5.old/", "model_x/posterior.nc"),
    *("figures.zip", ".notes.12.aside.md", ".summary.twelve.aside.csv", "sub/.run.12.aside.json"),
    *("figures/photo.jpg", "figures/corner.eps", "figures/corner.png.orig"),
    *("figures/old/corner.png", "figures/.photo.12.aside.jpg", ".pieces/mine.h5"),
    *(".pieces/ensemble_x_1.h5", ".refits/mine.json", ".refits/1.json.bak"),
]


def start_over(folder: Path, kind: Kind = POSTERIOR) -> None:
    """Begin a run with --force."""
    with Folder(folder, "force", {"seed": "2"}, kind) as run:
        run.begin(status="running")


def refused(folder: Path, mode: WriteMode, kind: Kind = POSTERIOR) -> str:
    """Return the message of a refusal; nothing below the parent of `folder` may change."""
    before = listing(folder.parent)
    with pytest.raises(InputError) as caught, Folder(folder, mode, {}, kind):
        pass
    assert listing(folder.parent) == before
    return str(caught.value)


def test_a_record_that_was_saved_with_its_run_outlives_it(tmp_path: Path) -> None:
    """Its config may be started over from this very folder: the record is in no other place."""
    out = write_results(tmp_path / "out", POSTERIOR)
    put(out, RECORD, "t,w_1")
    put(out, ".record.12.aside.csv", "left by a run that was killed")
    start_over(out)
    assert (out / RECORD).read_text() == "t,w_1"
    assert not (out / ".record.12.aside.csv").exists()


@run_cases("kind", KINDS)
def test_force_takes_what_such_a_run_writes_and_nothing_else(kind: Kind, tmp_path: Path) -> None:
    out = write_results(tmp_path / "out", kind)
    for name in FOREIGN_FILES:
        put(out, name)
    put(out, ".run.12.aside.json", "left by a run that was killed")
    before = listing(out)
    with Folder(out, "force", {"seed": "2"}, kind) as folder:
        assert listing(out) == before
        folder.begin(status="running")
    after = listing(out)
    kept = {name for name in FOREIGN_FILES if not name.endswith("/")} | {".lock", RUN}
    assert {name for name in after if not (out / name).is_dir()} == kept
    assert (out / "chain.h5.old").is_dir()
    assert all(after[name] == before[name] for name in kept - {RUN})
    run = loads_checksummed((out / RUN).read_bytes())
    marks = (run["status"], run["job"], run["fingerprint"])
    assert marks == ("running", kind.job, {"seed": "2"})


def test_run_json_is_there_all_the_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = write_results(tmp_path / "out", POSTERIOR)
    listings, write = [], Folder.write_text

    def list_and_write(folder: Folder, name: str, text: str) -> None:
        listings.append(sorted(path.name for path in out.iterdir()))
        write(folder, name, text)

    monkeypatch.setattr(Folder, "write_text", list_and_write)
    start_over(out)
    assert listings == [[".lock", RUN]]


FOREIGN_RUNS = [
    *('{"status": "finished"}', '{"job": "posterior", "fingerprint": {}}', "{}", "[]", "", "x")
]


@run_cases("mode, text", [(mode, text) for mode in MODES for text in FOREIGN_RUNS])
def test_a_run_json_of_others_gives_no_right_to_a_folder(
    mode: WriteMode, text: str, tmp_path: Path
) -> None:
    put(tmp_path / "out", RUN, text)
    put(tmp_path / "out", "summary.csv")
    message = refused(tmp_path / "out", mode)
    assert "not of this bayesdrill" in message
    assert "--force" not in message


@run_cases("mode, kind", [(mode, kind) for mode in MODES for kind in KINDS])
def test_results_of_another_command_are_left_alone(
    mode: WriteMode, kind: Kind, tmp_path: Path
) -> None:
    other = KINDS[KINDS.index(kind) - 1]
    message = refused(write_results(tmp_path / "out", other), mode, kind)
    assert f"results of `bayesdrill {other.job}`" in message
    assert "--force" not in message


@run_cases(
    "mode, name, spoil, what",
    [
        (mode, *case)
        for mode in MODES
        for case in [
            *((n, "linked", "a link") for n in ("figures", ".pieces", "summary.csv", "chain.h5")),
            *((n, "linked", "a link") for n in (RUN, ".lock", "figures/corner.pdf")),
            ("map.json", "dangling", "a link"),
            *((n, "folder", "a folder") for n in ("chain.h5", "summary.md", RUN)),
            *((n, "pipe", "a device or pipe") for n in ("config.yaml", RUN)),
            ("figures", "file", "a file"),
        ]
    ],
)
def test_what_no_run_can_have_written_is_named_first(
    mode: WriteMode, name: str, spoil: str, what: str, tmp_path: Path
) -> None:
    out = write_results(tmp_path / "results" / "out", POSTERIOR)
    SPOIL[spoil](out / name)
    message = refused(out, mode)
    assert f"{name}: {what}, " in message
    assert "--output" in message


def test_hidden_files_of_others_that_bear_our_names_are_left_alone(tmp_path: Path) -> None:
    put(tmp_path / "out", ".pieces/ensemble_0_000000000.h5")
    assert "holds other files" in refused(tmp_path / "out", "fresh")


def test_a_folder_behind_a_link_is_a_folder(tmp_path: Path) -> None:
    """As one whose results lie on another disk; the user named it."""
    write_results(tmp_path / "disk", POSTERIOR)
    (tmp_path / "out").symlink_to("disk")
    start_over(tmp_path / "out")
    assert {*listing(tmp_path / "disk")} == {".lock", RUN}


def test_a_file_that_would_not_be_known_again_is_not_written(tmp_path: Path) -> None:
    with Folder(tmp_path / "out", "fresh", {}, POSTERIOR) as folder, pytest.raises(KeyError):
        folder.write_text("summary.txt", "")


def test_a_replaced_file_keeps_its_mode_bits(tmp_path: Path) -> None:
    """Also where --force takes it away first."""
    out = write_results(tmp_path / "out", POSTERIOR)
    (out / RUN).chmod(0o640)
    (out / "summary.csv").chmod(0o600)
    modes: tuple[WriteMode, ...] = ("report", "force")
    for mode in modes:
        with Folder(out, mode, {}, POSTERIOR) as folder:
            folder.begin(status="running")
            folder.write_text("summary.csv", "ours")
        bits = [stat.S_IMODE((out / name).stat().st_mode) for name in (RUN, "summary.csv")]
        assert bits == [0o640, 0o600]
