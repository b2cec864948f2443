"""Density, slopes, whitening and draws of every noise belong to the same distribution."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy.stats
from numpy.typing import NDArray
from support.case_tables import run_cases
from support.residual_sums import moved, residuals
from support.scipy_oracles import NOMINAL
from support.small_problems import experiment, likelihood_of, near_middle, unknown

from bayesdrill.basics.duals import Dual
from bayesdrill.inference import laplace
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.noise import NOISES
from bayesdrill.inference.noise.contract import Noise, NoisyChannel, as_matrix, fit_noise
from bayesdrill.inference.noise.mixed import ChannelNoise, Mixed, noise_key
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.unknowns import ParameterSpace
from bayesdrill.record.experiment import Channel
from bayesdrill.rig.models.motor_shaft import PARAMETERS, MotorShaft
from bayesdrill.rig.simulators.linear import Response

Array = NDArray[np.float64]
SIGMA = (0.3, 0.02)  # unequal
RECORDS = 4000
FREE = ("k_e", "k_s", "j_1")  # of the rig
ENTRIES: dict[str, Callable[[float], dict[str, float]]] = {"quantised": lambda s: {"step": 1.5 * s}}


def channels(*, known: bool = False, kind: str = "white") -> list[NoisyChannel]:
    return [
        NoisyChannel(
            channel=Channel(
                name=name, weights={name: 1.0}, unit="rad/s", latex=name, latex_unit=""
            ),
            sigma=sigma if known else Uniform(0.1 * sigma, 10 * sigma),
            start=sigma,
            entries=ENTRIES.get(kind, lambda _: {})(sigma),
        )
        for name, sigma in zip(("w_1", "w_2"), SIGMA, strict=True)
    ]


def mixed(n: int, first_kind: str, second_kind: str, **entries: dict[str, float]) -> Noise:
    """Return a noise of a kind for each channel, the second channel first."""
    first, second = channels()
    first = replace(first, entries=entries.get(first_kind, {}))
    second = replace(second, entries=entries.get(second_kind, {}))
    parts = (
        ChannelNoise(NOISES[second_kind].from_channels([second], n), (1,)),
        ChannelNoise(NOISES[first_kind].from_channels([first], n), (0,)),
    )
    return Mixed(parts)


def of_kind(kind: str, known: bool) -> Callable[[int], Noise]:
    return lambda n: NOISES[kind].from_channels(channels(known=known, kind=kind), n)


MAKERS: dict[str, Callable[[int], Noise]] = {
    **{f"{kind}, unknown": of_kind(kind, known=False) for kind in NOISES},
    **{f"{kind}, known": of_kind(kind, known=True) for kind in NOISES},
    "mixed": lambda n: mixed(n, "white", "white"),
    "mixed, held": lambda n: mixed(
        n, "student_t", "ar1", ar1={"rho": 0.9}, student_t={"degrees": 4.0}
    ),
}


def values(noise: Noise, w: int = 1) -> Array:
    """Return values of the unknowns `(w, D)`, off the start, and different for each walker."""
    share = np.random.default_rng(len(noise.unknowns)).uniform(0.3, 0.7, (w, len(noise.unknowns)))
    columns = [u.prior.quantile(share[:, k]) for k, u in enumerate(noise.unknowns)]
    return np.stack(columns, axis=-1) if columns else np.empty((w, 0))


def draw(noise: Noise, at: Array, n: int) -> Array:
    return noise.draw(np.zeros((len(at), n, len(SIGMA))), at, np.random.default_rng(3))


def test_results_know_a_noise_by_its_text() -> None:
    """A run is resumed only where that is equal: fields may not be renamed without their old text."""
    for name, text in (("ar1", "AR1"), ("student_t", "StudentT"), ("quantised", "Quantised")):
        noise = NOISES[name].from_channels(channels(kind=name), 7)
        start = f"{text}(levels=White(n_samples=7, known={{}}, n_channels=2"
        assert repr(noise).startswith(start)


@run_cases("name", MAKERS)
def test_the_density_of_two_samples_integrates_to_one(name: str) -> None:
    noise = MAKERS[name](2)
    at, sd = values(noise), noise.scales(values(noise))[0]
    x = np.linspace(-9, 9, 401)
    pairs = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2, 1) * sd
    log_p = noise.log_likelihood(residuals(pairs), np.repeat(at, len(pairs), axis=0))
    area = (x[1] - x[0]) ** 2 * sd**2
    assert (np.exp(log_p).sum(axis=0) * area) == pytest.approx(np.ones(2), rel=1e-3)


@run_cases("name", MAKERS)
def test_terms_of_single_samples_sum_to_the_likelihood_whatever_the_batch(name: str) -> None:
    noise = MAKERS[name](30)
    at = values(noise, 5)
    samples = draw(noise, at, 30)
    whole, white = noise.log_likelihood(residuals(samples), at), noise.whiten(samples, at)
    assert noise.pointwise(samples, at).sum(axis=1) == pytest.approx(whole, rel=1e-12)
    for k in range(5):
        alone = samples[k : k + 1], at[k : k + 1]
        assert np.array_equal(noise.log_likelihood(residuals(alone[0]), alone[1])[0], whole[k])
        assert np.array_equal(noise.whiten(*alone)[0], white[k])
    longer = noise.for_length(40).log_likelihood(residuals(draw(noise, at, 40)), at)
    assert longer.shape == whole.shape
    assert set(noise.fixed_values()) <= {0, 1}


@run_cases("name", MAKERS)
def test_a_noise_is_identified_by_plain_data(name: str) -> None:
    first, second, other = (noise_key(MAKERS[each](30)) for each in (name, name, "mixed"))
    assert first == second
    assert json.loads(json.dumps(first))
    assert (first == other) == (name == "mixed")


@run_cases("name", MAKERS)
def test_slopes_are_those_of_the_density(name: str) -> None:
    noise = MAKERS[name](12)
    at = values(noise, 3)
    samples = 1.3 * draw(noise, at, 12)

    def density(signals: Array, at: Array = at) -> Array:
        return noise.log_likelihood(residuals(samples - signals), at).sum(axis=1)

    shift = np.random.default_rng(1).standard_normal(samples.shape) * noise.scales(at)[:, None]
    numeric = (density(1e-5 * shift) - density(-1e-5 * shift)) / 2e-5
    assert (noise.score(samples, at) * shift).sum(axis=(1, 2)) == pytest.approx(numeric, rel=1e-6)
    slope, curvature = noise.noise_score(residuals(samples), at)
    for column in range(len(noise.unknowns)):
        up, down = (density(0.0 * shift, moved(noise, at, column, h)) for h in (1e-5, -1e-5))
        assert slope[:, column] == pytest.approx((up - down) / 2e-5, rel=1e-5, abs=1e-5)
        assert (as_matrix(curvature, at)[:, column, column] > 0).all()
    assert (np.linalg.eigvalsh(as_matrix(curvature, at)) > 0).all()


@run_cases("name", MAKERS)
def test_slopes_of_terms_sum_to_those_of_the_density(name: str) -> None:
    """The terms of single samples take numbers with slopes, of signals and of unknowns."""
    noise = MAKERS[name](12)
    at = values(noise, 3)
    samples = 1.3 * draw(noise, at, 12)
    shift = np.random.default_rng(1).standard_normal(samples.shape) * noise.scales(at)[:, None]
    terms = noise.pointwise(Dual(samples, -shift), Dual(at, np.zeros_like(at)))
    assert terms.value == pytest.approx(noise.pointwise(samples, at), rel=1e-14)
    along = (noise.score(samples, at) * shift).sum(axis=(1, 2))
    assert terms.slope.sum(axis=(1, 2)) == pytest.approx(along, rel=1e-10)
    slope, _ = noise.noise_score(residuals(samples), at)
    for column, each in enumerate(noise.unknowns):
        step = np.zeros_like(at)
        step[:, column] = at[:, column] if each.between is None else 1.0
        terms = noise.pointwise(Dual(samples, np.zeros_like(samples)), Dual(at, step))
        assert terms.slope.sum(axis=(1, 2)) == pytest.approx(slope[:, column], rel=1e-9, abs=1e-9)


@run_cases("name", MAKERS)
def test_information_is_the_covariance_of_slopes_over_draws(name: str) -> None:
    """At the truth slopes are zero on average, and their squares are the information."""
    n = 25
    noise = MAKERS[name](n)
    at = np.repeat(values(noise), RECORDS, axis=0)
    samples = draw(noise, at, n)
    shift = np.linspace(-1.0, 2.0, n)[:, None] * noise.scales(at[:1])[0]
    along = (noise.score(samples, at) * shift).sum(axis=(1, 2))
    white = noise.whitened_jacobian(shift[None], at[:1])
    information = float((white**2).sum())
    assert abs(along.mean()) < 5 * np.sqrt(information / RECORDS)
    assert along.var() == pytest.approx(information, rel=0.15)
    assert noise.whitened_jacobian(2.0 * shift[None], at[:1]) == pytest.approx(2.0 * white)
    slope, _ = noise.noise_score(residuals(samples), at)
    expected = as_matrix(noise.expected(at[0]), at[0])
    assert expected.shape == (len(noise.unknowns),) * 2
    size = np.sqrt(np.diag(expected))
    assert (np.abs(slope.mean(axis=0)) < 5 * size / np.sqrt(RECORDS)).all()
    covariance = np.atleast_2d(np.cov(slope, rowvar=False)) if noise.unknowns else expected
    sizes = np.outer(size, size)
    assert covariance / sizes == pytest.approx(expected / sizes, abs=0.12)


@run_cases("name", MAKERS)
def test_whitened_draws_are_white_and_a_fit_returns_their_size(name: str) -> None:
    n = 6000
    noise = MAKERS[name](n)
    at = values(noise)
    samples = draw(noise, at, n)
    white = noise.whiten(samples, at)[0]
    for k in range(len(SIGMA)):
        assert scipy.stats.kstest(white[:, k], "norm").pvalue > 1e-4
        assert abs(np.corrcoef(white[1:, k], white[:-1, k])[0, 1]) < 5 / np.sqrt(n)
    assert samples[0].std(axis=0) == pytest.approx(noise.scales(at)[0], rel=0.15)
    if noise.unknowns:
        start = np.array([u.start for u in noise.unknowns])
        fitted = fit_noise(noise, residuals(samples), start)
        sd = np.sqrt(np.diag(np.linalg.inv(as_matrix(noise.expected(at[0]), at[0]))))
        plain = np.array([u.between is not None for u in noise.unknowns])
        error = np.where(plain, fitted - at[0], np.log(np.abs(fitted / at[0])))
        assert (np.abs(error) < 6 * sd).all()


@run_cases("name", MAKERS)
def test_innovations_are_what_samples_before_do_not_predict(name: str) -> None:
    """They have nothing of a later sample and all of the sample itself, and are not above residuals."""
    n = 3000
    noise = MAKERS[name](n)
    at = values(noise)
    samples = draw(noise, at, n)
    innovations = noise.innovations(samples, at)
    changed = samples.copy()
    changed[:, 50] += np.array(SIGMA)
    change = noise.innovations(changed, at) - innovations
    assert change[0, :50] == pytest.approx(np.zeros((50, len(SIGMA))), abs=1e-12)
    assert change[0, 50] == pytest.approx(np.array(SIGMA))
    for k in range(len(SIGMA)):
        assert innovations[0, :, k].std() < 1.001 * samples[0, :, k].std()
        lagged = np.corrcoef(innovations[0, 1:, k], innovations[0, :-1, k])[0, 1]
        assert abs(lagged) < 5 / np.sqrt(n)


@cache
def response() -> Response:
    measures = {"w_1": {"w_1": 1.0}, "w_2": {"w_2": 1.0}}
    return Response(MotorShaft(), experiment(80, measures=measures))


def posterior_with(*names: str) -> Posterior:
    """Return that of a rig with three unknowns and a record for each of the noises."""
    full = np.array([[NOMINAL[p] for p in PARAMETERS]])
    pairs, unknowns = [], [unknown(p, Uniform(0.5 * NOMINAL[p], 1.5 * NOMINAL[p])) for p in FREE]
    for k, name in enumerate(names):
        noise = MAKERS[name](80)
        y = response().signals(full)[0] + draw(noise, values(noise), 80)[0]
        pairs.append((response().with_record(y), noise))
        unknowns += [
            replace(u, symbol=replace(u.symbol, name=f"{u.name}_{k}")) for u in noise.unknowns
        ]
    space = ParameterSpace(
        model=PARAMETERS,
        unknowns=tuple(unknowns),
        fixed={p: NOMINAL[p] for p in PARAMETERS if p not in FREE},
    )
    likelihood = likelihood_of(space, *pairs)
    return Posterior(space=space, likelihood=likelihood, coordinates=space.coordinates)


def assert_slopes_are_differences(posterior: Posterior, theta: Array) -> Array:
    """Compare slopes at `theta (W, D)` with differences, and return the curvature there."""
    surface = LogDensity(posterior)
    u = posterior.coordinates.from_physical(theta)
    assert posterior.coordinates.to_physical(u) == pytest.approx(theta, rel=1e-12)
    model = surface.quadratic_model(u, np.eye(u.shape[1]))
    for d, step in enumerate(1e-5 * np.diag(surface.spread)):
        numeric = (surface.value(u + step) - surface.value(u - step)) / (2 * step.sum())
        scale = 1e-6 * np.abs(model.slope[:, d]).max() + 1e-3
        assert model.slope[:, d] == pytest.approx(numeric, rel=1e-4, abs=scale)
    assert (np.linalg.eigvalsh(model.curvature) > 0).all()
    return model.curvature


@run_cases("name", MAKERS)
def test_a_posterior_with_it_has_the_slopes_of_its_density(name: str) -> None:
    posterior = posterior_with(name)
    assert_slopes_are_differences(posterior, near_middle(posterior.space))


@run_cases("name", MAKERS)
def test_its_information_is_that_of_the_curvature_at_the_truth(name: str) -> None:
    """Laplace's root, in the natural scales, against the surface's, in the coordinates."""
    posterior = posterior_with(name)
    noise_values = values(posterior.likelihood.only_observation.noise)[0]
    theta = np.append([NOMINAL[p] for p in FREE], noise_values)
    u = posterior.coordinates.from_physical(theta[None])
    surface = LogDensity(posterior)
    curvature = surface.quadratic_model(u, np.eye(len(theta))).curvature[0]
    sd = np.sqrt(np.diag(laplace.covariance(posterior, theta)))
    other = np.sqrt(np.diag(np.linalg.inv(curvature)))
    by_record = other < 0.5 * surface.spread  # priors decide the others, each in its way
    assert by_record[:3].all()
    assert sd[by_record] == pytest.approx(other[by_record], rel=0.3)


def test_densities_and_slopes_of_two_records_add_up() -> None:
    names = "white, unknown", "mixed"
    first, second = map(posterior_with, names)
    both = posterior_with(*names)
    theta = np.array([[*(NOMINAL[p] for p in FREE), 0.3, 0.02, 0.03, 0.2]])
    single = first.likelihood(theta[:, :5]) + second.likelihood(theta[:, [0, 1, 2, 5, 6]])
    assert both.likelihood(theta) == pytest.approx(single)
    counts = first.likelihood.n_measured, second.likelihood.n_measured
    assert both.likelihood.n_measured == sum(counts)
    assert_slopes_are_differences(both, theta)
    assert laplace.information_root(both, theta[0]).shape == (7, 7)
    with pytest.raises(ValueError, match="unpack"):
        _ = both.likelihood.only_observation
