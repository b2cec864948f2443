"""The comparison of the baseline reports every kind of change, and passes equal results."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.array_cases import run
from support.case_tables import run_cases

import bayesdrill as bd
from benchmarks import baseline
from benchmarks.baseline import Measured, compare, packed, spread, unpacked

LOG_DENSITY = -3600.0 + np.linspace(-40.0, 40.0, baseline.POINTS)
MEASURED: Measured = {
    "status": 0,
    "conclusions": ["fit: the residuals look like the noise.", "verdict: all 3 agree."],
    "sha256": {"summary.csv": "1f", "verdict.csv": "2e", "draws": "3d"},
    "quantities": {
        "k_s": [0.26, 1e-3, 1e-5, 7e-6],
        "omega_n": [3.0, 1e-2, 1e-4, 7e-5],
        "log evidence": [-3650.0, 0.0, 1e-3, 0.0],
    },
    "draws": {"k_s": packed(np.linspace(0.25, 0.27, baseline.DRAWS))},
    "log_density": packed(LOG_DENSITY),
}


def other(change: Callable[[Any], object]) -> Measured:
    """The same results with one change."""
    measured = copy.deepcopy(MEASURED)
    change(measured)
    return measured


def by_errors(errors: float, *moments: tuple[str, int]) -> Callable[[Any], object]:
    """Moves means (0) or sds (1) by so many standard errors of one run."""

    def change(measured: Any) -> None:
        for name, number in moments:
            quantity = measured["quantities"][name]
            quantity[number] += errors * quantity[number + 2]

    return change


def with_density(values: Any) -> Callable[[Any], object]:
    return lambda measured: measured.update(log_density=packed(values))


def other_bytes(measured: Any) -> None:
    measured["sha256"]["summary.csv"] = "0"
    del measured["sha256"]["verdict.csv"]
    measured["sha256"]["torque.csv"] = "4c"


def no_mean(measured: Any) -> None:
    measured["quantities"]["k_s"][0] = np.nan


def at_one_point(factor: float) -> np.ndarray:
    moved = LOG_DENSITY.copy()
    moved[17] *= factor
    return moved


BOTH = (("k_s", 0), ("omega_n", 0))
BYTES = "other bytes: summary.csv, verdict.csv, torque.csv"
MEANS, SDS = "means, in standard errors: ", "sds, in standard errors: "
DENSITY = "log density: 1.0e-07 max(1, |log density|) at 1 points"


@run_cases(
    "change, text, beyond",
    [
        (other_bytes, BYTES, False),
        (with_density(at_one_point(1.0 + 1e-7)), DENSITY, True),
        (with_density(LOG_DENSITY * (1.0 + 1e-11)), "1.0e-11", False),
        (with_density(at_one_point(-np.inf)), "log density", True),
        (by_errors(10.0, ("k_s", 0)), f"{MEANS}k_s 7.1", True),
        (by_errors(10.0, ("omega_n", 1)), f"{SDS}omega_n 7.1", True),
        (by_errors(10.0, ("log evidence", 0)), f"{MEANS}log evidence 7.1", True),
        (by_errors(5.0, ("k_s", 0)), MEANS, False),
        (by_errors(5.0, ("omega_n", 1)), SDS, False),
        (by_errors(10.0, *BOTH), f"{MEANS}k_s 7.1, omega_n 7.1", True),
        (no_mean, f"{MEANS}k_s inf", True),
        (lambda of: of["quantities"].pop("omega_n"), "quantities of one run only: omega_n", True),
        (lambda of: of.update(status=3), "exit status 0, now 3", True),
    ],
)
def test_each_change_is_named_and_beyond_the_limits_or_not(
    change: Callable[[Any], object], text: str, beyond: bool
) -> None:
    ((said, is_beyond),) = compare(MEASURED, other(change))
    assert text in said
    assert is_beyond == beyond


def test_equal_results_do_not_differ_and_other_bytes_are_beyond_the_limits_on_request() -> None:
    assert list(compare(MEASURED, json.loads(json.dumps(MEASURED)), same_bytes=True)) == []
    assert list(compare(other(no_mean), other(no_mean))) == []
    assert list(compare(MEASURED, other(other_bytes), same_bytes=True)) == [(BYTES, True)]


def test_a_small_log_density_is_compared_absolutely() -> None:
    old = other(with_density(np.zeros(baseline.POINTS)))
    for off, expected in ((1e-7, True), (1e-10, False)):
        new = other(with_density(np.full(baseline.POINTS, off)))
        assert [beyond for _, beyond in compare(old, new)] == [expected]


def test_a_quantity_without_spread_may_differ_by_rounding_only() -> None:
    assert baseline.distance(0.25, 0.25 * (1 + 1e-15), 0.0, 0.0) < 1.0
    assert baseline.distance(0.25, 0.2500001, 0.0, 0.0) > baseline.MOST_ERRORS
    assert baseline.distance(0.0, 0.0, 0.0, 0.0) == 0.0


def test_a_changed_conclusion_is_shown_line_by_line() -> None:
    def change(measured: Any) -> None:
        measured["conclusions"][1] = "verdict: all 3 disagree."

    ((text, beyond),) = compare(MEASURED, other(change))
    assert beyond
    assert "    - verdict: all 3 agree.\n" in text
    assert "    + verdict: all 3 disagree." in text
    assert "residuals" not in text


def test_a_job_that_fails_now_differs_in_all_that_it_had() -> None:
    failed = {"status": 2, "conclusions": ["mine.yaml: no such entry"]}
    found = list(compare(MEASURED, failed))
    assert all(beyond for text, beyond in found if not text.startswith("other bytes"))
    said = "\n".join(text for text, _ in found)
    for word in ("exit status 0, now 2", "no such entry", "log density", "k_s", "log evidence"):
        assert word in said


def test_packed_numbers_come_back_to_the_last_bit() -> None:
    values = np.array([0.1, -3603.123456789012, 5e-324, np.inf, -np.inf, 0.0])
    assert np.array_equal(unpacked(packed(values)), values)


def test_points_lie_between_the_draws_and_are_all_different() -> None:
    rng = np.random.default_rng(1)
    draws = {
        "k_s": np.exp(rng.normal(-1.0, 0.3, baseline.DRAWS)),
        "t_0": rng.normal(0.0, 0.05, baseline.DRAWS),
    }
    points = spread(draws)
    for name, values in draws.items():
        assert len(np.unique(points[name])) == baseline.POINTS
        assert values.min() <= points[name].min()
        assert points[name].max() <= values.max()
    # A product that all draws share is shared by the points: they stay on its ridge.
    ridge = spread({"k_s": draws["k_s"], "j_1": 0.25 / draws["k_s"]})
    assert ridge["k_s"] * ridge["j_1"] == pytest.approx(0.25, rel=1e-13)


PRINTED = """mine: 1001 samples of w_1; rig motor_shaft; 1 unknowns
  searching the MAP ...
MAP: 4 of 4 searches reached the same maximum
  still at work, for 12 s by now
next: add these lines to the config
parameters:
  v_d: {prior: uniform, low: 0.0, high: 8.0}
   19 %  refitting 26 candidates, about 42 s left
  making tables and figures ...
sampling: converged after 200 steps of 4 x 256 walkers

       unit     nominal      mean       sd
k_s    N m/rad     0.26    0.2594   0.0019

fit: the residuals look like the noise.

verdict: all agree.
results: /tmp/results/ (report.html)
"""


def test_conclusions_are_what_is_printed_without_progress_and_tables_of_numbers() -> None:
    assert baseline.conclusions(PRINTED) == [
        "mine: 1001 samples of w_1; rig motor_shaft; 1 unknowns",
        "MAP: 4 of 4 searches reached the same maximum",
        "next: add these lines to the config",
        "parameters:",
        "  v_d: {prior: uniform, low: 0.0, high: 8.0}",
        "fit: the residuals look like the noise.",
        "verdict: all agree.",
    ]


def test_a_results_folder_is_read_with_its_errors_and_compares_equal(tmp_path: Path) -> None:
    folder = run().save(tmp_path / "mine")
    config = folder / "config.yaml"
    found = baseline.read(config, folder, None)
    draws = run().draws["k_s"]
    mean, sd, mean_error, sd_error = found["quantities"]["k_s"]
    assert (mean, sd) == pytest.approx((draws.mean(), draws.std(ddof=1)), rel=1e-3)
    row = next(row for row in run().judge().rows if row["name"] == "k_s")
    effective = min(row["ess_bulk"], row["ess_tail"])
    assert mean_error == pytest.approx(sd / np.sqrt(effective), rel=1e-2)
    # As of a normal distribution, which this posterior nearly is.
    assert sd_error == pytest.approx(sd / np.sqrt(2 * effective), rel=0.2)
    assert {"omega_n", "log evidence"} <= found["quantities"].keys()
    assert {"summary.csv", "derived.csv", "verdict.csv", "draws"} <= found["sha256"].keys()
    values = spread({name: unpacked(text) for name, text in found["draws"].items()})
    assert np.array_equal(unpacked(found["log_density"]), bd.load(config).log_density(values))
    again = {**baseline.read(config, folder, found["draws"]), "status": 0, "conclusions": []}
    assert list(compare({**found, "status": 0, "conclusions": []}, again)) == []
    assert "log_density" not in baseline.read(config, folder, {"k_s": found["draws"]["k_s"]})


def test_variants_of_rows_of_the_zoo_are_what_their_names_say(tmp_path: Path) -> None:
    case = {}
    for name in ("jitter", "latent_torque", "two_experiments"):
        (tmp_path / name).mkdir()
        case[name] = bd.load(baseline.prepare(name, tmp_path / name))
    t = np.loadtxt(tmp_path / "jitter/records/chirp.csv", delimiter=",", skiprows=1)[:, 0]
    assert np.ptp(np.diff(t)) > 0.3 * np.mean(np.diff(t))
    assert np.diff(t).min() > 0.0
    assert {"s_d", "tau_d"} <= {*case["latent_torque"].unknowns}
    assert {"c_m_early", "c_m_late"} <= {*case["two_experiments"].unknowns}


def test_the_stored_baseline_has_all_jobs_and_finite_densities_and_is_small() -> None:
    stored = json.loads(baseline.STORED.read_text(encoding="utf-8"))
    assert tuple(stored) == baseline.NAMES
    assert baseline.STORED.stat().st_size < 300_000
    for name, measured in stored.items():
        density = unpacked(measured["log_density"])
        assert len(density) == baseline.POINTS, name
        assert np.isfinite(density).all(), name
        assert measured["conclusions"], name


def test_the_command_writes_compares_and_fails_where_something_is_beyond_the_limits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = MEASURED
    monkeypatch.setattr(baseline, "STORED", tmp_path / "baseline.json")
    monkeypatch.setattr(baseline, "ProcessPoolExecutor", lambda jobs, _: ThreadPoolExecutor(jobs))
    monkeypatch.setattr(baseline, "measure", lambda name, draws: {**now, "seconds": 1.0})
    some = ["--only", "nominal_step", "lags"]
    assert baseline.main(some) == 1
    assert "is not stored" in capsys.readouterr().out
    assert baseline.main([*some, "--write"]) == 0
    assert baseline.main(some) == 0
    assert "nominal_step: the same" in capsys.readouterr().out
    now = other(lambda measured: measured["sha256"].update(draws="0"))
    assert baseline.main(some) == 0
    assert baseline.main([*some, "--bytes"]) == 1
    now = other(by_errors(10.0, ("k_s", 0)))
    assert baseline.main(["--only", "lags"]) == 1
    assert "  BEYOND means, in standard errors: k_s 7.1" in capsys.readouterr().out
    assert baseline.main(["--only", "lags", "--write"]) == 0
    assert baseline.main(["--only", "lags"]) == 0
    assert json.loads(baseline.STORED.read_text())["nominal_step"] == MEASURED
    monkeypatch.setattr(baseline, "NAMES", ("lags",))
    assert baseline.main(["--only", "lags"]) == 1
    assert "nominal_step" in capsys.readouterr().out
    with pytest.raises(SystemExit) as refused:
        baseline.main(["--only", "no_such_job"])
    assert refused.value.code == 2
