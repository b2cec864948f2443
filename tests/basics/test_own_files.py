"""Files of others in a results folder: none is removed, replaced or written through."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases
from support.command_line import cli, listing, small_config, write_results

from bayesdrill import output_files
from bayesdrill.basics.errors import InputError
from bayesdrill.output_files import (
    POSTERIOR,
    RECORD,
    RUN,
    Kind,
    atomic_write,
    dumps_checksummed,
    loads_checksummed,
)
from bayesdrill.results.run_folder import Folder, WriteMode

KINDS = [
    *(POSTERIOR, output_files.CALIBRATE, output_files.LADDER),
    *(output_files.MAP, output_files.OVERLAY),
]
# In a results folder of any kind; a trailing slash: an empty folder.
STRANGERS = [
    *("notes.md", "mydata.csv", "summary.xlsx", "summary.md.bak", "fit.annotated.png"),
    *(
        "run.json~",
        "model_1.csv",
        "summary.old/mine.csv",
        "chain.h5.old/",
        "model_x/posterior.nc",
    ),
    *("figures.zip", ".notes.12.aside.md", ".summary.twelve.aside.csv", "sub/.run.12.aside.json"),
    *("figures/photo.jpg", "figures/corner.eps", "figures/corner.png.orig"),
    *("figures/old/corner.png", "figures/.photo.12.aside.jpg", ".pieces/mine.npz"),
    *(".pieces/ensemble_x_1.npz", ".refits/mine.json", ".refits/1.json.bak"),
]


def put(folder: Path, name: str, text: str = "mine") -> None:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    if name.endswith("/"):
        path.mkdir()
    else:
        path.write_text(text)


def test_a_record_that_was_saved_with_its_run_outlives_it(tmp_path: Path) -> None:
    """Its config may be started over from this very folder: the record is in no other place."""
    out = write_results(tmp_path / "out", POSTERIOR)
    with Folder(out, "force", {"seed": "1"}, POSTERIOR) as folder:
        folder.begin(status="running")
        folder.write_text(RECORD, "t,w_1")
    put(out, ".record.12.aside.csv", "left by a run that was killed")
    with Folder(out, "force", {"seed": "2"}, POSTERIOR) as folder:
        folder.begin(status="running")
    assert (out / RECORD).read_text() == "t,w_1"
    assert not (out / ".record.12.aside.csv").exists()


@run_cases("kind", KINDS)
def test_force_takes_what_such_a_run_writes_and_nothing_else(kind: Kind, tmp_path: Path) -> None:
    """Mutants killed: names by pattern; a folder removed whole."""
    out = write_results(tmp_path / "out", kind)
    for name in STRANGERS:
        put(out, name)
    put(out, ".run.12.aside.json", "left by a run that was killed")
    before = listing(out)
    with Folder(out, "force", {"seed": "2"}, kind) as folder:
        assert listing(out) == before
        folder.begin(status="running")
    after = listing(out)
    left = {name for name in after if not (out / name).is_dir()}
    kept = {name for name in STRANGERS if not name.endswith("/")} | {".lock", RUN}
    assert left == kept
    assert (out / "chain.h5.old").is_dir()
    assert all(after[name] == before[name] for name in kept - {RUN})
    run = loads_checksummed((out / RUN).read_bytes())
    assert (run["status"], run["job"], run["fingerprint"]) == (
        "running",
        kind.job,
        {"seed": "2"},
    )


def test_run_json_is_there_all_the_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Mutant killed: run.json removed while the folder is cleared, in which a kill may fall."""
    out = write_results(tmp_path / "out", POSTERIOR)
    seen = []
    write = Folder.write_text

    def seeing(folder: Folder, name: str, text: str) -> None:
        seen.append(sorted(path.name for path in out.iterdir()))
        write(folder, name, text)

    monkeypatch.setattr(Folder, "write_text", seeing)
    with Folder(out, "force", {"seed": "2"}, POSTERIOR) as folder:
        folder.begin(status="running")
    assert seen == [[".lock", RUN]]


MODES: list[WriteMode] = ["fresh", "resume", "force", "report"]


def refused(folder: Path, mode: WriteMode, kind: Kind = POSTERIOR) -> str:
    """What is said; nothing below the parent of `folder` may change."""
    before = listing(folder.parent)
    with pytest.raises(InputError) as caught, Folder(folder, mode, {}, kind):
        pass
    assert listing(folder.parent) == before
    return str(caught.value)


FOREIGN = ['{"status": "finished"}', '{"job": "posterior", "fingerprint": {}}', "{}", "[]", "", "x"]


@run_cases("mode, text", [(mode, text) for mode in MODES for text in FOREIGN])
def test_a_run_json_of_others_gives_no_right_to_a_folder(
    mode: WriteMode, text: str, tmp_path: Path
) -> None:
    put(tmp_path / "out", RUN, text)
    put(tmp_path / "out", "summary.csv")
    said = refused(tmp_path / "out", mode)
    assert "not of this bayesdrill" in said
    assert "--force" not in said


@run_cases("mode, kind", [(mode, kind) for mode in MODES for kind in KINDS])
def test_results_of_another_command_are_left_alone(
    mode: WriteMode, kind: Kind, tmp_path: Path
) -> None:
    other = KINDS[KINDS.index(kind) - 1]
    said = refused(write_results(tmp_path / "out", other), mode, kind)
    assert f"results of `bayesdrill {other.job}`" in said
    assert "--force" not in said


def linked(path: Path) -> None:
    """To something of the same sort elsewhere, which is not to be touched."""
    elsewhere = path.parent.parent / "elsewhere"
    path.rename(elsewhere)
    path.symlink_to(elsewhere)


def dangling(path: Path) -> None:
    path.unlink()
    path.symlink_to("nowhere")


def folder_instead(path: Path) -> None:
    path.unlink()
    put(path, "mine")


def pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def file_instead(path: Path) -> None:
    path.rename(path.with_name("figures.old"))
    path.write_text("mine")


@run_cases(
    "mode, name, spoil, what",
    [
        (mode, *case)
        for mode in MODES
        for case in [
            *(("figures", linked, "a link"), (".pieces", linked, "a link")),
            *((name, linked, "a link") for name in ("summary.csv", "chain.h5", RUN, ".lock")),
            *(("figures/corner.pdf", linked, "a link"), ("map.json", dangling, "a link")),
            *((name, folder_instead, "a folder") for name in ("chain.h5", "summary.md", RUN)),
            *(("config.yaml", pipe, "a device or pipe"), (RUN, pipe, "a device or pipe")),
            ("figures", file_instead, "a file"),
        ]
    ],
)
def test_what_no_run_can_have_made_is_named_first(
    mode: WriteMode, name: str, spoil: Callable[[Path], None], what: str, tmp_path: Path
) -> None:
    """Mutants killed: links are followed; a chain is gone before the run fails."""
    out = write_results(tmp_path / "results" / "out", POSTERIOR)
    spoil(out / name)
    said = refused(out, mode)
    assert f"{name}: {what}, " in said
    assert "--output" in said


def test_hidden_files_of_others_that_bear_our_names_are_left_alone(tmp_path: Path) -> None:
    put(tmp_path / "out", ".pieces/ensemble_0_000000000.npz")
    assert "holds other files" in refused(tmp_path / "out", "fresh")


def test_a_folder_behind_a_link_is_a_folder(tmp_path: Path) -> None:
    """As one whose results lie on another disk; the user named it."""
    write_results(tmp_path / "disk", POSTERIOR)
    (tmp_path / "out").symlink_to("disk")
    with Folder(tmp_path / "out", "force", {}, POSTERIOR) as folder:
        folder.begin(status="running")
    assert set(listing(tmp_path / "disk")) == {".lock", RUN}


@run_cases("spoil", [linked, dangling, folder_instead, pipe])
def test_a_file_is_replaced_and_nothing_else(spoil: Callable[[Path], None], tmp_path: Path) -> None:
    path = tmp_path / "here" / "record.csv"
    put(tmp_path / "here", "record.csv")
    spoil(path)
    before = listing(tmp_path)
    with pytest.raises(InputError, match="never replaced"), atomic_write(path) as aside:
        aside.write_text("new")
    assert listing(tmp_path) == before


def test_a_file_that_would_not_be_known_again_is_not_written(tmp_path: Path) -> None:
    with Folder(tmp_path / "out", "fresh", {}, POSTERIOR) as folder, pytest.raises(KeyError):
        folder.write_text("summary.txt", "")


def test_what_is_sealed_is_opened_and_a_changed_bit_is_never_believed() -> None:
    data = {"a": [1, 2.5e-300, float("inf")], "b": {"ü": None, "c": (True, "x" * 40)}}
    content = dumps_checksummed(data).encode()
    once = loads_checksummed(content)
    assert once["b"] == {"ü": None, "c": [True, "x" * 40]}
    rng = np.random.default_rng(3)
    found = 0
    for place, bit in zip(rng.integers(0, len(content), 600), rng.integers(0, 8, 600), strict=True):
        damaged = bytearray(content)
        damaged[place] ^= 1 << int(bit)
        try:
            assert loads_checksummed(bytes(damaged)) == once
        except ValueError:
            found += 1
    assert found > 400


@run_cases(
    "content", [b"", b"\xff", b"{}", b"[]", b"3", b"[" * 100_000, b'{"a": 1' + b"0" * 9999 + b"}"]
)
def test_what_was_never_sealed_is_an_error(content: bytes) -> None:
    with pytest.raises(ValueError):  # noqa: PT011
        loads_checksummed(content)


def test_what_is_replaced_hands_its_mode_bits_on(tmp_path: Path) -> None:
    """Also where --force takes it away first.  Mutants killed: a file as the umask has it."""
    out = write_results(tmp_path / "out", POSTERIOR)
    put(out, "summary.csv")
    (out / RUN).chmod(0o640)
    (out / "summary.csv").chmod(0o600)
    modes: tuple[WriteMode, ...] = ("report", "force")
    for mode in modes:
        with Folder(out, mode, {}, POSTERIOR) as folder:
            folder.begin(status="running")
            folder.write_text("summary.csv", "ours")
        found = [stat.S_IMODE((out / name).stat().st_mode) for name in (RUN, "summary.csv")]
        assert found == [0o640, 0o600]


def test_findings_are_written_into_any_folder_and_again(tmp_path: Path) -> None:
    """Mutant killed: figures whose empty folder was just taken away."""
    config, out = small_config(tmp_path), tmp_path / "out"
    for again in ((), ("--force",)):
        ran = cli("identify", config, "-o", out, *again)
        assert ran.status == 0, ran.err
        figure = out / "figures" / "spectrum.png"
        if again:
            assert stat.S_IMODE(figure.stat().st_mode) == 0o600
        figure.chmod(0o600)


COMMANDS = (
    *("posterior", "calibrate", "ladder", "map", "identify", "simulate"),
    *("init", "report", "compare"),
)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_place_that_cannot_be_written_is_found_before_the_work(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that is read-only, whatever mode bits say: one line, and nothing is said of any work."""

    def read_only(**_: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    config, out = small_config(tmp_path), tmp_path / "out"
    given = [config]
    if command == "init":
        given, out = [config.parent / "small.csv"], tmp_path / "mine.yaml"
    elif command == "simulate":
        out = tmp_path / "mine.csv"
    elif command in ("report", "compare"):
        given = [tmp_path / "one", tmp_path / "two"]
    before = listing(tmp_path)
    monkeypatch.setattr(output_files.tempfile, "TemporaryFile", read_only)
    ran = cli(command, *given, "-o", out)
    assert (ran.status, ran.out) == (2, "")
    message = "nothing can be written here (Read-only file system); give another --output"
    assert ran.err == f"{tmp_path}: {message}\n"
    assert listing(tmp_path) == before
