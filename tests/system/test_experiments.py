"""Several experiments in one config, from simulated records to reports; and experiments held out."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray
from scipy.special import logsumexp
from scipy.stats import norm
from support import two_experiments
from support.command_line import CONFIGS, assert_refused, cli, posterior, replace_text, table

import bayesdrill as bd
from bayesdrill.analysis.prediction import held_out
from bayesdrill.config.job import prepare
from bayesdrill.report.words import record_made
from bayesdrill.results.provenance import fingerprint
from bayesdrill.tasks import calibrate


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a finished run of both experiments."""
    folder = tmp_path_factory.mktemp("pair")
    config = two_experiments.write(folder)
    result = posterior(config, folder / "out")
    assert result.status == 0, result.text
    assert "sampling: converged after " in result.out
    return folder / "out"


def test_the_posterior_holds_what_the_records_were_made_with(finished: Path) -> None:
    """Within 4 sd, in SI; and it is much narrower than the prior."""
    summary = table(finished / "summary.csv")
    truth = {**bd.nominal(), **two_experiments.TRUTH}
    assert list(summary) == ["k_e", "j_1", "offset_theta_1", "lag_theta_1"]
    for name, row in summary.items():
        mean, sd = float(row["mean"]), float(row["sd"])
        assert abs(mean - truth[name]) < 4 * sd, name
        assert float(row["shrinkage"]) > 0.9


def test_the_tree_has_each_channel_of_each_experiment(finished: Path) -> None:
    with xarray.open_datatree(finished / "posterior.nc") as tree:
        assert set(tree["posterior"].data_vars) == {"k_e", "j_1", "offset_theta_1", "lag_theta_1"}
        for group in ("posterior_predictive", "log_likelihood", "observed_data"):
            assert set(tree[group].data_vars) == {
                f"{name}_{label}" for name in ("theta_1", "w_1") for label in ("slow", "fast")
            }
        assert tree["observed_data"]["w_1_slow"].dims == ("time_slow",)
        inputs = tree["constant_data"]
        assert (float(inputs["v_slow"]), float(inputs["v_fast"])) == (4.0, 8.0)
        assert tree["posterior"]["lag_theta_1"].attrs["units"] == "s"


def test_a_change_of_one_experiment_is_named_by_verify_and_resume(finished: Path) -> None:
    config, record = finished / "config.yaml", finished.parent / "fast.csv"
    resume = (finished.parent / "all.yaml", finished, "--resume")
    assert cli("verify", finished).status == 0
    assert posterior(*resume).status == 0
    text = config.read_text(encoding="utf-8")
    replace_text(config, "inputs: {v: 4.0}", "inputs: {v: 4.5}")
    changed = cli("verify", finished)
    config.write_text(text, encoding="utf-8")
    assert_refused(changed, "config.yaml: is not the config of this run")
    text = record.read_text(encoding="utf-8")
    replace_text(record, text.splitlines()[-1].partition(",")[2], "3700,17")
    resumed = posterior(*resume)
    record.write_text(text, encoding="utf-8")
    assert_refused(resumed, "the record of fast")


def test_records_of_all_experiments_are_simulated_or_none(tmp_path: Path) -> None:
    config = two_experiments.write(tmp_path)
    simulated = bd.simulate(config, tmp_path / "new", seed=3)
    assert [path.name for path in simulated.files] == ["slow.csv", "fast.csv"]
    assert simulated.samples == 202
    again = cli("simulate", config, "-o", tmp_path / "new")
    assert again.status == 2
    assert again.err.count("exists already") == 1
    (tmp_path / "slow.csv").unlink()
    message = "fast.csv: is read by this command, or named by its config, and is never replaced"
    assert_refused(cli("simulate", config), message)
    assert not (tmp_path / "slow.csv").exists()  # no record is written where one is refused
    assert_refused(cli("simulate", config, "-o", config), "is not a folder")
    same = two_experiments.write(tmp_path, ("{file: fast.csv}", "{file: slow.csv, window: [0, 3]}"))
    message = "experiments.fast.record.file: another experiment is simulated into"
    assert_refused(cli("simulate", same, "-o", tmp_path / "other"), message)


def test_simulated_records_have_the_given_sensors_and_noise_of_their_own(tmp_path: Path) -> None:
    """Against a response: a lag, an offset and a begin are where `truth:` has them."""
    config = two_experiments.write(
        tmp_path,
        ("inputs: {v: 4.0}", "inputs: {v: 8.0, t_0: {prior: normal, mean: 0.1, sd: 0.1}}"),
        ("offset_theta_1: -6}", "offset_theta_1: -6, t_0: 0.3}"),
    )
    bd.simulate(config, tmp_path / "new", seed=3)
    fine = np.arange(4001) * 0.001
    clean = bd.respond("motor_shaft", bd.nominal(), fine, {"v": 8.0}, ["theta_1", "w_1"])

    def at(times: np.ndarray, name: str) -> np.ndarray:
        return np.where(times < 0, 0.0, np.interp(times, fine, clean[name]))

    residuals = []
    for name, begin in (("fast", 0.0), ("slow", 0.3)):
        path = tmp_path / "new" / f"{name}.csv"
        t, angle, speed = np.loadtxt(path, delimiter=",", skiprows=1).T
        residuals.append(angle - (np.degrees(at(t - 0.015 - begin, "theta_1")) - 6))
        assert residuals[-1].std() == pytest.approx(2, rel=0.25)
        assert (speed - at(t - begin, "w_1")).std() == pytest.approx(0.1, rel=0.25)
    assert abs(np.corrcoef(residuals)[0, 1]) < 0.4


def test_refits_have_the_priors_of_the_run_and_no_measured_value(tmp_path: Path) -> None:
    """Priors of free initial states follow from the record; all else of it is taken out."""
    config = two_experiments.write(
        tmp_path,
        ("experiments:\n  slow", "initial: free\nexperiments:\n  slow"),
        ("walkers: 16", "walkers: 32"),
    )
    measured, simulated = prepare(config).problem, calibrate.prepare(config).problem
    assert dict(measured.posterior.space.priors) == dict(simulated.posterior.space.priors)
    for own, other in zip(measured.observations, simulated.observations, strict=True):
        assert not np.nansum(np.abs(other.experiment.y))
        assert np.array_equal(own.experiment.is_measured, other.experiment.is_measured)


SIGMA = 0.1
CONFIG = (CONFIGS / "held.yaml").read_text(encoding="utf-8")
USUAL = {
    "HELD_OUT": ", held_out: true",
    "SHARED": "[offset_w_1]",
    "K_S": "{prior: uniform, low: 0.5, high: 1.5, relative: true}",
}


def write(folder: Path, name: str = "held", **changes: str) -> Path:
    text = CONFIG
    for key, value in (USUAL | changes).items():
        text = text.replace(key, value)
    path = folder / f"{name}.yaml"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("held")
    bd.simulate(write(folder, "made", HELD_OUT=""), seed=3, output=folder)
    return folder


def test_a_held_out_experiment_is_no_evidence_and_is_predicted(records: Path) -> None:
    """Against a config that has never heard of it, and densities by SciPy."""
    job = bd.load(write(records)).job
    problem, space = job.problem, job.problem.posterior.space
    assert [observation.label for observation in problem.observations] == ["slow"]
    alone = write(records, "alone")
    lines = alone.read_text().splitlines()
    lines = [line for line in lines if not line.startswith(("  fast", "shared"))]
    alone.write_text("\n".join(lines))
    other = bd.load(alone).job.problem
    theta = space.draw(40, np.random.default_rng(1))
    same = [space.free.index(name.removesuffix("_slow")) for name in other.names]
    density = other.posterior.density(theta[:, same])
    assert problem.posterior.density(theta) == pytest.approx(density, rel=1e-12)
    near = space.vector(space.start) * (
        1.0 + 1e-3 * np.random.default_rng(2).standard_normal((40, theta.shape[1]))
    )
    (fast,) = problem.posterior.likelihood.held_out
    clean = fast.signals(space.full(near))
    scores = logsumexp(norm.logpdf(fast.experiment.y, clean, SIGMA), axis=0) - np.log(40)
    prediction = held_out(problem.posterior, near)
    assert prediction is not None
    assert prediction.samples == 2 * 101
    assert prediction.score == pytest.approx(scores.sum(), rel=1e-9)
    apart = "fast, all its 202 samples are held out, and do not enter the fit"
    assert record_made(problem)[-1] == apart
    assert "nothing: it is held out" in fingerprint(job.config, problem).values()


@pytest.mark.slow
def test_models_are_compared_by_what_they_predict(records: Path, tmp_path: Path) -> None:
    """A spring that is held at a wrong value predicts worse; a run that saw the record is refused."""
    for name, changes in (("given", {}), ("stiff", {"K_S": "0.3"}), ("whole", {"HELD_OUT": ""})):
        result = posterior(write(records, name, **changes), tmp_path / name)
        assert result.status in (0, 3), result.text
        if name == "given":
            assert "fast, all its 202 samples are held out, and do not enter the fit" in result.text
    result = cli("compare", tmp_path / "stiff", tmp_path / "given", "-o", tmp_path / "out")
    assert result.status == 0, result.text
    assert "held out: 202 samples, which given predicts best" in result.out
    assert json.loads((tmp_path / "out" / "run.json").read_text())["best"] == "given"
    assert cli("verify", tmp_path / "given").status == 0
    refused = cli("compare", tmp_path / "given", tmp_path / "whole", "-o", tmp_path / "no")
    assert_refused(refused, "held out as a whole")
