"""What holds of every noise: densities, slopes, whitening and draws belong to one distribution.

Mutants killed: a normalisation that forgets a term, a slope with the wrong sign, draws of another
size than the density's, whitening that leaves what it should take, channels exchanged.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.special
import scipy.stats
from numpy.typing import NDArray
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL
from support.small_problems import experiment, likelihood_of, unknown

from bayesdrill.inference import laplace
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.noise import NOISES
from bayesdrill.inference.noise.contract import Noise, NoisyChannel, as_matrix
from bayesdrill.inference.noise.mixed import ChannelNoise, Mixed
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.unknowns import ParameterSpace
from bayesdrill.record.experiment import Channel
from bayesdrill.rig.models.motor_shaft import PARAMETERS, MotorShaft
from bayesdrill.rig.simulators.linear import Response

Array = NDArray[np.float64]
SIGMA = (0.3, 0.02)  # unequal
RECORDS = 4000
ENTRIES: dict[str, Callable[[float], dict[str, float]]] = {"quantised": lambda s: {"step": 1.5 * s}}


def channels(
    names: tuple[str, ...] = ("w_1", "w_2"), *, known: bool = False, kind: str = "white"
) -> list[NoisyChannel]:
    return [
        NoisyChannel(
            channel=Channel(
                name=name, weights={name: 1.0}, unit="rad/s", latex=name, latex_unit=""
            ),
            sigma=sigma if known else Uniform(0.1 * sigma, 10 * sigma),
            start=sigma,
            entries=ENTRIES.get(kind, lambda _: {})(sigma),
        )
        for name, sigma in zip(names, SIGMA, strict=False)
    ]


def test_results_know_a_noise_by_its_text() -> None:
    """A resumed run is refused where it is another: fields may not be renamed without its old text."""
    texts = {
        name: repr(kind.from_channels(channels(kind=name), 7)) for name, kind in NOISES.items()
    }
    for name, known in (("ar1", "AR1"), ("student_t", "StudentT"), ("quantised", "Quantised")):
        assert texts[name].startswith(f"{known}(levels=White(n_samples=7, known={{}}, n_channels=2")


def mixed(n: int) -> Noise:
    """The second channel first."""
    first, second = channels()
    return Mixed(
        (
            ChannelNoise(White.from_channels([second], n), (1,)),
            ChannelNoise(White.from_channels([first], n), (0,)),
        )
    )


def held(n: int) -> Noise:
    """What else is held; the second channel with a memory, the first with heavy tails."""
    first, second = channels()
    parts = (
        ChannelNoise(NOISES["ar1"].from_channels([replace(second, entries={"rho": 0.9})], n), (1,)),
        ChannelNoise(
            NOISES["student_t"].from_channels([replace(first, entries={"degrees": 4.0})], n), (0,)
        ),
    )
    return Mixed(parts)


MADE = {
    **{f"{name}, unknown": kind for name, kind in NOISES.items()},
    **{f"{name}, known": kind for name, kind in NOISES.items()},
    "mixed": None,
    "held": None,
}


def noise(name: str, n: int) -> Noise:
    kind = MADE[name]
    if kind is None:
        return mixed(n) if name == "mixed" else held(n)
    own = channels(known=name.endswith(" known"), kind=name.partition(",")[0])
    return kind.from_channels(own, n)


def truth(of: Noise, w: int = 1) -> Array:
    """Off the start, and different for each of W walkers."""
    share = np.random.default_rng(len(of.unknowns)).uniform(0.3, 0.7, (w, len(of.unknowns)))
    columns = [one.prior.quantile(share[:, k]) for k, one in enumerate(of.unknowns)]
    return np.stack(columns, axis=-1) if columns else np.empty((w, 0))


def drawn(of: Noise, own: Array, n: int, seed: int = 3) -> Array:
    blank = np.zeros((len(own), n, len(SIGMA)))
    return of.draw(blank, own, np.random.default_rng(seed))


def asked(samples: Array) -> SimpleNamespace:
    squares = (samples**2).sum(axis=1)
    steps = (np.diff(samples, axis=1) ** 2).sum(axis=1)
    ends = samples[:, 0] ** 2 + samples[:, -1] ** 2
    return SimpleNamespace(
        samples=samples,
        squares=squares,
        weighted_squares=lambda w: squares * w**2,
        neighbours=np.stack([squares, steps, ends], axis=-1),
        logs=lambda w: np.log1p(w[:, None] * samples**2).sum(axis=1),
        intervals=lambda over, half: masses(samples * over[:, None], half[:, None]).sum(axis=1),
    )


def masses(middle: Array, half: Array) -> Array:
    """Logs of what a standard normal number has within half a width of a middle, in the lower tail."""
    near, far = half - np.abs(middle), -half - np.abs(middle)
    one = scipy.special.log_ndtr(near)
    return np.asarray(one + np.log(-np.expm1(scipy.special.log_ndtr(far) - one)))


def natural(of: Noise, own: Array, column: int, step: float) -> Array:
    """A step in the log of what is positive, or else in the unknown itself."""
    moved, plain = own.copy(), of.unknowns[column].between is not None
    moved[:, column] = own[:, column] + step if plain else own[:, column] * np.exp(step)
    return moved


@run_cases("name", MADE)
def test_the_density_of_two_samples_integrates_to_one(name: str) -> None:
    of = noise(name, 2)
    own, sd = truth(of), of.scales(truth(of))[0]
    x = np.linspace(-9, 9, 401)
    pairs = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2, 1) * sd
    log_p = of.log_likelihood(asked(pairs), np.repeat(own, len(pairs), axis=0))
    area = (x[1] - x[0]) ** 2 * sd**2
    assert (np.exp(log_p).sum(axis=0) * area) == pytest.approx(np.ones(2), rel=1e-3)


@run_cases("name", MADE)
def test_terms_of_single_samples_sum_to_the_likelihood_whatever_the_batch(name: str) -> None:
    of = noise(name, 30)
    own = truth(of, 5)
    samples = drawn(of, own, 30)
    whole = of.log_likelihood(asked(samples), own)
    assert of.pointwise(samples, own).sum(axis=1) == pytest.approx(whole, rel=1e-12)
    for k in range(5):
        alone = of.log_likelihood(asked(samples[k : k + 1]), own[k : k + 1])
        assert np.array_equal(alone[0], whole[k])
        assert np.array_equal(
            of.whiten(samples[k : k + 1], own[k : k + 1])[0], of.whiten(samples, own)[k]
        )
    longer = of.for_length(40)
    assert longer.log_likelihood(asked(drawn(of, own, 40)), own).shape == whole.shape
    assert set(of.fixed_values()) <= {0, 1}


@run_cases("name", MADE)
def test_slopes_are_those_of_the_density(name: str) -> None:
    of = noise(name, 12)
    own = truth(of, 3)
    samples = 1.3 * drawn(of, own, 12)

    def value(signals: Array, at: Array = own) -> Array:
        return of.log_likelihood(asked(samples - signals), at).sum(axis=1)

    shift = np.random.default_rng(1).standard_normal(samples.shape) * of.scales(own)[:, None]
    numeric = (value(1e-5 * shift) - value(-1e-5 * shift)) / 2e-5
    assert (of.score(samples, own) * shift).sum(axis=(1, 2)) == pytest.approx(numeric, rel=1e-6)
    slope, curvature = of.noise_score(asked(samples), own)
    for column in range(len(of.unknowns)):
        up, down = (value(0.0 * shift, natural(of, own, column, h)) for h in (1e-5, -1e-5))
        assert slope[:, column] == pytest.approx((up - down) / 2e-5, rel=1e-5, abs=1e-5)
        assert (as_matrix(curvature, own)[:, column, column] > 0).all()
    assert (np.linalg.eigvalsh(as_matrix(curvature, own)) > 0).all()


@run_cases("name", MADE)
def test_information_is_what_slopes_scatter_over_draws(name: str) -> None:
    """At the truth slopes are zero on average, and their squares are the information."""
    n = 25
    of = noise(name, n)
    own = np.repeat(truth(of), RECORDS, axis=0)
    samples = drawn(of, own, n)
    shift = np.linspace(-1.0, 2.0, n)[:, None] * of.scales(own[:1])[0]
    along = (of.score(samples, own) * shift).sum(axis=(1, 2))
    told = float((of.whitened_jacobian(shift[None], own[:1]) ** 2).sum())
    assert abs(along.mean()) < 5 * np.sqrt(told / RECORDS)
    assert along.var() == pytest.approx(told, rel=0.15)
    twice = of.whitened_jacobian(2.0 * shift[None], own[:1])
    assert twice == pytest.approx(2.0 * of.whitened_jacobian(shift[None], own[:1]))
    slope, _ = of.noise_score(asked(samples), own)
    expected = as_matrix(of.expected(own[0]), own[0])
    assert expected.shape == (len(of.unknowns),) * 2
    size = np.sqrt(np.diag(expected))
    assert (np.abs(slope.mean(axis=0)) < 5 * size / np.sqrt(RECORDS)).all()
    scatter = np.atleast_2d(np.cov(slope, rowvar=False)) if of.unknowns else expected
    assert scatter / np.outer(size, size) == pytest.approx(
        expected / np.outer(size, size), abs=0.12
    )


@run_cases("name", MADE)
def test_what_is_whitened_is_white_and_its_size_is_told(name: str) -> None:
    n = 6000
    of = noise(name, n)
    own = truth(of)
    samples = drawn(of, own, n)
    left = of.whiten(samples, own)[0]
    for k in range(len(SIGMA)):
        assert scipy.stats.kstest(left[:, k], "norm").pvalue > 1e-4
        assert abs(np.corrcoef(left[1:, k], left[:-1, k])[0, 1]) < 5 / np.sqrt(n)
    assert samples[0].std(axis=0) == pytest.approx(of.scales(own)[0], rel=0.15)
    if of.unknowns:
        begun = np.array([one.start for one in of.unknowns])
        found = of.fitted(samples[0], begun)
        sd = np.sqrt(np.diag(np.linalg.inv(as_matrix(of.expected(own[0]), own[0]))))
        plain = np.array([one.between is not None for one in of.unknowns])
        off = np.where(plain, found - own[0], np.log(np.abs(found / own[0])))
        assert (np.abs(off) < 6 * sd).all()


@run_cases("name", MADE)
def test_innovations_are_what_samples_before_do_not_tell(name: str) -> None:
    """Nothing of a sample that comes later, all of the sample itself; not larger than the residuals.

    Mutants killed: a prediction from the sample itself; whitened numbers.
    """
    n = 3000
    of = noise(name, n)
    own = truth(of)
    samples = drawn(of, own, n)
    found = of.innovations(samples, own)
    changed = samples.copy()
    changed[:, 50] += np.array(SIGMA)
    moved = of.innovations(changed, own) - found
    assert moved[0, :50] == pytest.approx(np.zeros((50, len(SIGMA))), abs=1e-12)
    assert moved[0, 50] == pytest.approx(np.array(SIGMA))
    for k in range(len(SIGMA)):
        assert found[0, :, k].std() < 1.001 * samples[0, :, k].std()
        assert abs(np.corrcoef(found[0, 1:, k], found[0, :-1, k])[0, 1]) < 5 / np.sqrt(n)


def target(name: str) -> Posterior:
    """Of a rig with three unknowns."""
    n = 80
    of = noise(name, n)
    measures = {"w_1": {"w_1": 1.0}, "w_2": {"w_2": 1.0}}
    clean = Response(MotorShaft(), experiment(n, measures=measures))
    full = np.array([[NOMINAL[p] for p in PARAMETERS]])
    y = clean.signals(full)[0] + drawn(of, truth(of), n)[0]
    free = ("k_e", "k_s", "j_1")
    own = [unknown(p, Uniform(0.5 * NOMINAL[p], 1.5 * NOMINAL[p])) for p in free]
    space = ParameterSpace(
        model=PARAMETERS,
        unknowns=(*own, *of.unknowns),
        fixed={p: NOMINAL[p] for p in PARAMETERS if p not in free},
    )
    likelihood = likelihood_of(space, (clean.with_record(y), of))
    return Posterior(space=space, likelihood=likelihood, coordinates=space.coordinates)


@run_cases("name", MADE)
def test_a_posterior_with_it_has_the_slopes_of_its_density(name: str) -> None:
    of = target(name)
    surface = LogDensity(of)
    share = np.random.default_rng(4).uniform(0.35, 0.65, (3, len(of.space.free)))
    priors = of.space.priors.values()
    theta = np.stack([p.quantile(s) for p, s in zip(priors, share.T, strict=True)], axis=-1)
    u = of.coordinates.from_physical(theta)
    assert of.coordinates.to_physical(u) == pytest.approx(theta, rel=1e-12)
    found = surface.quadratic_model(u, np.eye(u.shape[1]))
    for d in range(u.shape[1]):
        step = 1e-5 * surface.spread[d] * np.eye(u.shape[1])[d]
        numeric = (surface.value(u + step) - surface.value(u - step)) / (2 * step.sum())
        scale = 1e-6 * np.abs(found.slope[:, d]).max() + 1e-3
        assert found.slope[:, d] == pytest.approx(numeric, rel=1e-4, abs=scale)
    assert (np.linalg.eigvalsh(found.curvature) > 0).all()


@run_cases("name", MADE)
def test_its_information_is_that_of_the_curvature_at_the_truth(name: str) -> None:
    """Laplace's root, in the natural scales, against the surface's, in the coordinates."""
    of = target(name)
    own = truth(of.likelihood.only_observation.noise)[0]
    at = np.append([NOMINAL[p] for p in ("k_e", "k_s", "j_1")], own)
    u = of.coordinates.from_physical(at[None])
    curvature = LogDensity(of).quadratic_model(u, np.eye(len(at))).curvature[0]
    sd = np.sqrt(np.diag(laplace.covariance(of, at)))
    other = np.sqrt(np.diag(np.linalg.inv(curvature)))
    told = other < 0.5 * LogDensity(of).spread  # of others the priors decide, each in its way
    assert told[:3].all()
    assert sd[told] == pytest.approx(other[told], rel=0.3)


def test_two_records_say_together_what_each_says() -> None:
    """Each with a noise of its own; slopes and information add up."""
    one, two = (target(name) for name in ("white, unknown", "mixed"))
    rig = one.space.unknowns[:3]
    first, second = one.likelihood.only_observation, two.likelihood.only_observation
    others = [
        replace(one, symbol=replace(one.symbol, name=f"{one.name}_b"))
        for one in second.noise.unknowns
    ]
    space = ParameterSpace(
        model=PARAMETERS,
        unknowns=(*rig, *first.noise.unknowns, *others),
        fixed=one.space.fixed,
    )
    pairs = [(first.response, first.noise), (second.response, second.noise)]
    both = likelihood_of(space, *pairs)
    theta = np.array([[*(NOMINAL[p] for p in ("k_e", "k_s", "j_1")), 0.3, 0.02, 0.03, 0.2]])
    apart = one.likelihood(theta[:, :5]) + two.likelihood(theta[:, [0, 1, 2, 5, 6]])
    assert both(theta) == pytest.approx(apart)
    assert both.n_measured == one.likelihood.n_measured + two.likelihood.n_measured
    whole = Posterior(space=space, likelihood=both, coordinates=space.coordinates)
    u = whole.coordinates.from_physical(theta)
    found = LogDensity(whole).quadratic_model(u, np.eye(7))
    for d in range(7):
        step = 1e-6 * np.eye(7)[d]
        surface = LogDensity(whole)
        numeric = (surface.value(u + step) - surface.value(u - step)) / 2e-6
        assert found.slope[:, d] == pytest.approx(numeric, rel=1e-4, abs=1e-2)
    information = laplace.information_root(whole, theta[0])
    assert information.shape == (7, 7)
    with pytest.raises(ValueError, match="unpack"):
        _ = both.only_observation
