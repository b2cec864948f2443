"""A long record is compressed: its posterior is that of all samples, which the run checks."""

import dataclasses
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter
from support.scipy_oracles import NOMINAL
from support.small_problems import starts_believed

import bayesdrill as bd
from bayesdrill import output_files
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import Silent
from bayesdrill.inference import compression
from bayesdrill.inference.posterior import Posterior
from bayesdrill.report.sections import fit as fit_section
from bayesdrill.report.sections.fit import draw_fit, every_fit, measured
from bayesdrill.rig.compression.basis import CompressionError
from bayesdrill.rig.compression.simulator import CompressedSimulator
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.sampling import fit as fits
from bayesdrill.sampling.mode_search import Mode
from bayesdrill.sampling.workers import WorkerPool
from bayesdrill.tasks import find_map, pipeline

Array = NDArray[np.float64]

T = np.arange(24_001) / 500.0
BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
SAMPLED = 2001  # samples of records that are sampled exactly too
RHO = 0.8
LEVEL = {"prior": "log_uniform", "low": 0.01, "high": 1.0}


def speeds(samples: int, seed: int) -> tuple[Array, Array, Array, np.random.Generator]:
    """Return times, voltage and two speeds under random steps of voltage."""
    t, rng = T[:samples], np.random.default_rng(seed)
    v = np.where(rng.random(samples // 100 + 1) < 0.5, 4.0, 12.0).repeat(100)[:samples]
    exact = bd.respond(MotorShaft(), NOMINAL, t, {"v": v}, ["w_1", "w_2"])
    return t, v, np.array([exact["w_1"], exact["w_2"]]), rng


def case_of(
    t: Array, v: Array, w: Array, free: tuple[str, ...], likelihood: str, ess: int, **noise: str
) -> bd.Case:
    """Return the case of two speeds, the noise of the second unknown."""
    return bd.case(
        t,
        {"w_1": bd.Channel(w[0], "rad/s", 0.1), "w_2": bd.Channel(w[1], "rad/s", LEVEL, **noise)},
        {"v": bd.Input(v, "V")},
        parameters={name: BOX if name in free else "nominal" for name in NOMINAL},
        nominal="tables_2_3",
        sampler={"likelihood": likelihood, "walkers": 32, "ess": ess},
        output={"figures": ["fit"]},
        name="long",
    )


@cache
def case(likelihood: str = "auto", samples: int = len(T), ess: int = 500) -> bd.Case:
    t, v, w, rng = speeds(samples, 5)
    w = w + 0.1 * rng.standard_normal(w.shape)
    return case_of(t, v, w, ("j_m", "k_e", "r_m", "k_s", "j_1"), likelihood, ess)


@cache
def sampled(likelihood: str, ess: int = 500) -> bd.Run:
    return case(likelihood, SAMPLED, ess).sample(processes=1)


def test_draws_of_a_compressed_record_are_compared_with_the_exact_likelihood() -> None:
    run = sampled("compressed")
    assert run.converged
    check = run.sampled.compression
    assert (check.samples, check.draws) == (SAMPLED, 500)
    assert check.difference < 1e-6
    assert check.exact < 10


@pytest.mark.slow
def test_the_posterior_is_that_of_all_samples() -> None:
    compressed, exact = (sampled(likelihood, 1000) for likelihood in ("compressed", "exact"))
    assert compressed.converged
    assert exact.converged
    for mine, row in zip(compressed.analysis.unknowns, exact.analysis.unknowns, strict=True):
        assert abs(mine.mean - row.mean) < 0.15 * row.sd  # some five Monte Carlo errors
    assert compressed.evidence.log_z == pytest.approx(exact.evidence.log_z, abs=0.1)
    assert exact.sampled.compression is None


def test_a_record_that_is_too_long_is_not_predicted_sample_by_sample(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Figures are given the extremes of stretches: no peak is lost, and files stay small."""
    monkeypatch.setattr(output_files, "MOST_PREDICTED", 4 * 2 * SAMPLED - 1)
    run = dataclasses.replace(sampled("compressed"))  # of which nothing was said yet
    (whole,) = every_fit(run.job.problem, run.sampled.draws[0, -1], run.analysis.fit)
    assert len(whole.t) == SAMPLED
    monkeypatch.setattr(fit_section, "SHOWN_STRETCHES", 60)
    monkeypatch.setattr(fit_section, "DOTS", 375)
    tree = run.to_arviz()
    assert not {"posterior_predictive", "log_likelihood"} & {*tree.children}
    assert tree["observed_data"]["w_1"].shape == (SAMPLED,)
    best = run.sampled.draws[0, -1]
    (fit,) = every_fit(run.job.problem, best, run.analysis.fit)
    assert len(fit.t) < SAMPLED / 2
    y = run.job.problem.observations[0].experiment.y
    for signal, column in zip(fit.signals, y.T, strict=True):
        # Dots are samples, not extremes, which would lie outside of the band of the noise.
        assert np.array_equal(signal.y[signal.dots], column[measured(column)])
        assert (signal.y.min(), signal.y.max()) == (column.min(), column.max())
    (drawing,) = draw_fit(run._view)
    assert "predictive" not in drawing.says
    run.save(tmp_path / "long")
    assert (tmp_path / "long/figures/fit.png").exists()


@cache
def search() -> tuple[Posterior | None, Mode, Posterior]:
    """Return the excerpt that the search of the long record saw, its maximum, and what it ended with."""
    with WorkerPool(case().job.problem.posterior, 1) as pool:
        under_way = fits.begin_searches(pool, find_map.fit_plan(case().job), Silent())
        mode = fits.end_searches(pool, under_way, Silent())
        return under_way.excerpt, mode, pool.posterior


def test_the_search_begins_with_an_excerpt_and_ends_with_all_samples() -> None:
    excerpt, mode, posterior = search()
    assert len(excerpt.likelihood.observations[0].experiment.t) == compression.EXCERPT
    assert isinstance(posterior.likelihood.observations[0].response, CompressedSimulator)
    problem = case().job.problem
    theta = problem.posterior.space.vector(mode.values)
    assert len(mode.highest) == find_map.fit_plan(case().job).starts
    here = problem.posterior.density(theta[None])[0]
    assert here == pytest.approx(mode.log_posterior, abs=1e-6)
    for column in range(len(theta)):
        for factor in (1 - 1e-5, 1 + 1e-5):
            beside = theta.copy()
            beside[column] *= factor
            assert problem.posterior.density(beside[None])[0] < here + 1e-6


@starts_believed()
def test_a_record_that_cannot_be_compressed_is_refused_or_exact() -> None:
    """It is refused where compression is asked for; by default it has all samples, however long."""
    lag = {"lag": {"prior": "uniform", "low": 0, "high": 0.1}}
    torque = {"missing_torque": {"at": "rotor_1", "size": 0.1, "time": 0.5}}
    cases = [
        ("the rig has dry friction", {"t_c1": 0.01}, {}, {}),
        ("its channels or inputs are delayed", {}, lag, {}),
        ("a torque is missing", {}, {}, torque),
    ]
    for reason, rubs, sensor, missing in cases:

        def problematic(likelihood: str, *entries: dict[str, Any]) -> bd.Case:
            rig, channel, more = entries
            return bd.case(
                T,
                {"w_1": bd.Channel(np.sin(T), "rad/s", 0.1, **channel)},
                {"v": 8.0},
                parameters={**dict.fromkeys(NOMINAL, "nominal"), **rig, "k_e": BOX},
                sampler={"likelihood": likelihood},
                **more,
            )

        with pytest.raises(InputError, match=f"cannot be compressed: {reason}"):
            problematic("compressed", rubs, sensor, missing)
        (whole,) = problematic("auto", rubs, sensor, missing).job.problem.observations
        assert reason in whole.exact_reason
        assert not compression.is_long(whole)


def test_a_compression_that_fails_after_the_search_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, mode, _ = search()
    job = case("compressed").job

    def refuse(*_: object) -> None:
        raise CompressionError("the poles of the rig are too uncertain")

    monkeypatch.setattr(compression, "compress", refuse)
    with pytest.raises(InputError, match="cannot be compressed: the record: the poles of the rig"):
        pipeline.sample_in_memory(job, mode, 1, Silent())


def test_a_resumed_run_has_the_same_basis_functions() -> None:
    """Those about the maximum do not depend on those of the search."""
    _, mode, searched = search()
    triangles = []
    for posterior in (searched, case().job.problem.posterior):
        with WorkerPool(posterior, 1) as pool:
            fits.compress_about(pool, mode, find_map.fit_plan(case().job).max_exact)
            response = pool.posterior.likelihood.observations[0].response
            triangles.append(response.compression.record.matrix)
    assert np.array_equal(*triangles)


@pytest.mark.slow
def test_autoregressive_noise_is_compressed_too() -> None:
    """The record has one channel, and its draws are compared with the exact likelihood."""
    t, v, w, rng = speeds(2401, 6)
    noise = 0.1 * rng.standard_normal(w.shape)
    noise[1] = lfilter([np.sqrt(1.0 - RHO**2)], [1.0, -RHO], noise[1])
    case = case_of(t, v, w + noise, ("k_e", "r_m", "k_s"), "compressed", 1000, noise="ar1")
    run = case.sample(processes=1)
    rows = {row.name: row for row in run.analysis.unknowns}
    for name, true in (("rho_w_2", RHO), ("k_s", NOMINAL["k_s"])):
        assert abs(rows[name].mean - true) < 4.0 * rows[name].sd, name
    check = run.sampled.compression
    assert check.difference < 1e-6
