"""Campaigns name each mistake with a way out, and lose nothing that is kept.

`campaign_attacks.yaml` has the cases; its head explains their entries.
"""

import errno
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock
from support import campaigns, command_line
from support.campaigns import Finished
from support.case_tables import read_table, run_cases
from support.command_line import assert_refused, replace_text

from bayesdrill import output_files
from bayesdrill.campaigns import fits, study

pytest.importorskip("pyarrow")
CASES: list[dict[str, Any]] = read_table("system/campaign_attacks.yaml")
CHANGED = {"campaign": "campaign.yaml", "table": "runs/runs.csv", "base": "small.yaml"}
COMMANDS = {
    "check": ("check", "campaign.yaml"),
    "campaign": ("campaign", "campaign.yaml", "-o", "out", "--processes", "1"),
    "resume": ("campaign", "campaign.yaml", "-o", "out", "--processes", "1", "--resume"),
    "watch": ("watch", "campaign.yaml", "-o", "out", "--processes", "1", "--once"),
    "simulate": ("simulate", "campaign.yaml"),
    "posterior": ("posterior", "campaign.yaml", "-o", "out"),
}
Patch = pytest.MonkeyPatch
RUN = "out/run.json"


def lines_of(path: Path, change: Callable[[list[str]], list[str]]) -> None:
    path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")


def full(patch: Patch, ending: str) -> None:
    """Let the disk be full when a file with this ending is written."""
    write = output_files.write

    def refuse(path: Path, content: bytes) -> None:
        if path.name.endswith(ending):
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        write(path, content)

    patch.setattr(output_files, "write", refuse)


def lose_after_check(folder: Path, patch: Patch) -> None:
    reference = fits.Reference(names=(), products=(), exponents=(), values={})

    def lose(*_: object) -> fits.Reference:
        (folder / "runs" / "run_2.csv").unlink()
        return reference

    patch.setattr(fits, "find_reference", lose)


def other_form(folder: Path, _: Patch) -> None:
    path = folder / "out" / "reference.json"
    data = output_files.loads_checksummed(path.read_bytes())
    del data["values"]
    path.write_text(output_files.dumps_checksummed({**data, "form": 99}))


def folder_of_draws(folder: Path, _: Patch) -> None:
    path = next((folder / "out" / "draws").iterdir())
    path.unlink()
    path.mkdir()


def cut_table(folder: Path, _: Patch) -> None:
    path = folder / "runs" / "runs.parquet"
    path.write_bytes(path.read_bytes()[:-40])


def full_at_draws(_: Path, patch: Patch) -> None:
    reference = fits.Reference(names=("k_e",), products=("k_e",), exponents=((1,),), values={})
    patch.setattr(fits, "find_reference", lambda *_: reference)
    full(patch, ".parquet")


def read_only(_: Path, patch: Patch) -> None:
    def refuse(**_: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    patch.setattr(output_files.tempfile, "TemporaryFile", refuse)


def locked(folder: Path, patch: Patch) -> None:
    lock = FileLock(folder / "out" / ".lock")
    lock.acquire()
    patch.setattr(study, "_held", lock, raising=False)  # until the end of the case


SECOND = Path("runs") / "run_2.csv"
SPOIL: dict[str, Callable[[Path, Patch], None]] = {
    "long_cell": lambda folder, _: replace_text(
        folder / "runs" / "runs.csv", "run_2.csv", "x" * 200_000
    ),
    "infinite_number": lambda folder, _: lines_of(
        folder / "runs" / "runs.csv", lambda x: [*x[:-1], x[-1].rpartition(",")[0] + ",inf"]
    ),
    "no_channel": lambda folder, _: replace_text(folder / SECOND, "w_1", "w_9"),
    "one_sample": lambda folder, _: lines_of(folder / SECOND, lambda x: x[:2]),
    "nan_channel": lambda folder, _: lines_of(
        folder / SECOND, lambda x: [x[0], *(line.rpartition(",")[0] + ",nan" for line in x[1:])]
    ),
    "no_simulation": lambda folder, _: lines_of(folder / "campaign.yaml", lambda x: x[:6]),
    "full_at_figure": lambda _, patch: full(patch, "runs.png"),
    "no_pyarrow": lambda _, patch: patch.setitem(sys.modules, "pyarrow", None),
    **{make.__name__: make for make in (cut_table, folder_of_draws, full_at_draws, locked)},
    **{make.__name__: make for make in (lose_after_check, other_form, read_only)},
}


@pytest.fixture
def finished(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    return campaigns.finished(tmp_path_factory.getbasetemp())


def prepare(folder: Path, case: dict[str, Any], finished: Finished) -> None:
    """Write the files of a case into `folder`."""
    needless = () if case.get("run") == "resume" else ("out",)
    shutil.copytree(finished.path.parent, folder, ignore=shutil.ignore_patterns(*needless))
    for key, name in CHANGED.items():
        path = folder / name
        path.write_text(command_line.replaced(path.read_text(), *case.get(key, ())))
    for name in (case.get("remove"), case.get("folder")):
        if name is not None:
            (folder / name).unlink()
    if "folder" in case:
        (folder / case["folder"]).mkdir()
    if "copy" in case:
        shutil.copy(*(folder / name for name in case["copy"]))
    for name, text in case.get("write", {}).items():
        if (folder / name).is_dir():
            shutil.rmtree(folder / name)
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    if "parquet" in case:
        import pyarrow
        from pyarrow import parquet

        parquet.write_table(pyarrow.table(case["parquet"]), folder / "runs" / "runs.parquet")


@run_cases("case", CASES, ids=lambda case: case["name"])
def test_what_goes_wrong_is_named_and_costs_nothing(
    case: dict[str, Any], finished: Finished, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "campaign"
    prepare(folder, case, finished)
    monkeypatch.chdir(folder)
    if "spoil" in case:
        SPOIL[case["spoil"]](folder, monkeypatch)
    before = command_line.listing(folder)
    result = campaigns.run(*COMMANDS[case.get("run", "check")])
    assert_refused(result, *case["says"])
    messages = [line for line in result.err.splitlines() if not line.startswith("  ")]
    assert len(messages) <= case.get("messages", len(messages)), result.err
    after = command_line.listing(folder)
    if "changes" not in case:
        assert after | {RUN: b""} == before | {RUN: b""}  # which says how the last command ended
    kept = {name for name in before if name.startswith("out/draws/")}
    assert {name: after.get(name) for name in kept} == {name: before[name] for name in kept}
