"""What a config says of sensors and of the start: numbers in SI, and every mistake at its entry."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support import two_experiments
from support.config_mistakes import check_mistakes

from bayesdrill.basics.errors import InputError
from bayesdrill.config.job import Job, prepare
from bayesdrill.config.schema.json_schema import json_schema
from bayesdrill.inference.priors import LogNormal, TruncatedNormal, Uniform

LAG = "lag: {prior: normal, mean: 0, sd: 20, unit: ms}"
OFFSET = "offset: {prior: normal, mean: 0, sd: 10}"
SHARED = ("shared: [lag_theta_1, offset_theta_1]\n", "")
W_1 = "w_1: {column: w_1, unit: rad/s, sigma: 0.1"
EXPERIMENTS = "experiments:\n  slow"


def initial(entry: str) -> tuple[str, str]:
    return EXPERIMENTS, f"initial: {entry}\n{EXPERIMENTS}"


def problems(folder: Path, *changes: tuple[str, str]) -> list[str]:
    """Places without the folder, and messages."""
    with pytest.raises(InputError) as caught:
        prepare(two_experiments.write(folder, *changes))
    return [str(one).replace(f"{folder}/", "") for one in caught.value.problems]


def built(folder: Path, *changes: tuple[str, str]) -> Job:
    return prepare(two_experiments.write(folder, *changes))


def test_a_mistake_is_told_at_its_entry(tmp_path_factory: pytest.TempPathFactory) -> None:
    check_mistakes("sensors", tmp_path_factory, built)


def test_a_state_that_no_channel_tells_of_needs_a_prior(tmp_path: Path) -> None:
    """Of a record of the current alone there is no angle, and nothing drives one."""
    only = (
        f"    theta_1: {{column: theta_1, unit: deg, sigma: 2, {OFFSET},\n"
        f"              {LAG}}}\n    {W_1}}}\n"
    )
    current = "    i: {column: w_1, unit: A, sigma: 0.1}\n"
    changes = [(only, current), SHARED, initial("{theta_1: free}")]
    truth = (", truth: {lag_theta_1: 15, offset_theta_1: -6}", "")
    found = problems(tmp_path, *changes, truth)
    assert [one.partition(": ")[2].partition(": ")[0] for one in found] == ["initial.theta_1"]
    assert "give it a prior" in found[0]


def test_all_of_several_sensors_is_told_at_once(tmp_path: Path) -> None:
    found = problems(
        tmp_path,
        (LAG, "lag: {prior: normal, mean: 0, sd: 20, unit: V}"),
        (OFFSET, "offset: {prior: uniform, low: 2, high: -2}"),
        (W_1, W_1 + ", gain: 0"),
    )
    places = [one.partition(": ")[2].partition(": ")[0] for one in found]
    assert sorted(places) == [
        "record.channels.theta_1.lag",
        "record.channels.theta_1.offset",
        "record.channels.w_1.gain",
    ]


def test_numbers_and_priors_are_in_si(tmp_path: Path) -> None:
    """Each by its own unit: an offset in that of the column, a time in s, a state in SI."""
    job = built(
        tmp_path,
        (
            W_1,
            W_1
            + ", gain: {prior: log_normal, median: 0.9, sd_log: 0.1}, lag: {value: 3, unit: ms}",
        ),
        ("  v: 8.0", "  v: 8.0\n  t_0: {prior: uniform, low: -50, high: 100, unit: ms}"),
        initial(
            "{theta_2: {prior: truncated_normal, mean: 10, sd: 90, low: -45, high: 90, unit: deg}}"
        ),
        ("walkers: 16", "walkers: 24"),
    )
    space = job.problem.posterior.space
    degree = np.pi / 180
    assert space.priors["offset_theta_1"] == TruncatedNormal(0.0, 10 * degree, -np.inf, np.inf)
    assert space.priors["lag_theta_1"] == TruncatedNormal(0.0, 0.02, -np.inf, np.inf)
    assert space.priors["gain_w_1_fast"] == LogNormal(0.9, 0.1)
    t_0 = space.priors["t_0_slow"]
    assert isinstance(t_0, Uniform)
    assert (t_0.low, t_0.high) == pytest.approx((-0.05, 0.1))
    begin = space.priors["theta_2_0_fast"]
    assert isinstance(begin, TruncatedNormal)
    assert (begin.low, begin.high, begin.mean) == pytest.approx(
        (-45 * degree, 90 * degree, 10 * degree)
    )
    assert space.fixed["lag_w_1_slow"] == pytest.approx(0.003)
    assert job.problem.units.format_value("offset_theta_1", 0.1) == "5.73 deg"
    assert job.problem.units.format_value("t_0_slow", 0.04) == "40 ms"


def test_a_moving_start_leaves_out_what_a_lag_may_show_of_before(tmp_path: Path) -> None:
    """Of the lagging channel alone, up to where the prior ends; of a rig at rest nothing."""
    lag = (LAG, "lag: {prior: uniform, low: 0, high: 100, unit: ms}")
    moving = built(tmp_path, lag, initial("{w_1: 3.0}")).problem.observations[0].experiment
    assert moving.counts == (98, 101)  # at 0, 0.04 and 0.08 s
    (told,) = [one for one in moving.told if "left out" in one]
    assert told.startswith("theta_1: 3 samples")
    turned = built(tmp_path, lag, initial("{theta_1: 0.5, theta_2: 0.5}"))
    assert turned.problem.observations[0].experiment.counts == (101, 101)


def test_free_states_are_as_wide_as_the_channels(tmp_path: Path) -> None:
    job = built(tmp_path, initial("free"), ("walkers: 16", "walkers: 32"))
    space = job.problem.posterior.space
    table = [
        line.split(",")
        for line in two_experiments.records(two_experiments.PAIR)["fast.csv"].splitlines()[1:]
    ]
    y = np.array(table, dtype=float)[:, 1:] * [np.pi / 180, 1.0]
    found = space.priors["theta_1_0_fast"]
    assert isinstance(found, TruncatedNormal)
    assert (found.mean, found.sd) == pytest.approx((y[0, 0], 2 * np.ptp(y[:, 0])))
    other = space.priors["w_2_0_fast"]
    assert isinstance(other, TruncatedNormal)
    assert other.sd == pytest.approx(2 * np.abs(y[:, 1]).max(), rel=0.5)
    assert space.priors["w_1_0_slow"] != space.priors["w_1_0_fast"]


def test_free_states_know_the_gain_of_their_sensor(tmp_path: Path) -> None:
    """Mutant killed: a start with the sign of its sensor."""
    turned = (
        "theta_1: {column: theta_1, unit: deg,",
        "theta_1: {column: theta_1, unit: deg, gain: -2.0,",
    )
    plain, other = (
        built(tmp_path, initial("free"), ("walkers: 16", "walkers: 32"), *changes)
        for changes in ((), (turned,))
    )
    before, after = (job.problem.posterior.space.priors["theta_1_0_fast"] for job in (plain, other))
    assert isinstance(before, TruncatedNormal)
    assert isinstance(after, TruncatedNormal)
    assert (after.mean, after.sd) == pytest.approx((-0.5 * before.mean, 0.5 * before.sd))


def test_the_schema_describes_every_entry() -> None:
    tree = json.loads(json_schema())
    text = json_schema()
    for word in ("experiments", "shared", "own"):
        assert tree["properties"][word]["description"]
    kinds = tree["$defs"]
    for entry in ("gain", "offset", "lag"):
        assert kinds["ChannelSpec"]["properties"][entry]["description"]
        assert kinds["InputColumn"]["properties"][entry]["description"]
    own = kinds["ExperimentSpec"]["properties"]
    assert {"record", "inputs", "initial", "parameters", "held_out"} == set(own)
    assert own["held_out"]["description"]
    assert kinds["Inputs"]["properties"]["t_0"]["description"]
    assert kinds["Initial"]["properties"]["state"]["description"]
    assert "experiment has" not in text
