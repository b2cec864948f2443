"""The benchmark compares like with like: every peer has our density, and verdicts are honest."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from support.scipy_oracles import ORDER, skewed
from support.small_problems import vector

from bayesdrill.inference.posterior import Posterior
from benchmarks import modal, problem, verdict
from benchmarks.modal import COORDINATES, Modal
from benchmarks.peers import naive

Array = np.ndarray

N_POINTS = 40


@pytest.fixture(scope="module")
def job() -> problem.Job:
    return problem.load()


@pytest.fixture(scope="module")
def points(job: problem.Job) -> Array:
    """Around the nominal values, from which the record was made."""
    nominal = job.problem.posterior.space.vector(job.problem.nominal)
    return problem.starts(job, nominal, N_POINTS, seed=1)


@pytest.fixture(scope="module")
def anywhere(job: problem.Job) -> Array:
    return job.problem.posterior.space.draw(N_POINTS, np.random.default_rng(2))


def spread(ours: Array, theirs: Array) -> float:
    """Of the difference, whose constant does not matter."""
    return float(np.ptp(ours - theirs))


def each(function: Callable[[Array], object], points: Array) -> Array:
    return np.array([float(function(point)) for point in points])  # type: ignore[arg-type]


def test_solve_ivp_gives_our_density(job: problem.Job, points: Array) -> None:
    """At its default tolerances it would be wrong by more than 0.1 here."""
    theirs = each(naive.log_density(job), points[:4])
    assert spread(job.problem.posterior.density(points[:4]), theirs) < 0.01
    assert naive.log_density(job)(points[0] * 3.0) == -np.inf


def test_pints_gets_our_density(job: problem.Job, points: Array) -> None:
    pytest.importorskip("pints")
    from benchmarks.peers.pints_ import LogDensity

    posterior = job.problem.posterior
    assert each(LogDensity(posterior), points) == pytest.approx(posterior.density(points))
    assert LogDensity(posterior)(points[0] * 3.0) == -np.inf


def test_jax_gives_our_likelihood_all_over_the_box(
    job: problem.Job, points: Array, anywhere: Array
) -> None:
    jax = pytest.importorskip("jax")
    from benchmarks.peers import response_jax

    density = jax.jit(response_jax.log_likelihood(job))
    ours = job.problem.posterior.density
    assert spread(ours(points), each(density, points)) < 1e-5
    # Far from the record the log densities themselves are large.
    both = ours(np.concatenate([points[:1], anywhere]))
    theirs = each(density, np.concatenate([points[:1], anywhere]))
    assert both - both[0] == pytest.approx(theirs - theirs[0], rel=1e-8)


def straightened(job: problem.Job) -> Posterior:
    """Ours over the coordinates made by hand, Jacobian included."""
    coordinates: Any = modal.of(job)
    return dataclasses.replace(job.problem.posterior, coordinates=coordinates)


def test_modal_coordinates_are_what_they_are_called() -> None:
    """The steady speed from the two balances, rates from their definitions."""
    p, i_m, v = skewed(), 0.2, 6.5
    z = Modal(i_m, v, ORDER).from_physical(vector(p)[None])[0]
    modal = dict(zip(COORDINATES, np.exp(z), strict=True))
    speed = modal.pop("speed")
    current = (p["t_f"] + p["c_m"] * speed) / p["k_T"]
    assert p["k_e"] * speed + p["r_m"] * current == pytest.approx(v, rel=1e-12)
    d = p["c_m"] + p["k_e"] * p["k_T"] / p["r_m"]
    rates = {
        "rotor": p["k_s"] / p["j_1"],
        "shaft": i_m**2 * p["k_s"] / d,
        "inertia": p["j_m"] / d,
        "electrical": p["l_m"] / p["r_m"],
    }
    assert modal == pytest.approx(rates | {name: p[name] for name in ("c_m", "t_f", "j_1", "r_m")})


def test_modal_coordinates_go_back_and_know_their_jacobian(
    job: problem.Job, anywhere: Array
) -> None:
    """All over the box."""
    straight = modal.of(job)
    z = straight.from_physical(anywhere)
    theta, log_dets = straight.with_jacobian(z)
    assert theta == pytest.approx(anywhere, rel=1e-10)
    h = 1e-6 * np.eye(9)
    for row, at, log_det in zip(z, theta, log_dets, strict=True):
        slopes = (straight.to_physical(row + h) - straight.to_physical(row - h)) / 2e-6 / at
        true = np.linalg.slogdet(slopes)[1] + np.log(at).sum()
        assert log_det == pytest.approx(true, abs=1e-5)


def test_jax_gives_our_density_over_modal_coordinates(job: problem.Job, points: Array) -> None:
    jax = pytest.importorskip("jax")
    from benchmarks.peers import chart_jax

    posterior = straightened(job)
    z = posterior.coordinates.from_physical(points)
    density = jax.jit(chart_jax.modal_density(job))
    assert spread(posterior(z), each(density, z)) < 1e-5
    back = jax.jit(jax.vmap(chart_jax.physical_from_modal(job)))(z[:4])[0]
    assert np.asarray(back) == pytest.approx(points[:4], rel=1e-12)
    outside = posterior.coordinates.from_physical(points[:1] * 3.0)[0]
    assert density(outside) == -np.inf
    assert np.isfinite(jax.jit(jax.grad(chart_jax.modal_density(job)))(outside)).all()


def test_the_walls_of_the_box_are_unfolded_with_their_jacobian(
    job: problem.Job, points: Array
) -> None:
    """The Jacobian against automatic differentiation; all of u is inside the box."""
    jax = pytest.importorskip("jax")
    from benchmarks.peers import chart_jax

    posterior = straightened(job)
    z = posterior.coordinates.from_physical(points)
    fold = jax.jit(chart_jax.modal_from_unfolded(job))
    unfold = jax.jit(chart_jax.unfolded_from_modal(job))
    density = jax.jit(chart_jax.unfolded_density(job))
    slopes_of = jax.jit(jax.jacfwd(lambda u: fold(u)[0]))
    rng, differences = np.random.default_rng(3), []
    for point, ours in zip(z[:6], posterior(z[:6]), strict=True):
        u = unfold(point)
        back, log_det = fold(u)
        assert np.asarray(back) == pytest.approx(point, rel=1e-12)
        slopes = slopes_of(u)
        assert np.linalg.slogdet(slopes)[1] == pytest.approx(float(log_det), abs=1e-9)
        differences.append(float(density(u)) - float(log_det) - ours)
        wandering = np.asarray(u) + np.concatenate([np.zeros(5), rng.normal(0, 3, 4)])
        assert np.isfinite(density(wandering))
    assert np.ptp(differences) < 1e-5


def test_a_run_that_disagrees_with_itself_has_not_converged() -> None:
    """However many effective draws it has."""
    draws = np.random.default_rng(5).standard_normal((4, 1000, 2))
    draws[0] += 0.5
    assert not verdict.judge(draws).enough


def test_a_short_ensemble_has_not_converged_however_many_walkers_it_has() -> None:
    """Walkers are no independent chains: tau is 39 of 600 steps."""
    rng = np.random.default_rng(6)
    chains = rng.standard_normal((4, 600, 64, 1))
    for t in range(1, 600):
        chains[:, t] = 0.95 * chains[:, t - 1] + np.sqrt(1 - 0.95**2) * chains[:, t]
    judged = verdict.judge_ensembles(chains, every=10)
    assert judged.tau == pytest.approx(390, rel=0.2)
    assert not judged.enough
    assert judged.ess < 4 * 64 * 600 / 39
