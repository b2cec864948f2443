"""Several experiments, sensors and starts as unknowns: sums of single likelihoods, and their slopes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import two_experiments
from support.case_tables import run_cases
from support.small_problems import with_priors

from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.inference import laplace
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import LogNormal, TruncatedNormal, Uniform
from bayesdrill.inference.unknowns import Unknown
from bayesdrill.sampling import mode_search


def target() -> Posterior:
    return two_experiments.rich_job().problem.posterior


def points(posterior: Posterior, n: int = 3) -> np.ndarray:
    """Near where searches begin, off to either side `(n, D)`."""
    space = posterior.space
    shares = 0.5 + np.random.default_rng(4).uniform(-0.2, 0.2, (n, len(space.free)))
    priors = space.priors.values()
    theta = np.stack([p.quantile(u) for p, u in zip(priors, shares.T, strict=True)], axis=-1)
    return np.asarray(theta)


def alone(theta: np.ndarray, label: str) -> float:
    """The log likelihood of one experiment, from names alone: no columns are asked."""
    posterior = target()
    (one,) = [o for o in posterior.likelihood.observations if o.label == label]
    named = posterior.space.named(theta[None])
    shared = {"gain_twist", "sigma_twist"}

    def of(name: str) -> float:
        whole = name if name in shared else f"{name}_{label}"
        return float(np.squeeze(named[whole if whole in named else name]))

    full = np.array([[of(name) for name in one.response.parameters]])
    left = one.experiment.y - one.response.signals(full)[0]
    sigmas = np.array([of("sigma_twist"), np.pi / 60])  # 0.5 rpm
    if label == "moving":
        sigmas[1] = of("sigma_w_2")
    density = -0.5 * (left / sigmas) ** 2 - np.log(sigmas) - 0.5 * np.log(2 * np.pi)
    return float(np.nansum(density))


def test_the_joint_likelihood_is_the_sum_of_its_parts() -> None:
    """Mutants killed: own parameters exchanged, a shared sigma counted once, gaps as zeros."""
    for theta in points(target()):
        each = [alone(theta, label) for label in ("late", "moving")]
        assert target().likelihood(theta[None])[0] == pytest.approx(sum(each), rel=1e-10)


def test_an_own_unknown_moves_its_experiment_alone_and_a_shared_one_all() -> None:
    posterior = target()
    theta, names = points(posterior, 1), posterior.space.free
    base = posterior.likelihood.all_signals(theta)
    for name in names[: names.index("sigma_twist")]:
        other = theta.copy()
        other[0, names.index(name)] += 0.01 * posterior.space.unknowns[
            names.index(name)
        ].prior.quantile(np.array(0.9))
        moved = posterior.likelihood.all_signals(other)
        changed = [not np.array_equal(a, b) for a, b in zip(base, moved, strict=True)]
        expected = [not name.endswith("_moving"), not name.endswith("_late")]
        assert changed == expected, name


@run_cases("level", ["known", "unknown"])
def test_what_is_missing_is_as_if_it_were_never_sampled(level: str) -> None:
    """Against the record without these rows, of one channel; mutant killed: counts of all samples."""
    posterior = target()
    one = posterior.likelihood.observations[1 if level == "unknown" else 0]
    k = 1
    rows = np.array([5, 6, 30])
    y = np.array(one.experiment.y)
    y[rows, k] = np.nan
    theta = points(posterior, 2)
    full = posterior.space.full(theta)
    record = replace(one.experiment, y=y)
    seen = replace(
        one, response=one.response.of(record), noise=_with_counts(one.noise, record.counts)
    )
    here, whole = seen.by_channel(full, theta)[:, k], one.by_channel(full, theta)[:, k]
    left = (one.experiment.y - one.signals(full))[:, rows, k]
    sigma = one.scales(theta)[:, k, None]
    gone = -0.5 * (left / sigma) ** 2 - np.log(sigma) - 0.5 * np.log(2 * np.pi)
    assert whole - here == pytest.approx(gone.sum(axis=1), rel=1e-7)


def _with_counts(noise: object, counts: tuple[int, ...]) -> object:
    return noise.with_counts(counts)  # type: ignore[attr-defined]


def test_slopes_of_the_joint_density_are_its_differences() -> None:
    """Along every kind of unknown, signed or not; mutant killed: a step of sensors taken for a log."""
    posterior = target()
    surface = LogDensity(posterior)
    u = posterior.coordinates.from_physical(points(posterior))
    found = surface.quadratic_model(u, np.eye(u.shape[1]))
    h = 1e-5 * np.minimum(surface.spread, 1.0)
    rough = []
    for step in np.diag(h):
        near = surface.value(u + step) - surface.value(u - step)
        far = surface.value(u + 2 * step) - surface.value(u - 2 * step)
        rough.append((8 * near - far) / (12 * step.sum()))
    expected = np.array(rough).T
    scale = np.abs(expected).max(axis=1, keepdims=True)
    assert np.abs(found.slope - expected).max() < 1e-4 * scale.max()
    for d, name in enumerate(posterior.space.free):
        assert found.slope[:, d] == pytest.approx(
            expected[:, d], rel=1e-3, abs=1e-7 * scale.max()
        ), name


def test_the_information_of_a_point_is_that_of_slopes_and_priors() -> None:
    """Of what may be negative on the scale of its prior; mutant killed: its log in its place."""
    posterior = target()
    theta = points(posterior, 1)[0]
    root = laplace.information_root(posterior, theta)
    scenery = SensitivityStudy(posterior.likelihood)
    rows = scenery.with_nuisances(theta)
    m = rows.shape[1]
    known = np.diag([1 / laplace.natural_sd(u) ** 2 for u in posterior.space.unknowns[:m]])
    expected = rows.T @ rows / laplace.residual_excess(posterior, theta) + known
    own = (root.T @ root)[:m, :m]
    size = np.sqrt(np.diag(expected))
    assert own / np.outer(size, size) == pytest.approx(expected / np.outer(size, size), abs=1e-5)
    signed = [u.name for u in posterior.space.unknowns if u.signed]
    assert {"offset_v_late", "t_0_late", "lag_twist_late", "w_1_0_moving"} <= set(signed)
    assert not {"gain_twist", "k_e", "t_f_late", "sigma_twist"} & set(signed)


def test_the_rig_without_its_sensors_is_a_schur_complement() -> None:
    """Information of the rig, with what else is unknown taken out as freely as its priors allow."""
    posterior = target()
    theta = points(posterior, 1)[0]
    scenery = SensitivityStudy(posterior.likelihood)
    assert scenery.unknowns == ("k_e", "k_s", "t_f_late", "t_f_moving")
    found = scenery.sensitivities(theta)
    rows, m = scenery.with_nuisances(theta), len(scenery.unknowns)
    moving = posterior.space.unknowns[m : rows.shape[1]]
    whole = rows.T @ rows
    whole[m:, m:] += np.diag([1 / laplace.natural_sd(u) ** 2 for u in moving])
    a, b, d = whole[:m, :m], whole[:m, m:], whole[m:, m:]
    expected = a - b @ np.linalg.solve(d, b.T)
    size = np.sqrt(np.diag(expected))
    assert (found.T @ found) / np.outer(size, size) == pytest.approx(
        expected / np.outer(size, size), abs=1e-7
    )
    least = np.diag(a) / np.diag(expected)
    assert least.max() > 1.5  # something was hidden behind the sensors


def unknown(prior: object, role: str = "sensor") -> Unknown:
    one = target().space.unknowns[-3]
    return replace(one, prior=prior, role=role, start=0.0)  # type: ignore[arg-type]


@run_cases(
    "prior, signed",
    [
        (Uniform(-1.0, 2.0), True),
        (Uniform(0.0, 0.05), True),
        (Uniform(0.01, 0.05), False),
        (TruncatedNormal(0.0, 2.0, -np.inf, np.inf), True),
        (LogNormal(1.0, 0.1), False),
    ],
)
def test_what_may_be_next_to_nothing_has_no_logarithmic_scale(prior: object, signed: bool) -> None:
    """A lag from zero on is one; a parameter of the rig is not, as it may span decades."""
    assert unknown(prior).signed is signed
    if prior == Uniform(0.0, 0.05):
        assert not unknown(prior, "rig").signed


def test_natural_scales_are_logs_and_multiples_of_a_step() -> None:
    posterior = target()
    theta = points(posterior)
    own = posterior.coordinates
    scales, step = dict(own.signed), 1e-6
    assert 0 < len(scales) < theta.shape[1]
    for d, x in enumerate(theta.T):
        up, down = (
            x + way * step * scales[d] if d in scales else x * np.exp(way * step) for way in (1, -1)
        )
        assert own.natural(theta)[:, d] == pytest.approx((up - down) / (2 * step), rel=1e-6)


def test_a_prior_below_zero_is_a_density_of_its_own() -> None:
    """`log_prior` of all, against each by itself; mutant killed: zero as a floor of a signed uniform."""
    posterior = target()
    space = with_priors(posterior.space, {"offset_v_late": Uniform(-2.0, -0.5)})
    theta = points(replace(posterior, space=space))
    each = [p.logpdf(x) for p, x in zip(space.priors.values(), theta.T, strict=True)]
    assert space.log_prior(theta) == pytest.approx(np.sum(each, axis=0), rel=1e-12)
    d = space.free.index("offset_v_late")
    assert (theta[:, d] < -0.5).all()
    theta[0, d] = -0.4
    assert space.log_prior(theta)[0] == -np.inf


def test_an_end_of_a_signed_prior_is_told() -> None:
    """`at_bound` on the scale of the prior; mutant killed: ends compared by ratios alone."""
    posterior = target()
    values = dict(posterior.space.start)
    assert "lag_twist_late" not in mode_search._at_bound(posterior, values)
    values["lag_twist_late"], values["offset_v_late"] = 1e-7, -0.9999
    found = mode_search._at_bound(posterior, values)
    assert {"lag_twist_late", "offset_v_late"} <= set(found)
    assert "t_0_late" not in mode_search._at_bound(posterior, values | {"t_0_late": 0.0})
