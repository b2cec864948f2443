"""`bayesdrill verify RUN`: tables, figures, configs and records that do not belong together."""

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import pytest
import xarray
from support import command_line, finished_runs, forked_command
from support.case_tables import run_cases
from support.command_line import assert_refused, cli, posterior, renew_digests
from support.finished_runs import FinishedRun, copied, copied_run

import bayesdrill as bd
from bayesdrill.config.job import prepare
from bayesdrill.output_files import dumps_checksummed, loads_checksummed
from bayesdrill.results.provenance import check_record
from bayesdrill.results.run_folder import seal

RUNS = {  # by two seeds
    "out": [("figures: []", "figures: [corner, trace]")],
    "other": [("seed: 7", "seed: 8"), ("figures: []", "figures: [trace]")],
}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig with two runs, not to be changed."""
    place = tmp_path_factory.mktemp("rig")
    for name, changes in RUNS.items():
        result = finished_runs.posterior(tmp_path_factory, place, name, *changes)
        assert result.status == 0, result.text
    return place


rig = pytest.fixture(copied, name="rig")


def replace_once(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def edited_table(rig: Path) -> None:
    lines = (rig / "out" / "summary.csv").read_text().splitlines()
    cells = lines[1].split(",")
    cells[4] = repr(1.001 * float(cells[4]))
    lines[1] = ",".join(cells)
    (rig / "out" / "summary.csv").write_text("\n".join(lines) + "\n")


def figure_of_another_run(rig: Path) -> None:
    shutil.copy(rig / "other" / "figures" / "trace.png", rig / "out" / "figures" / "trace.png")


def figure_of_another_name(rig: Path) -> None:
    shutil.copy(rig / "out" / "figures" / "trace.png", rig / "out" / "figures" / "corner.png")


def changed_config(rig: Path) -> None:
    replace_once(rig / "out" / "config.yaml", "high: 1.5", "high: 1.6")


def changed_both_configs(rig: Path) -> None:
    changed_config(rig)
    replace_once(rig / "out" / "config.resolved.yaml", "high: 1.5", "high: 1.6")


def repeated_sample(rig: Path) -> None:
    lines = (rig / "small.csv").read_text().splitlines()
    lines[50] = ",".join([lines[50].split(",")[0], *lines[49].split(",")[1:]])
    (rig / "small.csv").write_text("\n".join(lines) + "\n")


def another_chain(rig: Path) -> None:
    shutil.copy(rig / "other" / "chain.h5", rig / "out" / "chain.h5")


def missing_figure(rig: Path) -> None:
    (rig / "out" / "figures" / "trace.png").unlink()


def missing_map(rig: Path) -> None:
    (rig / "out" / "map.json").unlink()


def foreign_figure(rig: Path) -> None:
    (rig / "out" / "figures" / "ridge.png").write_bytes(b"of another run")


# A change, whether the digests of `run.json` are renewed after it, and the message.
CASES: list[tuple[Callable[[Path], None], bool, str]] = [
    (edited_table, False, "summary.csv: was changed after this run had written it"),
    (figure_of_another_run, False, "trace.png: was changed"),
    (figure_of_another_run, True, "trace.png: is a figure of another run"),
    (figure_of_another_name, True, "corner.png: is another figure than its name says"),
    (changed_config, False, "config.yaml: was changed"),
    (changed_config, True, "config.yaml: is not the config of this run"),
    (changed_both_configs, True, "the prior of k_e was Uniform"),
    (repeated_sample, False, "the record was 101 samples"),
    (repeated_sample, True, "the record was 101 samples"),
    (another_chain, False, "chain.h5: was changed"),
    (another_chain, True, "chain.h5: is of run "),
    (missing_figure, False, "trace.png: is missing"),
    (
        missing_map,
        False,
        "map.json: is missing; put it back, or `bayesdrill posterior CONFIG --resume",
    ),
    (foreign_figure, False, "ridge.png: was not written by this run"),
]


@run_cases(
    "change, renewed, message",
    CASES,
    ids=[f"{change.__name__}{' with digests' * renewed}" for change, renewed, _ in CASES],
    rig=copied,
)
def test_what_does_not_belong_is_named(
    change: Callable[[Path], None], renewed: bool, message: str, rig: Path
) -> None:
    change(rig)
    if renewed:
        renew_digests(rig / "out")
    before = command_line.listing(rig)
    assert_refused(cli("verify", rig / "out"), message)
    assert command_line.listing(rig) == before


@run_cases("name", ["chain.h5", "map.json"], rig=copied)
def test_a_chain_or_map_of_another_run_is_refused_by_all_that_read_it(name: str, rig: Path) -> None:
    mine, other = rig / "out", rig / "other"
    shutil.copy(other / name, mine / name)
    before = command_line.listing(rig)
    way_out = "put back its own, or delete it and continue with --resume"
    for command in (
        ("report", mine),
        ("verify", mine),
        ("report", other, mine, "-o", rig / "laid"),
        ("compare", other, mine, "-o", rig / "compared"),
        ("posterior", rig / "out.yaml", "-o", mine, "--resume"),
    ):
        assert_refused(cli(*command), f"{name}: is of run ", way_out)
    assert command_line.listing(rig) == before


def test_a_chain_of_an_older_version_is_believed_where_run_json_has_its_digest(rig: Path) -> None:
    """Such a chain does not name its run."""
    for name in ("out", "other"):
        with h5py.File(rig / name / "chain.h5", "r+") as file:
            for group in file.values():
                del group.attrs["run"]
                seal(group)
        renew_digests(rig / name)
    assert bd.verify(rig / "out").together
    another_chain(rig)
    message = "chain.h5: is of an unknown run (an older version wrote it)"
    assert_refused(cli("report", rig / "out"), message)


def test_a_run_is_not_compared_with_itself(finished: Path, tmp_path: Path) -> None:
    """Under whatever name; it may be laid over itself."""
    link = tmp_path / "link"
    link.symlink_to(finished / "out")
    for other in (finished / "out", finished / "other" / ".." / "out", link):
        result = cli("compare", finished / "out", other, "-o", tmp_path / "both")
        assert_refused(result, "would be compared with itself; give another run")
        assert not (tmp_path / "both").exists()
    run = bd.open(finished / "out")
    with pytest.raises(bd.InputError, match="number 2 would be compared with itself"):
        bd.compare([run, run])
    assert cli("report", finished / "out", link, "-o", tmp_path / "over").status == 0


SOURCES = ("chain.h5", "map.json", "config.resolved.yaml")


@pytest.mark.slow
@run_cases("name", [*SOURCES, "summary.csv"], copy=copied_run)
def test_a_missing_file_comes_back_as_verify_says(name: str, copy: FinishedRun) -> None:
    """A resumed run makes what a report is made from, the same map too; a report makes the rest."""
    maximum = (copy.folder / "map.json").read_bytes()
    (copy.folder / name).unlink()
    way = "--resume` makes it again" if name in SOURCES else "`bayesdrill report` makes"
    assert_refused(cli("verify", copy.folder), way)
    report = cli("report", copy.folder)
    if name in SOURCES:
        assert_refused(report, "--resume")
        assert posterior(copy.config, copy.folder, "--resume").status == 0
    else:
        assert report.status == 0, report.text
    assert cli("verify", copy.folder).status == 0
    assert (copy.folder / "map.json").read_bytes() == maximum


@pytest.mark.slow
def test_a_pipe_among_results_is_refused_and_not_waited_for(rig: Path) -> None:
    """In the place of each file of a run in turn."""
    out = rig / "out"
    commands = [("verify", out)]
    commands += [("report", out), ("compare", out, rig / "other", "-o", rig / "new")]
    for path in [*out.glob("*.*"), out / "figures" / "corner.png"]:
        kept = path.rename(rig / "kept")
        os.mkfifo(path)
        name = str(path.relative_to(out))
        read_first = name in ("run.json", "config.resolved.yaml", "chain.h5")
        for command in commands[: 3 if read_first else 1]:
            ended = forked_command.ran(command, rig)
            assert (ended.status, ended.traceback) == (2, False), (name, command, ended)
            assert f"{name}: " in ended.text
            assert "pipe" in ended.text
        kept.rename(path)


DAMAGED = "map.json: is damaged; delete it"
NOT_OURS = "run.json: is damaged, or not of this bayesdrill"
WRONG_TYPES: list[tuple[str, Callable[[dict[str, Any]], object], str]] = [
    ("run.json", lambda d: d.update(files=["summary.csv"]), NOT_OURS),
    ("run.json", lambda d: d.update(fingerprint=3), NOT_OURS),
    ("run.json", lambda d: d.update(job={"posterior": 1}), NOT_OURS),
    ("run.json", lambda d: d.update(versions={"emcee": 3}), NOT_OURS),
    ("run.json", lambda d: d.pop("fingerprint"), NOT_OURS),
    ("run.json", lambda d: d["files"].update({"a\0b": "x"}), "is missing"),
    ("run.json", lambda d: d.update(status="running"), "this run is not finished, or of an older"),
    ("map.json", lambda d: d.update(values=[0.1]), DAMAGED),
    ("map.json", lambda d: d.update(gain="1.0"), DAMAGED),
    ("map.json", lambda d: d.update(log_posterior=10**400), DAMAGED),
    ("map.json", lambda d: d["values"].update(k_e=float("nan")), DAMAGED),
    ("map.json", lambda d: d["values"].update(k_e=-1.0), DAMAGED),
    ("map.json", lambda d: d.update(values={"k_s": 0.1}), DAMAGED),
    ("map.json", lambda d: d["searches"][0].pop("end"), DAMAGED),
    ("map.json", lambda d: d.update(pieces={"": [0, 1]}), DAMAGED),
]


@run_cases("name, change, message", WRONG_TYPES, rig=copied)
def test_wrong_types_are_refused_though_the_checksum_fits(
    name: str, change: Callable[[dict[str, Any]], object], message: str, rig: Path
) -> None:
    path = rig / "out" / name
    data = loads_checksummed(path.read_bytes())
    change(data)
    path.write_text(dumps_checksummed(data))
    assert_refused(cli("verify", rig / "out"), message)


@run_cases(
    "dataset, shape",
    [("chain", (-1, 8, 1)), ("chain", (-1, 4, 2)), ("log_prob", (-1, 4))],
    rig=copied,
)
def test_a_chain_of_other_walkers_or_unknowns(
    dataset: str, shape: tuple[int, ...], rig: Path
) -> None:
    consistent = shape == (-1, 4, 2)
    with h5py.File(rig / "out" / "chain.h5", "r+") as file:
        for group in file.values():
            arrays = {dataset: group[dataset][:].reshape(shape)}
            if consistent:
                arrays["log_prob"] = group["log_prob"][:].reshape(-1, 4)
                arrays["accepted"] = group["accepted"][:4]
            for name, values in arrays.items():
                del group[name]
                group[name] = values
            seal(group)
    message = "a chain of 4 walkers in 2 unknowns" if consistent else "is damaged"
    assert_refused(cli("verify", rig / "out"), message)
    assert cli("report", rig / "out").status == 2


def test_what_belongs_together_passes(rig: Path) -> None:
    """After a report too, in another place, and for a case that was saved from memory."""
    result = cli("verify", rig / "out")
    assert (result.status, result.err) == (0, "")
    assert "belong together" in result.out
    (rig / "other" / "figures" / "trace.png").unlink()
    assert cli("report", rig / "other", "--processes", "1").status == 0
    assert bd.verify(rig / "other").together
    bd.open(rig / "other").save(rig / "saved")
    assert bd.verify(rig / "saved").together
    with pytest.raises(bd.InputError, match="no results"):
        bd.verify(rig)


def test_figures_and_tree_say_which_run_they_are_of(finished: Path) -> None:
    run = json.loads((finished / "out" / "run.json").read_text())
    with xarray.open_datatree(finished / "out" / "posterior.nc", engine="h5netcdf") as tree:
        marks = {name: tree.attrs[name] for name in ("run", "record", "burn-in", "versions")}
    for name in ("corner.png", "corner.pdf", "trace.png"):
        content = (finished / "out" / "figures" / name).read_bytes()
        assert marks["run"].encode() in content
        assert marks["record"].split("(")[1].strip(")").encode() in content
        assert run["versions"]["emcee"].encode() in content
    convergence = run["analysis"]["convergence"]
    assert marks["burn-in"] == f"{convergence['burn_in']} of {convergence['steps']} steps"


@pytest.mark.slow
def test_every_file_of_a_record_is_part_of_its_run(tmp_path: Path) -> None:
    """And results are refused in the folder of any of them."""
    config = command_line.small_config(
        tmp_path / "rig",
        ("w_1: {column: w_1", "w_1: {file: more/speed.csv, column: w_1"),
        ("v: 8.0", "v: {file: {path: more/supply.csv}, column: u, unit: V, hold: first}"),
    )
    more, out = config.parent / "more", tmp_path / "out"
    more.mkdir()
    lines = (config.parent / "small.csv").read_text().splitlines()
    (more / "speed.csv").write_text("\n".join(lines) + "\n")
    rows = [f"{line.split(',')[0]},8" for line in lines[1:]]
    (more / "supply.csv").write_text("\n".join(["t,u", *rows]) + "\n")
    job = prepare(config)
    check_record(job, out, None)
    for folder in (config.parent, more):
        with pytest.raises(bd.InputError, match="holds the record of this run"):
            check_record(job, folder, None)
    result = posterior(config, out)
    assert result.status == 0, result.text
    page = (out / "report.html").read_text()
    for name in ("small.csv", "speed.csv", "supply.csv"):
        assert f"<code>{name}</code>" in page
    assert bd.verify(out).together
    replace_once(more / "supply.csv", rows[70], rows[70].replace(",8", ",8.25"))
    assert "the input v" in bd.verify(out).summary
    replace_once(more / "supply.csv", ",8.25", ",8")
    time, before = lines[30].split(",")[0], lines[29].split(",", 1)[1]
    replace_once(more / "speed.csv", lines[30], f"{time},{before}")
    assert "the record was 101 samples" in bd.verify(out).summary


@pytest.fixture
def read_only(finished: Path) -> Iterator[Path]:
    """The rig where this user may only read, beside `mine`, where it may write; root becomes nobody."""
    if os.name != "posix":
        pytest.skip("no mode bits")
    place = Path(tempfile.mkdtemp())  # others cannot look into the folders of pytest
    shutil.copytree(finished, place / "rig")
    (place / "mine").mkdir()
    paths = [place, *place.rglob("*")]
    for path in paths:
        path.chmod(0o444 | 0o111 * path.is_dir())
    (place / "mine").chmod(0o777)
    user = os.geteuid()
    try:
        if user == 0:
            os.seteuid(65534)
        try:
            Path(bd.__file__).read_bytes()
        except PermissionError:
            pytest.skip("nobody else may read the package")
        yield place
    finally:
        os.seteuid(user)
        for path in paths:
            path.chmod(0o755)
        shutil.rmtree(place)


@pytest.mark.slow
def test_runs_in_a_read_only_folder_are_verified_compared_and_reported_elsewhere(
    read_only: Path,
) -> None:
    run, other, mine = read_only / "rig" / "out", read_only / "rig" / "other", read_only / "mine"
    before = command_line.listing(read_only / "rig")
    assert cli("verify", run).status == 0
    for command in (
        ("compare", run, other, "-o", mine / "compared"),
        ("report", run, other, "-o", mine / "laid"),
        ("report", other, "-o", mine / "copy", "--processes", "1"),
    ):
        result = cli(*command)
        assert result.status == 0, result.text
    for name in ("chain.h5", "map.json", "config.yaml", "summary.csv", "verdict.csv"):
        assert (mine / "copy" / name).read_bytes() == (other / name).read_bytes()
    for name in ("compared", "laid", "copy"):
        assert bd.verify(mine / name).together
    old, new = (json.loads((place / "run.json").read_text()) for place in (other, mine / "copy"))
    for name in ("fingerprint", "versions", "evidence"):
        assert new[name] == old[name]
    assert command_line.listing(read_only / "rig") == before
    config = read_only / "rig" / "out.yaml"
    message = "nothing can be written here (Permission denied); give another --output"
    for command in (
        ("report", run),
        ("report", run, "-o", run / "below"),
        ("compare", run, other, "-o", run / "below"),
        ("posterior", config, "-o", run, "--force"),
        ("posterior", config, "-o", run / "below"),
    ):
        assert_refused(cli(*command), message)


def test_a_run_is_reported_elsewhere_in_a_folder_of_its_own(rig: Path) -> None:
    out, before = rig / "out", command_line.listing(rig)
    for arguments, message in (
        ([out, "-o", out, "--force"], "is the folder of this run"),
        ([out, "-o", rig, "--force"], "this folder holds other files"),
        ([out, "-o", rig / "other"], "results exist already"),
        ([out, "--force"], "--force: needs --output"),
    ):
        assert_refused(cli("report", *arguments), message)
        assert command_line.listing(rig) == before
    result = cli("report", rig / "other", "-o", out, "--force", "--processes", "1")
    assert result.status == 0, result.text
    assert bd.verify(out).together
    assert (rig / "other" / "chain.h5").read_bytes() == (out / "chain.h5").read_bytes()
