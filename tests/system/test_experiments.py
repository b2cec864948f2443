"""Several experiments from simulated records to reports: what a user gets, and may do with it."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import xarray
from matplotlib.figure import Figure
from support import command_line, two_experiments

import bayesdrill as bd
from bayesdrill.config.job import prepare
from bayesdrill.results import provenance
from bayesdrill.tasks import calibrate


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a finished run of the pair, with its figure of the fit."""
    folder = tmp_path_factory.mktemp("pair")
    config = two_experiments.write(folder, ("figures: []", "figures: [fit, predictive_check]"))
    ran = command_line.cli("posterior", config, "-o", folder / "out", "--processes", "1")
    assert ran.status == 0, ran.text
    assert "sampling: converged after " in ran.out
    return folder / "out"


def rows(path: Path) -> dict[str, dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        return {row["name"]: row for row in csv.DictReader(file)}


def test_the_posterior_holds_what_the_records_were_made_with(done: Path) -> None:
    """Within 4 sd, in SI; and it is much narrower than the prior."""
    found = rows(done / "summary.csv")
    truth = {**bd.nominal(), **two_experiments.TRUTH}
    assert list(found) == ["k_e", "j_1", "offset_theta_1", "lag_theta_1"]
    for name, row in found.items():
        mean, sd = float(row["mean"]), float(row["sd"])
        assert abs(mean - truth[name]) < 4 * sd, name
        assert float(row["shrinkage"]) > 0.9


def test_the_report_speaks_of_several_records_in_the_units_of_the_config(done: Path) -> None:
    text = (done / "summary.md").read_text(encoding="utf-8")
    assert "verdict: these records determine 2 of the 2" in text
    assert "this record" not in text
    assert "## What these records can show, at the MAP" in text
    assert "of theta_1 in slow" in text
    assert "| offset_theta_1 | deg |" in text
    assert "| lag_theta_1 | ms |" in text
    assert "(figures/fit_1.png)" in text
    page = (done / "report.html").read_text(encoding="utf-8")
    assert "slow: Record, model at the MAP" in page
    assert "fast: Record, model at the MAP" in page


def test_the_tree_has_each_channel_of_each_experiment(done: Path) -> None:
    with xarray.open_datatree(done / "posterior.nc") as tree:
        assert set(tree["posterior"].data_vars) == {"k_e", "j_1", "offset_theta_1", "lag_theta_1"}
        for group in ("posterior_predictive", "log_likelihood", "observed_data"):
            assert set(tree[group].data_vars) == {
                f"{name}_{label}" for name in ("theta_1", "w_1") for label in ("slow", "fast")
            }
        assert tree["observed_data"]["w_1_slow"].dims == ("time_slow",)
        inputs = tree["constant_data"]
        assert float(inputs["v_slow"]) == 4.0
        assert float(inputs["v_fast"]) == 8.0
        assert tree["posterior"]["lag_theta_1"].attrs["units"] == "s"


def test_a_finished_run_reads_its_own_config_again(done: Path) -> None:
    """The one with all defaults has the fingerprint of the one that was given."""
    given = prepare(done.parent / "all.yaml")
    resolved = prepare(done / "config.resolved.yaml")
    one, other = (provenance.fingerprint(job.config, job.problem) for job in (given, resolved))
    assert one == other
    assert {"the record of slow", "the record of fast"} <= set(one)
    before = (done / "summary.md").read_text(encoding="utf-8")
    ran = command_line.cli("report", done, "--processes", "1")
    assert ran.status == 0, ran.text
    assert (done / "summary.md").read_text(encoding="utf-8") == before


def test_verify_sees_that_all_belongs_together(done: Path, tmp_path: Path) -> None:
    ran = command_line.cli("verify", done)
    assert ran.status == 0, ran.text
    config = done / "config.yaml"
    text = config.read_text(encoding="utf-8")
    config.write_text(text.replace("inputs: {v: 4.0}", "inputs: {v: 4.5}"), encoding="utf-8")
    ran = command_line.cli("verify", done)
    config.write_text(text, encoding="utf-8")
    assert ran.status == 2
    assert "config.yaml: is not the config of this run" in ran.err


def test_a_run_can_be_resumed_and_not_with_another_record(done: Path) -> None:
    config = done.parent / "all.yaml"
    ran = command_line.cli("posterior", config, "-o", done, "--resume", "--processes", "1")
    assert ran.status == 0, ran.text
    record = done.parent / "fast.csv"
    text = record.read_text(encoding="utf-8")
    lines = text.splitlines()
    lines[-1] = ",".join([lines[-1].split(",")[0], "3700", "17"])
    record.write_text("\n".join(lines) + "\n", encoding="utf-8")
    ran = command_line.cli("posterior", config, "-o", done, "--resume", "--processes", "1")
    record.write_text(text, encoding="utf-8")
    assert ran.status == 2
    assert "the record of fast" in ran.err


@pytest.mark.slow
def test_a_joint_run_is_laid_over_a_single_one(done: Path, tmp_path: Path) -> None:
    """The joint one is narrower; names of sensors are one."""
    text = two_experiments.PAIR
    begin, end = text.index("experiments:"), text.index("parameters:")
    single = (text[:begin] + text[end:]).replace("name: pair", "name: single")
    single = single.replace("  time: {column", "  file: fast.csv\n  time: {column")
    (tmp_path / "fast.csv").write_text(
        two_experiments.records(two_experiments.PAIR)["fast.csv"], encoding="utf-8"
    )
    (tmp_path / "single.yaml").write_text(single, encoding="utf-8")
    ran = command_line.cli(
        "posterior", tmp_path / "single.yaml", "-o", tmp_path / "one", "--processes", "1"
    )
    assert ran.status == 0, ran.text
    both = [
        float(rows(at / "summary.csv")["offset_theta_1"]["sd"]) for at in (done, tmp_path / "one")
    ]
    assert both[0] < both[1]
    ran = command_line.cli("report", done, tmp_path / "one", "-o", tmp_path / "both")
    assert ran.status == 0, ran.text
    table = (tmp_path / "both" / "overlay.md").read_text(encoding="utf-8")
    assert "| lag_theta_1 | ms |" in table
    assert "theta_1: offset, lag" in table
    assert "Sensing(" not in table


def test_the_maximum_predicts_every_experiment(tmp_path: Path) -> None:
    config = two_experiments.write(tmp_path)
    ran = command_line.cli("map", config, "-o", tmp_path / "map", "--processes", "1")
    assert ran.status == 0, ran.text
    found = {path.name for path in (tmp_path / "map").rglob("*.*")}
    assert {"prediction_1.csv", "prediction_2.csv", "fit_1.pdf", "fit_2.pdf"} <= found
    values = json.loads((tmp_path / "map" / "map.json").read_text(encoding="utf-8"))["values"]
    for name, truth in two_experiments.TRUTH.items():
        assert values[name] == pytest.approx(truth, rel=0.2)
    assert command_line.cli("verify", tmp_path / "map").status == 0


def test_python_loads_several_and_shows_each(done: Path) -> None:
    case = bd.load(done.parent / "all.yaml")
    assert case.unknowns == ("k_e", "j_1", "offset_theta_1", "lag_theta_1")
    assert "columns of fast" in case.preview()
    assert "k_e" in str(case.identify("k_e"))
    run = bd.open(done)
    assert isinstance(run.plot("fit", part=2), Figure)
    assert "these records determine" in str(run.judge())


def test_python_has_sensors_of_arrays() -> None:
    """A lag and an offset that were put into a response by hand come out again."""
    t = np.arange(121) * 0.03
    nominal = bd.nominal()
    shown = bd.respond("motor_shaft", nominal, t, {"v": 8.0}, ["theta_1", "w_1"])
    late = bd.respond("motor_shaft", nominal, t[1:] - 0.012, {"v": 8.0}, ["theta_1"])
    rng = np.random.default_rng(6)
    angle = 0.9 * np.append(0.0, late["theta_1"]) + 0.3 + 0.02 * rng.standard_normal(121)
    speed = shown["w_1"] + 0.05 * rng.standard_normal(121)
    gain = {"prior": "log_normal", "median": 1, "sd_log": 0.2}
    lag = {"prior": "normal", "mean": 0, "sd": 0.02}
    offset = {"prior": "normal", "mean": 0, "sd": 1}
    case = bd.case(
        t,
        {
            "theta_1": bd.Channel(angle, "rad", 0.02, gain=gain, offset=offset, lag=lag),
            "w_1": bd.Channel(speed, "rad/s", 0.05),
        },
        {"v": 8.0},
        {**dict.fromkeys(nominal, "nominal"), "k_s": {"prior": "uniform", "low": 0.1, "high": 0.5}},
    )
    assert case.unknowns == ("k_s", "gain_theta_1", "offset_theta_1", "lag_theta_1")
    values = case.find_map().values
    assert values["gain_theta_1"] == pytest.approx(0.9, abs=0.003)
    assert values["offset_theta_1"] == pytest.approx(0.3, abs=0.03)
    assert values["lag_theta_1"] == pytest.approx(0.012, abs=0.003)


def test_records_are_simulated_one_for_each_and_never_over_what_is_there(tmp_path: Path) -> None:
    config = two_experiments.write(tmp_path)
    made = bd.simulate(config, tmp_path / "new", seed=3)
    assert [path.name for path in made.files] == ["slow.csv", "fast.csv"]
    assert made.samples == 202
    again = command_line.cli("simulate", config, "-o", tmp_path / "new")
    assert again.status == 2
    assert again.err.count("exists already") == 1
    (tmp_path / "slow.csv").unlink()
    ran = command_line.cli("simulate", config)
    assert ran.status == 2
    assert (
        "fast.csv: is read by this command, or named by its config, and never replaced" in ran.err
    )
    assert not (tmp_path / "slow.csv").exists()  # nothing is written where one of them cannot be
    ran = command_line.cli("simulate", config, "-o", config)
    assert ran.status == 2
    assert "is no folder" in ran.err
    same = two_experiments.write(tmp_path, ("{file: fast.csv}", "{file: slow.csv, window: [0, 3]}"))
    ran = command_line.cli("simulate", same, "-o", tmp_path / "other")
    assert ran.status == 2
    assert "experiments.fast.record.file: another experiment is simulated into" in ran.err


def test_simulated_noise_differs_between_experiments_and_truth_is_what_is_said(
    tmp_path: Path,
) -> None:
    """Against the response of names: a lag, an offset and a moment are where `truth:` has them."""
    config = two_experiments.write(
        tmp_path,
        ("inputs: {v: 4.0}", "inputs: {v: 8.0, t_0: {prior: normal, mean: 0.1, sd: 0.1}}"),
        ("offset_theta_1: -6}", "offset_theta_1: -6, t_0: 0.3}"),
    )
    bd.simulate(config, tmp_path / "new", seed=3)
    found = {
        name: np.loadtxt(tmp_path / "new" / f"{name}.csv", delimiter=",", skiprows=1)
        for name in ("slow", "fast")
    }
    t = found["fast"][:, 0]
    clean = bd.respond(
        "motor_shaft", bd.nominal(), np.arange(4001) * 0.001, {"v": 8.0}, ["theta_1", "w_1"]
    )

    def at(times: np.ndarray, name: str) -> np.ndarray:
        return np.where(times < 0, 0.0, np.interp(times, np.arange(4001) * 0.001, clean[name]))

    left = []
    for name, moment in (("fast", 0.0), ("slow", 0.3)):
        angle = np.degrees(at(t - 0.015 - moment, "theta_1")) - 6
        left.append(found[name][:, 1] - angle)
        assert left[-1].std() == pytest.approx(2, rel=0.25)
        assert (found[name][:, 2] - at(t - moment, "w_1")).std() == pytest.approx(0.1, rel=0.25)
    assert abs(np.corrcoef(left)[0, 1]) < 0.4


def test_refits_of_free_states_have_the_priors_of_the_run(tmp_path: Path) -> None:
    """And see nothing of the record else; mutant killed: a record that is left in."""
    config = two_experiments.write(
        tmp_path,
        ("experiments:\n  slow", "initial: free\nexperiments:\n  slow"),
        ("walkers: 16", "walkers: 32"),
    )
    one, other = prepare(config).problem, calibrate.prepare(config).problem
    assert dict(one.posterior.space.priors) == dict(other.posterior.space.priors)
    assert not np.nansum(np.abs(other.observations[0].experiment.y))
    seen = [one.experiment.seen for one in other.observations]
    for mine, theirs in zip(one.observations, seen, strict=True):
        assert np.array_equal(mine.experiment.seen, theirs)
