"""The comparison of the baseline reports every kind of change, and passes equal results."""

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.array_cases import run
from support.case_tables import run_cases
from support.small_problems import starts_believed

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
type Change = Callable[[Any], object]


def changed(change: Change) -> Measured:
    """Return the same results with a change."""
    measured = copy.deepcopy(MEASURED)
    change(measured)
    return measured


def by_errors(errors: float, *moments: tuple[str, int]) -> Change:
    """Move means (0) or standard deviations (1) by so many standard errors of one run."""

    def change(measured: Any) -> None:
        for name, number in moments:
            quantity = measured["quantities"][name]
            quantity[number] += errors * quantity[number + 2]

    return change


def with_density(values: Any) -> Change:
    return lambda measured: measured.update(log_density=packed(values))


def at_a_point(factor: float) -> Change:
    return with_density(np.where(np.arange(baseline.POINTS) == 17, factor, 1.0) * LOG_DENSITY)


def other_bytes(measured: Any) -> None:
    measured["sha256"]["summary.csv"] = "0"
    del measured["sha256"]["verdict.csv"]
    measured["sha256"]["torque.csv"] = "4c"


def without_a_mean(measured: Any) -> None:
    measured["quantities"]["k_s"][0] = np.nan


BYTES = "other bytes: summary.csv, verdict.csv, torque.csv"
MEANS, SDS = "means, in standard errors: ", "sds, in standard errors: "
DENSITY = "log density: 1.0e-07 max(1, |log density|) at 1 points"


@run_cases(
    "change, text, beyond",
    [
        (other_bytes, BYTES, False),
        (at_a_point(1.0 + 1e-7), DENSITY, True),
        (with_density(LOG_DENSITY * (1.0 + 1e-11)), "1.0e-11", False),
        (at_a_point(-np.inf), "log density", True),
        (by_errors(10.0, ("k_s", 0)), f"{MEANS}k_s 7.1", True),
        (by_errors(10.0, ("omega_n", 1)), f"{SDS}omega_n 7.1", True),
        (by_errors(10.0, ("log evidence", 0)), f"{MEANS}log evidence 7.1", True),
        (by_errors(5.0, ("k_s", 0)), MEANS, False),
        (by_errors(5.0, ("omega_n", 1)), SDS, False),
        (by_errors(10.0, ("k_s", 0), ("omega_n", 0)), f"{MEANS}k_s 7.1, omega_n 7.1", True),
        (without_a_mean, f"{MEANS}k_s inf", True),
        (lambda of: of["quantities"].pop("omega_n"), "quantities of one run only: omega_n", True),
        (lambda of: of.update(status=3), "exit status 0, now 3", True),
    ],
)
def test_each_change_is_named_and_beyond_the_limits_or_not(
    change: Change, text: str, beyond: bool
) -> None:
    ((message, is_beyond),) = compare(MEASURED, changed(change))
    assert text in message
    assert is_beyond == beyond


def test_equal_results_do_not_differ_and_other_bytes_are_beyond_the_limits_on_request() -> None:
    assert list(compare(MEASURED, json.loads(json.dumps(MEASURED)), same_bytes=True)) == []
    assert list(compare(changed(without_a_mean), changed(without_a_mean))) == []
    assert list(compare(MEASURED, changed(other_bytes), same_bytes=True)) == [(BYTES, True)]


@pytest.mark.slow
def test_a_results_folder_is_read_with_its_errors_and_compares_equal(tmp_path: Path) -> None:
    folder = run().save(tmp_path / "mine")
    config = folder / "config.yaml"
    read = baseline.read(config, folder, None)
    draws = run().draws["k_s"]
    mean, sd, mean_error, sd_error = read["quantities"]["k_s"]
    assert (mean, sd) == pytest.approx((draws.mean(), draws.std(ddof=1)), rel=1e-3)
    row = next(row for row in run().judge().rows if row["name"] == "k_s")
    effective = min(row["ess_bulk"], row["ess_tail"])
    assert mean_error == pytest.approx(sd / np.sqrt(effective), rel=1e-2)
    # As of a normal distribution, which this posterior nearly is.
    assert sd_error == pytest.approx(sd / np.sqrt(2 * effective), rel=0.2)
    assert {"omega_n", "log evidence"} <= read["quantities"].keys()
    assert {"summary.csv", "derived.csv", "verdict.csv", "draws"} <= read["sha256"].keys()
    values = spread({name: unpacked(text) for name, text in read["draws"].items()})
    assert np.array_equal(unpacked(read["log_density"]), bd.load(config).log_density(values))
    ended = {"status": 0, "conclusions": []}
    again = baseline.read(config, folder, read["draws"])
    assert list(compare({**read, **ended}, {**again, **ended})) == []
    assert "log_density" not in baseline.read(config, folder, {"k_s": read["draws"]["k_s"]})


def test_the_stored_baseline_has_all_jobs_and_finite_densities_and_is_small() -> None:
    stored = json.loads(baseline.STORED.read_text(encoding="utf-8"))
    assert tuple(stored) == baseline.NAMES
    assert baseline.STORED.stat().st_size < 300_000
    for name, measured in stored.items():
        density = unpacked(measured["log_density"])
        assert len(density) == baseline.POINTS, name
        assert np.isfinite(density).all(), name
        assert measured["conclusions"], name


@starts_believed()
def test_variants_of_rows_of_the_zoo_are_what_their_names_say(tmp_path: Path) -> None:
    unknowns = {}
    for name in ("jitter", "latent_torque", "two_experiments"):
        (tmp_path / name).mkdir()
        unknowns[name] = {*bd.load(baseline.prepare(name, tmp_path / name)).unknowns}
    t = np.loadtxt(tmp_path / "jitter/records/chirp.csv", delimiter=",", skiprows=1)[:, 0]
    assert np.ptp(np.diff(t)) > 0.3 * np.mean(np.diff(t))
    assert np.diff(t).min() > 0.0
    assert {"s_d", "tau_d"} <= unknowns["latent_torque"]
    assert {"c_m_early", "c_m_late"} <= unknowns["two_experiments"]
