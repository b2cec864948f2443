"""Populations of simulated runs: their runs, rigs, noted columns, nominal table and next run."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.case_tables import run_cases
from support.simulated_campaigns import BRIEF, SimulatedRuns, interim_posterior, normal_runs

from bayesdrill.basics.json_records import as_data, from_data
from bayesdrill.basics.progress import SILENT
from bayesdrill.basics.symbols import PARAMETERS
from bayesdrill.campaigns.charts import runs_figure
from bayesdrill.campaigns.conclusion import CampaignRecord, concluded
from bayesdrill.campaigns.draws import FittedRun
from bayesdrill.campaigns.fit import PopulationFit, fit_population
from bayesdrill.campaigns.population import NominalRange, PopulationSettings
from bayesdrill.campaigns.sections import campaign_sections
from bayesdrill.report.section import as_markdown

RUNS, SPREAD = 40, np.array([0.04, 0.02])
SETTINGS = PopulationSettings(targets=BRIEF, chains=2)


def sound_runs() -> SimulatedRuns:
    return normal_runs(np.random.default_rng(11), RUNS, SPREAD, sd=0.015)


@cache
def sound_fit() -> PopulationFit:
    nominal = {"p0": NominalRange(value=0.02, low=0.02, high=0.02)}
    nominal |= {"p1": NominalRange(value=0.2, low=0.18, high=0.22)}
    settings = replace(SETTINGS, nominal=nominal)
    return fit_population(
        sound_runs().draws(np.random.default_rng(12)), settings, np.random.default_rng(13), SILENT
    )


@cache
def fit_of_three_rigs() -> PopulationFit:
    """Fit three rigs, a temperature with a gap, a clock that stands still, and a jump of 10 %."""
    rng = np.random.default_rng(21)
    index = np.arange(60)
    temperature = rng.standard_normal(60)
    z = SPREAD * rng.standard_normal((60, 2))
    z += np.array([[0.0, 0.0], [0.3, 0.0], [0.1, -0.2]])[index % 3]
    z[:, 1] += 0.03 * temperature
    z[:, 0] += np.where(index < 45, 0.0, 0.1)
    noted = {"temperature": 20 + 5 * temperature, "clock": np.ones(60)}
    noted["temperature"][[3, 30]] = np.nan
    runs = SimulatedRuns(
        z=z,
        sd=np.full(z.shape, 0.01),
        rigs=tuple("abc"[k % 3] for k in index),
        hours=index.astype(float),
        noted=noted,
    )
    return fit_population(runs.draws(rng), replace(SETTINGS, max_sweeps=800), rng, SILENT)


def test_population_of_sound_runs_holds_the_truth_and_flags_none() -> None:
    fit = sound_fit()
    assert fit.convergence.converged
    assert [run.name for run in fit.runs if run.outlier] == []
    for population, spread in zip(fit.populations, SPREAD, strict=True):
        assert abs(population.centre.mean) < 3 * population.centre.sd
        assert population.spread.mean == pytest.approx(spread, rel=0.35)
        # The next run is drawn from the population, whose spread the central 68 % show.
        width = population.next_run.high_90 - population.next_run.low_90
        assert width == pytest.approx(2 * 1.645 * spread, rel=0.4)
    assert fit.leave_one_out.within_50 == pytest.approx(0.5, abs=0.15)
    assert fit.leave_one_out.within_90 == pytest.approx(0.9, abs=0.08)


def test_shrunk_runs_are_nearer_to_the_truth_than_runs_alone() -> None:
    z = sound_runs().z
    alone = np.array([run.alone for run in sound_fit().runs])
    shrunk = np.array([run.shrunk for run in sound_fit().runs])
    assert ((shrunk - z) ** 2).mean() < 0.9 * ((alone - z) ** 2).mean()
    # Without its interim prior a run alone is its normal estimate.
    sds = np.array([run.alone_sd for run in sound_fit().runs])
    assert np.median(sds) == pytest.approx(0.015, rel=0.1)
    assert all((run.shrunk_sd < run.alone_sd).mean() >= 0.5 for run in sound_fit().runs)


def test_a_table_agrees_if_runs_differ_by_more_than_it_is_off() -> None:
    near, far = (population.table for population in sound_fit().populations)
    assert (near.agrees, far.agrees) == (True, False)
    assert far.offset.mean == pytest.approx(-0.2, abs=0.02)


def test_a_jump_moves_the_population_to_its_level_at_the_end() -> None:
    fit = fit_of_three_rigs()
    jumping, constant = fit.charts
    (change,) = jumping.history.changes
    assert abs(change.run - 45) <= 1
    assert abs(change.size - 0.1) < 3 * change.size_sd
    assert (jumping.alarm, constant.alarm) == (True, False)
    assert np.median(jumping.score[45:]) > np.median(jumping.score[:45]) + 1.0
    levels = [rig.level for rig in fit.rigs if rig.product == "p0"]
    for level, truth in zip(levels, (0.1, 0.4, 0.2), strict=True):
        assert abs(level.mean - truth) < 3 * level.sd
        assert level.sd < 0.03


def test_rigs_have_levels_and_a_new_rig_is_less_certain() -> None:
    fit = fit_of_three_rigs()
    assert [(rig.rig, rig.product) for rig in fit.rigs[:3]] == [
        ("a", "p0"),
        ("a", "p1"),
        ("b", "p0"),
    ]
    for population in fit.populations:
        assert population.rig_spread is not None
        known = [rig.next_run.sd for rig in fit.rigs if rig.product == population.product]
        assert population.next_run.sd > 1.5 * max(known)


def test_a_noted_column_with_gaps_explains_its_share_of_the_spread() -> None:
    fit = fit_of_three_rigs()
    assert fit.missing == {"temperature": 2}
    assert fit.ignored == ("clock",)
    none, slope = fit.noted
    assert abs(none.slope.mean) < 3 * none.slope.sd
    assert abs(slope.slope.mean - 0.03) < 3 * slope.slope.sd + 0.004  # its sd is one by chance only
    without_rigs = 0.03**2 / (0.03**2 + 0.02**2)
    assert none.share.mean < 0.05 < slope.share.mean < without_rigs


@pytest.mark.slow
def test_a_vague_run_hardly_changes_the_population_and_a_badly_described_one_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("bayesdrill.campaigns.mixture.MAX_COMPONENTS", 1)
    rng = np.random.default_rng(31)
    draws = normal_runs(rng, 8, np.array([0.02]), sd=0.005).draws(rng, 300)
    before = fit_population(draws, SETTINGS, rng, SILENT).populations[0].centre
    z, log_interim = interim_posterior(np.zeros(1), np.array([3.0]), rng, 300, width=1.0)
    vague = FittedRun(log_products=z, log_interim=log_interim)
    places = np.repeat([-0.02, 0.02], 150)[:, None]
    odd = FittedRun(log_products=places, log_interim=np.zeros(300))
    names = [replace(draws.runs[0], name=name) for name in ("vague", "odd")]
    runs = (*draws.runs, *names)
    campaign = replace(draws, runs=runs, fits=(*draws.fits, vague, odd))
    few = replace(SETTINGS, max_sweeps=50)
    assert fit_population(campaign, few, rng, SILENT).misdescribed == ("odd",)
    campaign = replace(draws, runs=runs[:-1], fits=(*draws.fits, vague))
    after = fit_population(campaign, SETTINGS, rng, SILENT).populations[0].centre
    assert abs(after.mean - before.mean) < 0.2 * before.sd
    assert after.sd == pytest.approx(before.sd, rel=0.15)


def test_a_fit_is_the_same_after_it_is_written_and_read() -> None:
    data = as_data(fit_of_three_rigs())
    assert as_data(from_data(PopulationFit, data)) == data


def test_two_runs_are_too_few_for_a_population() -> None:
    rng = np.random.default_rng(41)
    with pytest.raises(ValueError, match="at least 3 runs, but has 2"):
        fit_population(normal_runs(rng, 2, SPREAD).draws(rng), SETTINGS, rng, SILENT)


def test_a_foreign_run_among_twelve_is_flagged_and_widens_the_spread_little() -> None:
    """Kills the mutant without foreign runs, which finds a spread of 3.3 % and flags none."""
    rng = np.random.default_rng(0)
    z = np.array([0.005, 0.012]) * rng.standard_normal((12, 2))
    z[-1, 1] += 0.1
    draws, few = SimulatedRuns(z=z, sd=np.full(z.shape, 0.005)).draws(rng), 800
    fit = fit_population(draws, replace(SETTINGS, max_sweeps=few), rng, SILENT)
    assert [run.name for run in fit.runs if run.outlier] == ["run 11"]
    assert fit.populations[1].spread.mean < 0.025


def conclude(fit: PopulationFit, **given: Any) -> CampaignRecord:
    empty = {name: {} for name in ("left_out", "not_used", "doubts", "misfit", "reasons")}
    return concluded("rig", "mark", fit, **empty | given)


def test_a_jump_is_an_alarm_and_a_finding_with_its_run_and_interval() -> None:
    fit = fit_of_three_rigs()
    (change,) = fit.charts[0].history.changes
    record = conclude(fit, not_used={"run 99": "no samples"})
    (history,) = record.history
    size = f"{100 * np.expm1(change.size):+.2g} % +- {100 * change.size_sd:.2g} %"
    assert history.startswith(f"p0 changes by {size} at {fit.timed[change.run]} (probability ")
    assert history.endswith(f"interval {fit.timed[change.first]} to {fit.timed[change.last]})")
    assert [(alarm.kind, alarm.run, alarm.product) for alarm in record.alarms] == [
        ("not used", "run 99", ""), ("changes", "", "p0")
    ]  # fmt: skip
    finding = history.split(" (")[0]
    assert record.verdict == f"60 runs: {finding}; all runs belong together; not used: run 99"
    page = as_markdown("rig", campaign_sections(conclude(replace(fit, ignored=("load", "oil")))))
    assert f"{100 * fit.leave_one_out.within_50:.0f} % of its products lie in the 50 %" in page
    assert "constant or have fewer than 3 numbers: load and oil" in page


@run_cases("kind, words", [("drift", "p0 drifts by +"), ("walk", "p0 wanders by about ")])
def test_a_drift_and_a_random_walk_are_named_with_their_size(kind: str, words: str) -> None:
    fit = fit_of_three_rigs()
    history = replace(fit.charts[0].history, probabilities={kind: 0.97, "changes": 0.03}, drift=0.1)
    charts = [replace(fit.charts[0], history=history, alarm=alarm) for alarm in (True, False)]
    said, weak = (conclude(replace(fit, charts=(chart,))).history[0] for chart in charts)
    assert said.startswith(words)
    assert weak.startswith(words.replace("p0 ", "p0 may ").replace("s by", " by"))
    assert said.endswith("(probability 97 %)")


def test_outliers_are_named_with_the_first_known_reason_and_tables_that_disagree() -> None:
    fit = sound_fit()
    foreign = replace(fit.runs[2], outlier=True, worst="p1", sds=6.2)
    fit = replace(fit, runs=(*fit.runs[:2], foreign, *fit.runs[3:]))
    (alarm,) = conclude(fit, misfit={foreign.name: ("it follows no law", "a gear")}).outliers
    assert alarm.sentence == "run 2 is 6.2 sds from other runs in p1; it follows no law"
    record = conclude(fit, reasons={foreign.name: "a gear of 7:1"}, misfit={foreign.name: ("odd",)})
    assert record.outliers[0].sentence.endswith("; a gear of 7:1")
    steady = "fewer than 8 different times, so drifts are not searched"
    assert record.verdict == (
        f"40 runs: {steady}; run 2 does not belong; the nominal values disagree in p1"
    )


@run_cases("timed", [True, False])
def test_runs_are_drawn_over_time_relative_to_the_level_at_the_end(timed: bool) -> None:
    """Without times they are numbered; those that do not belong have a mark of their own."""
    fit = fit_of_three_rigs() if timed else sound_fit()
    fit = replace(fit, runs=(replace(fit.runs[0], outlier=not timed), *fit.runs[1:]))
    runs = [SimpleNamespace(name=run.name, time=3600.0 * k if timed else None)
            for k, run in enumerate(fit.runs)]  # fmt: skip
    plan: Any = SimpleNamespace(runs=runs, spec=SimpleNamespace(time_unit="h"))
    symbols = [PARAMETERS[name] for name in ("k_s", "j_1")]
    figure, points = runs_figure(plan, fit, [(1, 0), (1, -1)], symbols)
    first, last = points[0], points[len(runs) - 1]
    assert (first.x, last.x) == ((0.0, 59.0) if timed else (1.0, 40.0))
    shown = fit.runs[-1].shrunk[0] - fit.populations[0].centre.mean
    assert last.y == pytest.approx(100 * np.expm1(shown))
    texts = {text.get_text() for text in figure.legends[0].get_texts()}
    assert ("does not belong" in texts, "nominal value" in texts) == (not timed, not timed)
    assert {panel.get_xlabel() for panel in figure.axes} <= {"time [h]" if timed else "run", ""}
