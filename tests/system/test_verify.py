"""What `bayesdrill verify` catches: tables, figures, configs and records that do not belong together."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import pytest
from support import command_line, forked_command
from support.case_tables import run_cases

import bayesdrill as bd
from bayesdrill.config.job import prepare
from bayesdrill.output_files import dumps_checksummed, loads_checksummed
from bayesdrill.results.provenance import check_record
from bayesdrill.results.run_folder import seal

DRAWN = ("figures: []", "figures: [corner, trace]")


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig with two runs of it, by two seeds."""
    place = tmp_path_factory.mktemp("rig")
    for name, seed in (("out", "seed: 7"), ("other", "seed: 8")):
        config = command_line.small_config(place, DRAWN, ("seed: 7", seed), name=f"{name}.yaml")
        ran = command_line.cli("posterior", config, "-o", place / name, "--processes", "1")
        assert ran.status == 0, ran.text
    return place


def copied_rig(done: Path, tmp_path: Path) -> Path:
    """The rig and its runs, to be changed."""
    shutil.copytree(done, tmp_path / "rig")
    return tmp_path / "rig"


rig = pytest.fixture(copied_rig, name="rig")


def text(path: Path, old: str, new: str) -> None:
    content = path.read_text()
    assert old in content
    path.write_text(content.replace(old, new, 1))


def forged(folder: Path) -> None:
    """The digests of what is there now: somebody has taken pains."""
    run = loads_checksummed((folder / "run.json").read_bytes())
    from bayesdrill.output_files import digest

    run["files"] = {name: digest(folder / name) for name in run["files"]}
    (folder / "run.json").write_text(dumps_checksummed(run))


def edited_table(rig: Path) -> None:
    lines = (rig / "out" / "summary.csv").read_text().splitlines()
    cells = lines[1].split(",")
    cells[4] = repr(1.001 * float(cells[4]))
    (rig / "out" / "summary.csv").write_text(
        "\n".join([lines[0], ",".join(cells), *lines[2:]]) + "\n"
    )


def figure_of_another_run(rig: Path) -> None:
    shutil.copy(rig / "other" / "figures" / "corner.png", rig / "out" / "figures" / "corner.png")


def figure_of_another_name(rig: Path) -> None:
    shutil.copy(rig / "out" / "figures" / "trace.pdf", rig / "out" / "figures" / "corner.pdf")


def changed_config(rig: Path) -> None:
    text(rig / "out" / "config.yaml", "high: 1.5", "high: 1.6")


def changed_both_configs(rig: Path) -> None:
    changed_config(rig)
    text(rig / "out" / "config.resolved.yaml", "high: 1.5", "high: 1.6")


def another_record(rig: Path) -> None:
    lines = (rig / "small.csv").read_text().splitlines()
    lines[50] = lines[49]
    t = (rig / "small.csv").read_text().splitlines()[50].split(",")[0]
    lines[50] = ",".join([t, *lines[49].split(",")[1:]])
    (rig / "small.csv").write_text("\n".join(lines) + "\n")


def another_chain(rig: Path) -> None:
    shutil.copy(rig / "other" / "chain.h5", rig / "out" / "chain.h5")


def missing(rig: Path) -> None:
    (rig / "out" / "figures" / "trace.png").unlink()


CASES: list[tuple[Callable[[Path], None], bool, str]] = [
    (edited_table, False, "summary.csv: was changed after this run had written it"),
    (figure_of_another_run, False, "corner.png: was changed"),
    (figure_of_another_run, True, "corner.png: is a figure of another run"),
    (figure_of_another_name, True, "corner.pdf: is another figure than its name says"),
    (changed_config, False, "config.yaml: was changed"),
    (changed_config, True, "config.yaml: is not the config of this run"),
    (changed_both_configs, True, "the prior of k_e was Uniform"),
    (another_record, False, "the record was 101 samples"),
    (another_record, True, "the record was 101 samples"),
    (another_chain, False, "chain.h5: was changed"),
    (another_chain, True, "chain.h5: is of run "),
    (missing, False, "trace.png: is missing"),
]


@run_cases(
    "change, pains, says",
    CASES,
    ids=[f"{c.__name__}{' forged' * p}" for c, p, _ in CASES],
    rig=copied_rig,
)
def test_what_does_not_belong_is_named(
    change: Callable[[Path], None], pains: bool, says: str, rig: Path
) -> None:
    change(rig)
    if pains:
        forged(rig / "out")
    before = command_line.listing(rig)
    ran = command_line.cli("verify", rig / "out")
    assert ran.status == 2
    assert says in ran.err, ran.err
    assert "Traceback" not in ran.text
    assert command_line.listing(rig) == before


@run_cases("name", ["chain.h5", "map.json"], rig=copied_rig)
def test_what_another_run_has_found_is_refused_by_all_that_read_it(name: str, rig: Path) -> None:
    """Mutant killed: a chain that is believed whatever run it is of."""
    mine, other = rig / "out", rig / "other"
    shutil.copy(other / name, mine / name)
    before = command_line.listing(rig)
    for command in (
        ("report", mine),
        ("verify", mine),
        ("report", other, mine, "-o", rig / "laid"),
        ("compare", other, mine, "-o", rig / "compared"),
        ("posterior", rig / "out.yaml", "-o", mine, "--resume"),
    ):
        ran = command_line.cli(*command)
        assert ran.status == 2, ran.text
        assert f"{name}: is of run " in ran.err
        assert "put back its own, or delete it and continue with --resume" in ran.err
    assert command_line.listing(rig) == before


def test_a_chain_that_does_not_say_whose_it_is_is_believed_where_run_json_knows_it(
    rig: Path,
) -> None:
    for name in ("out", "other"):
        with h5py.File(rig / name / "chain.h5", "r+") as file:
            for group in file.values():
                del group.attrs["run"]
                seal(group)
        forged(rig / name)
    assert bd.verify(rig / "out").together
    shutil.copy(rig / "other" / "chain.h5", rig / "out" / "chain.h5")
    ran = command_line.cli("report", rig / "out")
    assert ran.status == 2
    assert "chain.h5: is of a run that it does not name (an older version wrote it)" in ran.err


def test_a_run_is_not_compared_with_itself(done: Path, tmp_path: Path) -> None:
    """By whatever name; laid over itself it may be."""
    link = tmp_path / "link"
    link.symlink_to(done / "out")
    for other in (done / "out", done / "other" / ".." / "out", link):
        ran = command_line.cli("compare", done / "out", other, "-o", tmp_path / "both")
        assert ran.status == 2
        assert "would be compared with itself; give another run" in ran.err
        assert not (tmp_path / "both").exists()
    run = bd.open(done / "out")
    with pytest.raises(bd.InputError, match="number 2 would be compared with itself"):
        bd.compare([run, run])
    assert command_line.cli("report", done / "out", link, "-o", tmp_path / "over").status == 0


GROUND = ("chain.h5", "map.json", "config.resolved.yaml")


@run_cases("name", [*GROUND, "summary.csv", "figures/corner.png"], rig=copied_rig)
def test_a_missing_file_comes_back_as_verify_says(
    name: str, done: Path, tmp_path: Path, rig: Path
) -> None:
    """What a report is made from comes from a run that goes on; all else from a report."""
    (rig / "out" / name).unlink()
    told = command_line.cli("verify", rig / "out")
    assert told.status == 2
    way = "--resume` makes it again" if name in GROUND else "`bayesdrill report` makes"
    assert way in told.err
    ran = command_line.cli("report", rig / "out")
    assert ran.status == (2 if name in GROUND else 0), ran.text
    if name in GROUND:
        assert "--resume" in ran.err
        options = ("-o", rig / "out", "--resume", "--processes", "1")
        assert command_line.cli("posterior", rig / "out.yaml", *options).status == 0
    assert command_line.cli("verify", rig / "out").status == 0


def test_a_missing_file_of_a_map_is_made_by_a_map(tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path)
    assert command_line.cli("map", config, "-o", tmp_path / "map").status == 0
    (tmp_path / "map" / "map.csv").unlink()
    assert (
        "`bayesdrill map --force` makes it again"
        in command_line.cli("verify", tmp_path / "map").err
    )
    assert command_line.cli("map", config, "-o", tmp_path / "map", "--force").status == 0
    assert command_line.cli("verify", tmp_path / "map").status == 0


def test_no_pipe_among_results_is_waited_for(rig: Path) -> None:
    """Each file of a run in turn; mutant killed: what `run.json` names is opened, whatever it is."""
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


def test_what_belongs_together_is_said_so(rig: Path) -> None:
    """After a report too, in another place, and of a case that was saved from memory."""
    ran = command_line.cli("verify", rig / "out")
    assert (ran.status, ran.err) == (0, "")
    assert "belong together" in ran.out
    (rig / "out" / "figures" / "trace.png").unlink()
    assert command_line.cli("report", rig / "out", "--processes", "1").status == 0
    assert bd.verify(rig / "out").together
    bd.open(rig / "out").save(rig / "saved")
    assert bd.verify(rig / "saved").together
    with pytest.raises(bd.InputError, match="no results"):
        bd.verify(rig)


@pytest.fixture
def lent(done: Path) -> Iterator[Path]:
    """The rig where this user may only read, beside `mine`, where it may write; root is nobody."""
    if os.name != "posix":
        pytest.skip("no mode bits")
    place = Path(tempfile.mkdtemp())  # others cannot look into the folders of pytest
    shutil.copytree(done, place / "rig")
    (place / "mine").mkdir()
    every = [place, *place.rglob("*")]
    for path in every:
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
        for path in every:
            path.chmod(0o755)
        shutil.rmtree(place)


def test_what_one_may_only_read_is_verified_compared_and_reported_elsewhere(lent: Path) -> None:
    run, other, mine = lent / "rig" / "out", lent / "rig" / "other", lent / "mine"
    before = command_line.listing(lent / "rig")
    assert command_line.cli("verify", run).status == 0
    for command in (
        ("compare", run, other, "-o", mine / "compared"),
        ("report", run, other, "-o", mine / "laid"),
        ("report", run, "-o", mine / "copy", "--processes", "1"),
    ):
        ran = command_line.cli(*command)
        assert ran.status == 0, ran.text
    for name in ("chain.h5", "map.json", "config.yaml", "summary.csv", "verdict.csv"):
        assert (mine / "copy" / name).read_bytes() == (run / name).read_bytes()
    for name in ("compared", "laid", "copy"):
        assert bd.verify(mine / name).together
    old, new = (json.loads((place / "run.json").read_text()) for place in (run, mine / "copy"))
    assert [new[name] for name in ("fingerprint", "versions", "log_evidence")] == [
        old[name] for name in ("fingerprint", "versions", "log_evidence")
    ]
    assert command_line.listing(lent / "rig") == before
    for command in (
        ("report", run),
        ("report", run, "-o", run / "below"),
        ("compare", run, other, "-o", run / "below"),
        ("posterior", lent / "rig" / "out.yaml", "-o", run, "--force"),
        ("posterior", lent / "rig" / "out.yaml", "-o", run / "below"),
    ):
        ran = command_line.cli(*command)
        assert ran.status == 2
        assert "nothing can be written here (Permission denied); give another --output" in ran.err


def test_a_run_is_reported_elsewhere_in_a_folder_of_its_own(rig: Path) -> None:
    out, before = rig / "out", command_line.listing(rig)
    for wrong, says in (
        ([out, "-o", out, "--force"], "holds this very run"),
        ([out, "-o", rig, "--force"], "this folder holds other files"),
        ([out, "-o", rig / "other"], "results exist already"),
        ([out, "--force"], "--force: goes with --output"),
    ):
        ran = command_line.cli("report", *wrong)
        assert ran.status == 2
        assert says in ran.err
        assert command_line.listing(rig) == before
    ran = command_line.cli("report", out, "-o", rig / "other", "--force", "--processes", "1")
    assert ran.status == 0, ran.text
    assert bd.verify(rig / "other").together
    assert (rig / "other" / "chain.h5").read_bytes() == (out / "chain.h5").read_bytes()


def test_figures_and_tree_say_which_run_they_are_of(done: Path) -> None:
    import xarray

    run = json.loads((done / "out" / "run.json").read_text())
    with xarray.open_datatree(done / "out" / "posterior.nc", engine="h5netcdf") as tree:
        marks = {name: tree.attrs[name] for name in ("run", "record", "burn-in", "versions")}
    for name in ("corner.png", "corner.pdf", "trace.png"):
        content = (done / "out" / "figures" / name).read_bytes()
        assert marks["run"].encode() in content
        assert marks["record"].split("(")[1].strip(")").encode() in content
        assert run["versions"]["emcee"].encode() in content
    assert marks["burn-in"] == f"{run['burn_in']} of {run['steps']} steps"


def test_formats_of_figures_are_known_to_all_that_lists_files(rig: Path) -> None:
    """Mutants killed: an svg that verify or --force does not know; a stale figure that stays."""
    config = rig / "out.yaml"
    text(config, DRAWN[1], "figures: [corner, trace], formats: [svg, png], size: single, dpi: 100")
    ran = command_line.cli("posterior", config, "-o", rig / "out", "--processes", "1", "--resume")
    assert ran.status == 0, ran.text
    figures = rig / "out" / "figures"
    names = {f"{stem}.{end}" for stem in ("corner", "trace") for end in ("svg", "png")}
    assert {path.name for path in figures.iterdir()} == names
    assert bd.verify(rig / "out").together
    shutil.copy(figures / "trace.svg", figures / "corner.svg")
    forged(rig / "out")
    (problem,) = bd.verify(rig / "out").problems
    assert "corner.svg: is another figure than its name says" in str(problem)
    (figures / "mine.svg").write_text("kept")
    text(config, "[corner, trace], formats: [svg, png]", "[]")
    ran = command_line.cli("posterior", config, "-o", rig / "out", "--processes", "1", "--force")
    assert ran.status == 0, ran.text
    assert [path.name for path in figures.iterdir()] == ["mine.svg"]


def test_every_file_of_a_record_is_part_of_its_run(tmp_path: Path) -> None:
    """Mutant killed: only the record's own file found again from the folder of the results."""
    own = "w_1: {column: w_1, unit: rad/s"
    changes = [
        (own, "w_1: {file: more/speed.csv, column: w_1, unit: rad/s"),
        ("v: 8.0", "v: {file: {path: more/supply.csv}, column: u, unit: V, hold: first}"),
    ]
    config = command_line.small_config(tmp_path / "rig", *changes)
    more = config.parent / "more"
    more.mkdir()
    lines = (config.parent / "small.csv").read_text().splitlines()
    (more / "speed.csv").write_text("\n".join(lines) + "\n")
    rows = [f"{line.split(',')[0]},8" for line in lines[1:]]
    (more / "supply.csv").write_text("\n".join(["t,u", *rows]) + "\n")
    ran = command_line.cli("posterior", config, "-o", tmp_path / "out", "--processes", "1")
    assert ran.status == 0, ran.text
    page = (tmp_path / "out" / "report.html").read_text()
    for name in ("small.csv", "speed.csv", "supply.csv"):
        assert f"<code>{name}</code>" in page
    assert bd.verify(tmp_path / "out").together
    supply = more / "supply.csv"
    text(supply, rows[70], rows[70].replace(",8", ",8.25"))
    assert "the input v" in bd.verify(tmp_path / "out").said
    text(supply, ",8.25", ",8")
    text(
        more / "speed.csv",
        lines[30],
        lines[29].replace(lines[29].split(",")[0], lines[30].split(",")[0]),
    )
    assert "the record was 101 samples" in bd.verify(tmp_path / "out").said


def test_results_never_stand_beside_a_file_of_their_record(tmp_path: Path) -> None:
    changes = [("w_1: {column: w_1", "w_1: {file: more/speed.csv, column: w_1")]
    config = command_line.small_config(tmp_path, *changes)
    (tmp_path / "more").mkdir()
    shutil.copy(tmp_path / "small.csv", tmp_path / "more" / "speed.csv")
    job = prepare(config)
    check_record(job, tmp_path / "elsewhere", None)
    for folder in (tmp_path, tmp_path / "more"):
        with pytest.raises(bd.InputError, match="holds the record of this run"):
            check_record(job, folder, None)


def resealed(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Of other content, with a checksum that fits."""
    data = loads_checksummed(path.read_bytes())
    change(data)
    path.write_text(dumps_checksummed(data))


DAMAGED = "map.json: is damaged; delete it"
NOT_OURS = "run.json: is damaged, or not of this bayesdrill"
WRONG_TYPES: list[tuple[str, Callable[[dict[str, Any]], object], str]] = [
    ("run.json", lambda d: d.update(files=["summary.csv"]), NOT_OURS),
    ("run.json", lambda d: d.update(fingerprint=3), NOT_OURS),
    ("run.json", lambda d: d.update(job={"posterior": 1}), NOT_OURS),
    ("run.json", lambda d: d.update(versions={"emcee": 3}), NOT_OURS),
    ("run.json", lambda d: d.pop("fingerprint"), NOT_OURS),
    ("run.json", lambda d: d["files"].update({"a\0b": "x"}), "is missing"),
    ("map.json", lambda d: d.update(values=[0.1]), DAMAGED),
    ("map.json", lambda d: d.update(gain="1.0"), DAMAGED),
    ("map.json", lambda d: d.update(log_posterior=10**400), DAMAGED),
    ("map.json", lambda d: d["values"].update(k_e=float("nan")), DAMAGED),
    ("map.json", lambda d: d["values"].update(k_e=-1.0), DAMAGED),
    ("map.json", lambda d: d.update(values={"k_s": 0.1}), DAMAGED),
    ("map.json", lambda d: d["searches"][0].pop("end"), DAMAGED),
    ("map.json", lambda d: d.update(pieces={"": [0, 1]}), DAMAGED),
]


@run_cases("name, change, said", WRONG_TYPES, rig=copied_rig)
def test_types_are_looked_at_before_anything_is_believed(
    name: str, change: Callable[[dict[str, Any]], object], said: str, rig: Path
) -> None:
    resealed(rig / "out" / name, change)
    told = command_line.cli("verify", rig / "out")
    assert told.status == 2
    assert said in told.err


@run_cases(
    "dataset, shape",
    [("chain", (-1, 8, 1)), ("chain", (-1, 4, 2)), ("log_prob", (-1, 4))],
    rig=copied_rig,
)
def test_a_chain_of_other_walkers_or_unknowns(
    dataset: str, shape: tuple[int, ...], rig: Path
) -> None:
    with h5py.File(rig / "out" / "chain.h5", "r+") as file:
        for group in file.values():
            values = group[dataset][:].reshape(shape)
            del group[dataset]
            group[dataset] = values
            if dataset == "chain" and shape[1:] == (4, 2):  # in itself it is one
                for name in ("log_prob", "accepted"):
                    own = group[name][:]
                    del group[name]
                    group[name] = own.reshape(-1, 4) if own.ndim == 2 else own[:4]
            seal(group)
    ran = command_line.cli("verify", rig / "out")
    assert ran.status == 2
    whole = dataset == "chain" and shape[1:] == (4, 2)
    assert ("a chain of 4 walkers in 2 unknowns" if whole else "is damaged") in ran.err
    assert command_line.cli("report", rig / "out").status == 2
