"""The record of a finished run in `run.json`."""

import re
from pathlib import Path

import pytest
from support.case_tables import run_cases
from support.command_line import ROOT

import bayesdrill as bd
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.json_records import as_data
from bayesdrill.inference.compression import CompressionCheck
from bayesdrill.results import run_folder
from bayesdrill.sampling.evidence import Evidence
from bayesdrill.tasks.run_entries import RunRecord, WeightedMaximum, read_record

RECORD = RunRecord(
    units={"k_s": "N*m/rad"},
    converged=True,
    reasons=(),
    notes=("a note",),
    verdict={"agrees": None, "joint_sigma": float("inf")},
    evidence=Evidence(log_z=-1.0 / 3.0, error=float("inf"), overlap=0.5, steps=0.2),
    missed=0.125,
    compression=CompressionCheck(samples=9, functions=3, draws=2, exact=1, difference=1e-12),
    maxima=(WeightedMaximum(values={"k_s": 0.1}, log_posterior=-2.5, weight=1.0),),
    analysis=None,
    analysis_of="a digest",
)
FINISHED = {"status": "finished", **as_data(RECORD)}


def test_a_record_is_read_as_it_was_written() -> None:
    read = read_record(FINISHED, Path("run"))
    assert read is not None
    assert as_data(read) == as_data(RECORD)
    assert (read.evidence, read.maxima) == (RECORD.evidence, RECORD.maxima)


@pytest.mark.parametrize(
    "run",
    [
        {"status": "finished", "log_evidence": -1.0},
        FINISHED | {"form": 1},
        FINISHED | {"missed": "much"},
        FINISHED | {"evidence": {"log_z": 0.0}},
    ],
)
def test_a_record_of_another_form_is_refused_with_a_way_out(run: dict[str, object]) -> None:
    with pytest.raises(InputError, match=r"run/run\.json: was written by an older .*--resume"):
        read_record(run, Path("run"))


def test_a_run_that_never_finished_has_no_record() -> None:
    assert read_record({"status": "interrupted"}, Path("run")) is None


PUBLISHED = {path.parent.name: path.parent for path in ROOT.glob("results/published/*/run.json")}


@run_cases("folder", PUBLISHED.values(), PUBLISHED)
def test_published_results_are_read_whole_or_refused_with_the_reason(folder: Path) -> None:
    run = run_folder.read_run(folder)
    assert run is not None
    if run["job"] != "posterior":
        with pytest.raises(InputError, match=re.escape(f"results of `bayesdrill {run['job']}`")):
            bd.open(folder)
        return
    record = read_record(run, folder)
    assert record is not None
    assert record.analysis is not None
    data = as_data(record)
    assert data == {name: run[name] for name in data}


@run_cases("form", [2, 3])
def test_an_analysis_of_another_form_is_left_out(form: int) -> None:
    """So that it is evaluated again, from a chain that can be read."""
    run = FINISHED | {"form": form, "analysis": {"unknowns": "other records"}}
    read = read_record(run, Path("run"))
    assert read is not None
    assert read.analysis is None
    assert read.evidence == RECORD.evidence
