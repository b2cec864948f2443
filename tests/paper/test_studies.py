"""The paper's studies against laws and against their numbers worked out another way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from numpy.typing import NDArray
from oracles import NOMINAL, ORDER, by_expm, matrices, skewed
from rigs import STATES, experiment, measured, posterior, replace_only, starting, vector
from together import together

from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.unknowns import Coordinates
from bayesdrill.paper import forward, precision, printed, searches
from bayesdrill.paper import searches as study
from bayesdrill.paper.forward import SIX_STATES, integrate, six_states
from bayesdrill.paper.plugins import Fminsearch
from bayesdrill.paper.searches import MisfitSearch, Verification
from bayesdrill.record import regular
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators.exact import Response
from bayesdrill.sampling.convergence import Targets
from bayesdrill.sampling.ensembles import Plan
from bayesdrill.sampling.optimisers.contract import Optimum, Task
from bayesdrill.sampling.workers import WorkerPool

Array = NDArray[np.float64]

UNEVEN = np.array([0.02, 0.03, 0.05, 0.04])
W_2 = SIX_STATES.index("w_2")


def at(names: tuple[str, ...], *factors: float) -> dict[str, float]:
    """The nominal values of these, times factors."""
    return {name: NOMINAL[name] * f for name, f in zip(names, factors, strict=True)}


def target(
    names: tuple[str, ...],
    sigma: Array,
    n: int,
    start: dict[str, float],
    *,
    wide: tuple[float, float] = (0.1, 5.0),
) -> Posterior:
    """A record of the nominal rig with noise `sigma`; priors from `wide[0]` to `wide[1]` of nominal."""
    low, high = wide
    priors = {name: Uniform(low * NOMINAL[name], high * NOMINAL[name]) for name in names}
    found = posterior(measured(sigma, n=n), sigma, free=names, priors=priors)
    return starting(found, start)


# The printed matrix and the integrator


def augmented(reading: str, p: dict[str, float]) -> Array:
    whole = np.zeros((7, 7))
    whole[:6, :6], whole[:6, 6] = six_states(forward.READINGS[reading][1], p, {"v": 8.0})
    return whole


def test_readings_settle_where_they_are_after_hours_and_their_errors_are_the_largest() -> None:
    """From exponentials of the six states, one per sample and one of 20 000 s.

    Mutants killed: the end of the record for the end; any other error.
    """
    for reading in forward.readings(experiment(51, 0.02), skewed()):
        whole = augmented(reading.row["name"], skewed())
        end = scipy.linalg.expm(2e4 * whole)[W_2, 6]
        assert reading.row["w_end"] == pytest.approx(end, rel=1e-9, abs=1e-6)
        assert abs(reading.row["w_2"] - end) > 1e-3  # it still swings
        once = scipy.linalg.expm(0.02 * whole)
        x, exact = np.eye(7)[6], []
        for _ in reading.t:
            exact.append(x[W_2])
            x = once @ x
        found = integrate(whole[:6, :6], whole[:6, 6], np.zeros(6), reading.t)
        error = np.abs(found.x[:, W_2] - exact).max()
        assert reading.row["error"] == pytest.approx(error, rel=1e-6)
        assert reading.row["steps"] == found.steps
        assert reading.row["w_2_trapezoid"] == pytest.approx(found.x[-1, W_2])


def test_the_integrators_error_in_each_channel() -> None:
    """Against exponentials, in a channel that is a sum of states and from a start that is not zero."""
    measures = {"twist": {"theta_1": 1.0, "theta_2": -1.0}, "w_2": {"w_2": 1.0}, "i": {"i": 2.0}}
    start = {"theta_1": 0.3, "w_2": -1.0, "i": 4.0}
    record = experiment(81, 0.02, measures=measures, start=start)
    x = by_expm(skewed(), record.t, np.array([0.3, 0.0, 0.0, -1.0, 4.0]), 8.0, 0.0)
    exact = np.stack([x[:, 0] - x[:, 1], x[:, 3], 2 * x[:, 4]], axis=1)
    found, steps = forward.paper_signals(MotorShaft(), record, vector(skewed()))
    off = found - exact
    assert np.abs(off).max() < 0.03 * np.abs(exact).max()
    for k, error in enumerate(forward.errors(record, skewed())):
        assert error["channel"] == list(measures)[k]
        assert error["largest"] == pytest.approx(np.abs(off[:, k]).max(), rel=1e-5)
        assert error["rms"] == pytest.approx(np.sqrt((off[:, k] ** 2).mean()), rel=1e-5)
        assert error["steps"] == steps


def test_the_integrator_starts_where_the_state_is_given() -> None:
    """Mutant killed: the state of the time zero taken for that of the first sample."""
    start = {"theta_1": 0.3, "w_2": -1.0}
    record = experiment(41, 0.02, first=0.5, t_start=0.1, start=start)
    at_start = np.array([0.3, 0.0, 0.0, -1.0, 0.0])
    exact = by_expm(skewed(), record.t - 0.1, at_start, 8.0, 0.0)
    found, _ = forward.paper_signals(MotorShaft(), record, vector(skewed()))
    assert found.shape == exact.shape
    assert np.abs(found - exact)[:, :4].max() < 0.05 * np.abs(exact[:, :4]).max()


def test_a_measured_voltage_is_not_taken_for_none() -> None:
    record = experiment(41, constant={"t_1": 0.0}, series={"v": 8 + np.sin(np.arange(41.0))})
    with pytest.raises(ValueError, match="v must be constant"):
        forward.paper_signals(MotorShaft(), record, vector(NOMINAL))


# The misfit, exact and with the integrator


def test_records_have_the_misfit_that_is_expected_in_nineteen_of_twenty() -> None:
    """400 records; the share has a standard deviation of 1.1 %.

    Mutant killed: an interval of half of the records.
    """
    rig = target(("k_s",), UNEVEN, 40, at(("k_s",), 1.0))
    truth = vector(NOMINAL)[[ORDER.index("k_s")]]
    found = np.array(
        [
            precision.misfit_per_number(precision.made_record(rig, truth, 5, k), truth)
            for k in range(400)
        ]
    )
    low, high = precision.expected_misfit(rig.likelihood.n_measured)
    assert 0.92 < np.mean((low < found) & (found < high)) < 0.98
    squares = np.random.default_rng(3).standard_normal((8000, 25)) ** 2
    low, high = precision.expected_misfit(25)
    for tail in (squares.mean(axis=1) < low, squares.mean(axis=1) > high):
        assert np.mean(tail) == pytest.approx(0.025, abs=0.007)  # four standard deviations


BOX = ("c_m", "k_e")


@pytest.fixture(scope="module")
def boxed() -> Posterior:
    return target(BOX, UNEVEN, 41, at(BOX, 1.0, 1.0), wide=(0.5, 1.5))


def test_the_misfit_with_the_integrator_is_its_own(boxed: Posterior) -> None:
    """Mutants killed: the exact misfit, twice the density, noise that is the same everywhere."""
    y = boxed.likelihood.only_observation.response.experiment.y
    rows, expected = np.array([[0.8, 1.1], [1.4, 0.6]]), []
    for factors in rows:
        p = NOMINAL | at(BOX, *factors)
        matrix, forcing = six_states(MotorShaft(), p, {"v": 8.0})
        x = integrate(matrix, forcing, np.zeros(6), 0.01 * np.arange(41)).x
        off = x[:, [SIX_STATES.index(name) for name in STATES[:4]]] - y
        expected.append(np.mean((off / UNEVEN) ** 2))
    theta = rows * [NOMINAL[name] for name in BOX]
    for one, per in zip(theta, expected, strict=True):
        assert forward.stepped_misfit(boxed.likelihood, one) == pytest.approx(per, rel=1e-9)
    found = forward.stepped_task(precision.misfit_task(boxed), boxed.likelihood).density(theta)
    assert found == pytest.approx(-0.5 * y.size * np.array(expected))


def test_a_search_with_the_integrator_ends_at_the_priors(boxed: Posterior) -> None:
    """Mutant killed: a density beyond them."""
    theta = np.array([[1.6, 1.0], [1.0, 0.4], [1.0, 1.0]]) * [NOMINAL[name] for name in BOX]
    found = forward.stepped_task(precision.misfit_task(boxed), boxed.likelihood).density(theta)
    assert list(found[:2]) == [-np.inf, -np.inf]
    assert np.isfinite(found[2])


def test_the_heuristic_ends_lower_in_the_misfit_that_it_searches() -> None:
    """Mutants killed: the exact misfit for the integrator's, in the search and in what is told."""
    names = ("k_e", "t_f")
    rig = target(names, np.full(4, 0.002), 101, at(names, 1.1, 0.9))
    with WorkerPool(rig, 1) as pool:
        found = searches.run_heuristic(pool, rig, MisfitSearch(Fminsearch(), 400), 1, 5)
    own = [forward.stepped_misfit(rig.likelihood, x) for x in (found.stepped, found.estimate)]
    exact = [precision.misfit_per_number(rig, x) for x in (found.stepped, found.estimate)]
    assert found.stepped_misfit == pytest.approx(own[0])
    assert own[0] < 0.8 * own[1]
    assert exact[1] < 0.8 * exact[0]
    assert found.others_misfits == pytest.approx(
        [precision.misfit_per_number(rig, found.others[0])]
    )


def test_with_a_measured_voltage_the_heuristic_has_no_end_by_the_integrator() -> None:
    names = ("k_e", "t_f")
    rig = target(names, np.full(4, 0.02), 41, at(names, 1.1, 0.9))
    likelihood = rig.likelihood
    own = replace(
        likelihood.only_observation.response.experiment,
        constant={"t_1": 0.0},
        series={"v": np.full(41, 8.0)},
    )
    driven = replace_only(likelihood, response=Response(MotorShaft(), own))
    with WorkerPool(measured := replace(rig, likelihood=driven), 1) as pool:
        found = searches.run_heuristic(pool, measured, MisfitSearch(Fminsearch(), 60), 1, 5)
    assert (found.stepped, found.stepped_misfit) == (None, None)
    assert found.misfits[-1] < found.misfits[0]


# Table 2

PAIR = ("k_e", "t_f")
SIGMAS = (0.001, 0.02)
Verified = tuple[Posterior, Verification, Array, Array]


@pytest.fixture(scope="module")
def verified() -> Verified:
    """Four records at each sigma, searched from beside the truth, which is returned too.

    And what a sigma of 1 lets one know: bounds from the slopes of differences.
    """
    rig = target(PAIR, np.full(4, 0.05), 51, at(PAIR, 1.1, 1.03))
    truth = vector(NOMINAL)[[ORDER.index(name) for name in PAIR]]
    plan = Plan(
        ensembles=2,
        walkers=8,
        moves={"stretch": 1.0},
        targets=Targets(r_hat=1.2, n_tau=5, ess=100),
        max_steps=1000,
        seed=3,
    )
    y = rig.likelihood.signals(truth * np.exp(1e-5 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])))
    slopes = (y[::2] - y[1::2]).reshape(2, -1) / (2e-5 * truth[:, None])
    one = np.sqrt(np.diag(np.linalg.inv(slopes @ slopes.T)))
    with WorkerPool(rig, 1) as pool:
        return rig, study.verify(pool, rig, truth, SIGMAS, 4, plan), truth, one


@together("sigma", SIGMAS)
def test_bounds_and_posteriors_grow_with_the_noise(verified: Verified, sigma: float) -> None:
    """The priors, ten sd wide at least, do not matter: the posterior is as wide as the bound.

    Its sd is known to 10 % or better.  Mutants killed: a bound of sigma 1; twice the sd.
    """
    _, found, _, one = verified
    bound = sigma * one
    assert found.converged
    assert found.values[sigma]["bound"] == pytest.approx(bound, rel=1e-4)
    assert found.values[sigma]["posterior_sd"] == pytest.approx(bound, rel=0.3)
    off = (found.values[sigma]["posterior"] - found.values[sigma]["scaled"]) / bound
    assert np.abs(off).max() < 0.4


def test_records_differ_in_the_size_of_their_noise_alone(verified: Verified) -> None:
    """So estimates of a nearly linear problem lie in proportion off the truth, in both ways."""
    _, found, truth, one = verified
    off = [(found.estimates["scaled"][s] - truth) / (s * one) for s in SIGMAS]
    assert off[0].shape == (4, 2)
    assert off[1] == pytest.approx(off[0], abs=0.1)
    assert len(np.unique(off[0][:, 0])) == 4
    assert np.abs(off[0]).max() < 4.0
    for sigma in SIGMAS:
        for way in ("fminsearch", "scaled"):
            rows = found.estimates[way][sigma]
            assert (rows - truth) / (sigma * one) == pytest.approx(off[0], abs=0.2)
            first, spread = (found.values[sigma][stem] for stem in (way, f"sd_{way}"))
            assert first == pytest.approx(rows[0])
            assert spread**2 == pytest.approx(((rows - rows.mean(axis=0)) ** 2).sum(axis=0) / 3)
    assert found.values[0.001]["truth"] == pytest.approx(truth)


@together("sigma", SIGMAS)
def test_each_search_ends_low_in_the_misfit_of_its_own_record_and_model(
    verified: Verified, sigma: float
) -> None:
    """Mutants killed: an exact record for the integrator's own; noise where there is to be none."""
    rig, found, truth, _ = verified
    sized = precision.with_sigma(rig, sigma)
    noisy, clean = precision.made_record(sized, truth, 3, 0), precision.clean_record(sized, truth)
    p = vector(NOMINAL)
    own = forward.paper_signals(
        MotorShaft(), rig.likelihood.only_observation.response.experiment, p
    )[0]
    y, exact = (x.likelihood.only_observation.response.experiment.y for x in (noisy, clean))
    record = {
        "trapezoid_both": sized.edit(records=[own + y - exact]),
        "trapezoid_fit": noisy,
        "weights_only_trapezoid": sized.edit(records=[own]),
    }
    ends = {name: found.values[sigma][name] for name in record}
    beside = (
        0.2 / rig.likelihood.n_measured
    )  # how high a search may stop: less than what noise does
    for name, its in record.items():
        left = {
            other: forward.stepped_misfit(its.likelihood, end)
            for other, end in {**ends, "truth": truth}.items()
        }
        assert left[name] <= min(left.values()) + beside
        if sigma == 0.001 and name != "weights_only_trapezoid":
            (other,) = {"trapezoid_both", "trapezoid_fit"} - {name}
            assert left[name] + beside < left[other]  # small noise: the records differ by more
    assert forward.stepped_misfit(record["weights_only_trapezoid"].likelihood, truth) == 0.0
    weights = found.values[sigma]["weights_only"]
    assert precision.misfit_per_number(clean, weights) < 0.5 * beside


# Starts all over, and the control


@pytest.fixture(scope="module")
def swinging() -> Posterior:
    names = ("k_s", "j_1")
    return target(names, np.full(4, 5.0), 401, at(names, 1.3, 0.6), wide=(0.2, 4.0))


@together("sigma", [5.0, 20.0])
def test_ends_of_searches_are_told_apart_by_their_misfits(
    swinging: Posterior, sigma: float
) -> None:
    """Little but k_s/j_1 shows in the swing, which has a second best frequency.

    In loud noise that one is within the noise, but not as good; in less it is not within it.
    Mutants killed: `reached` the other way round, `best` a hundred times as easy.
    """
    truth = np.array([NOMINAL[name] for name in swinging.space.free])
    rig = precision.made_record(precision.with_sigma(swinging, sigma), truth, 8, 0)
    with WorkerPool(rig, 1) as pool:
        ends = searches.many_searches(pool, rig, truth, ((1, -1),), 4, 3)
    assert [end.way for end in ends] == 4 * ["fminsearch"] + 4 * ["scaled"]
    numbers = 4 * 401
    low, high = precision.expected_misfit(numbers)
    far = [end for end in ends if end.scales[0] > 0.3]
    near = [end for end in ends if end not in far]
    assert far
    assert near
    for end in ends:
        # Two unknowns: the part along the one symmetry, and the rest along (1, 1), up to its sign.
        points = truth * np.exp(
            end.scales[0] * np.array([1, -1]) + end.rest * np.array([[1], [-1]])
        )
        assert np.any(np.isclose(rig.likelihood.mean_square(points), end.misfit, rtol=1e-9))
        assert end.distance**2 == pytest.approx(end.scales[0] ** 2 + end.rest**2)
        assert end.settled
    assert all(end.reached and end.best and low < end.misfit < high for end in near)
    assert min(end.misfit for end in ends) <= precision.misfit_per_number(rig, truth)
    if sigma == 20.0:
        assert all(end.reached and not end.best for end in far)
        assert max(end.misfit - near[0].misfit for end in far) < 100 * 4.0 / numbers
    else:
        assert not any(end.reached or end.best for end in far)
        assert min(end.misfit for end in far) > high
    starts = rig.space.vector(rig.space.start)[None]
    (first,) = Fminsearch()(precision.misfit_task(rig), starts, searches.EVALUATIONS)
    assert ends[0].misfit == pytest.approx(precision.misfit_per_number(rig, first.theta))


def test_the_control_tells_the_largest_of_what_a_search_makes_of_records_with_that_noise() -> None:
    """By a search whose estimates are off by the noise that it finds, and by where its turn is.

    Mutants killed: the least of the distances, records with another noise, one record for all.
    """
    names = ("k_e", "j_1")
    rig = target(names, np.full(4, 0.3), 101, at(names, 0.9, 1.2))
    truth = rig.space.vector(rig.space.start)
    factors = np.array([[1.2, 0.99], [0.7, 1.01], [1.1, 0.96]])
    seen: list[float] = []

    def off(task: Task, starts: Array, evaluations: int) -> list[Optimum]:
        assert evaluations == 77
        (start,) = starts
        # Log likelihood at the truth: -(n/2) (log(2 pi sigma^2) + the misfit, nearly 1).
        per = -2 * task.at(start) / rig.likelihood.n_measured
        seen.append(float(np.exp(0.5 * (per - 1)) / np.sqrt(2 * np.pi)))
        theta = start * factors[(len(seen) - 1) % 3]
        return [Optimum(theta=theta, value=0.0, evaluations=1, settled=True, history=())]

    sigmas = (0.02, 0.5)
    with WorkerPool(rig, 1) as pool:
        found = searches.control(pool, rig, MisfitSearch(off, 77), sigmas, 3, 9)
    assert seen == pytest.approx(np.repeat(sigmas, 3), rel=0.15)  # four standard deviations
    assert len(set(seen)) == 6
    assert [(c["sigma"], c["parameter"], c["records"]) for c in found] == [
        (sigma, name, 3) for sigma in sigmas for name in names
    ]
    assert [c["largest_percent"] for c in found] == pytest.approx([30.0, 4.0, 30.0, 4.0])
    again = precision.made_record(precision.with_sigma(rig, 0.5), truth, 9, 1)
    per = precision.misfit_per_number(again, truth)
    assert seen[4] == pytest.approx(0.5 * np.exp(0.5 * (per - 1)))


# What the deviations of Table 2 and the quantities of Table 3 say


def test_bounds_of_lengths_are_those_at_a_thousandth_and_repeats_attain_what_is_wanted() -> None:
    """Mutant killed: a factor of a thousand in the bounds."""
    rig = target(("c_m", "k_e"), UNEVEN, 51, {})
    one = rig.likelihood.only_observation
    grid = ((0.7, 50.0), (2.0, 120.0))
    attained = printed.TWO_PARAMETERS[1.0]["c_m"].deviation / 100
    for line, size in zip(precision.lengths(rig.likelihood, NOMINAL, grid), grid, strict=True):
        assert (line["duration"], line["rate"]) == size
        longer = regular(one.experiment, *size)
        response = Response(one.response.model, longer)
        noise = one.noise.for_length(len(longer.t))
        own = replace_only(rig.likelihood, response=response, noise=noise)
        relative = precision.at_sigma_1(own, NOMINAL)
        for name, bound in relative.items():
            assert line[f"{name}_percent"] / 100 == pytest.approx(0.001 * bound)
        assert relative["c_m"] / np.sqrt(line["repeats"]) == pytest.approx(attained)


def test_the_implied_noise_is_that_at_which_the_bound_is_the_deviation() -> None:
    """Back from its rows; and deviations that are the bounds at a noise lead to that."""
    one = {"c_m": 37.1, "k_e": 0.29}
    found = {line["row"]: line for line in precision.implied_noise(one)}
    for line in found.values():
        for name in one:
            percent, noise = line[f"{name}_percent"], line[f"noise_{name}"]
            assert noise * one[name] == pytest.approx(percent / 100)
        assert line["ratio"] * line["k_e_percent"] == pytest.approx(line["c_m_percent"])
    assert found["bound"]["noise_c_m"] == pytest.approx(0.001)
    assert found["bound"]["noise_k_e"] == pytest.approx(0.001)
    rows = [found.pop(f"{sigma:g}") for sigma in printed.TWO_PARAMETERS]
    for name in one:
        each = np.array([line[f"{name}_percent"] for line in rows])
        rms = found["rms"][f"{name}_percent"]
        assert rms**2 * len(each) == pytest.approx(each @ each)
        assert each.min() < rms < each.max()
    # A rig whose bounds are the printed deviations of one row, at a noise of 3.
    row = printed.TWO_PARAMETERS[0.1]
    same = precision.implied_noise({name: row[name].deviation / 100 / 3.0 for name in one})[2]
    assert (same["noise_c_m"], same["noise_k_e"]) == pytest.approx((3.0, 3.0))


def speed(p: dict[str, float]) -> float:
    """Of the rig in the end: nothing accelerates, and the shaft is slack."""
    i_m, v = 1 / 8, 8.0
    push = i_m * p["k_T"] / p["r_m"]
    return (push * v - i_m * p["t_f"]) / (p["c_m"] + push * p["k_e"] / i_m)


def damping(p: dict[str, float]) -> float:
    found = np.linalg.eigvals(matrices(p)[0])
    swings = found[np.abs(found.imag) > 1.0]
    return float((-swings.real / np.abs(swings)).min())


def test_the_end_of_a_step_and_the_damping_are_those_of_the_equations() -> None:
    rigs = [skewed(), NOMINAL]
    many = {name: np.array([p[name] for p in rigs]) for name in ORDER}
    found = printed.quantities(MotorShaft(), many, {"v": 8.0}, 2)
    late = [by_expm(p, np.array([1000.0]), np.zeros(5), 8.0, 0.0)[0, 3] for p in rigs]
    assert found["w_end"] == pytest.approx(late, rel=1e-6)
    assert found["w_end"] == pytest.approx([speed(p) for p in rigs])
    assert found["zeta"] == pytest.approx([damping(p) for p in rigs], rel=1e-6)
    p = skewed()
    assert found["r_m j_m/(k_T k_e)"][0] == pytest.approx(p["r_m"] * p["j_m"] / p["k_T"] / p["k_e"])


def test_a_quantity_that_the_config_gives_is_none_of_the_records() -> None:
    names = ("c_m", "k_e")  # the rest is held
    rig = target(names, UNEVEN, 31, at(names, 1.1, 0.9))
    mode = rig.space.vector(at(names, 1.0, 1.0))
    draws = mode * np.exp(0.1 * np.random.default_rng(3).standard_normal((200, 2)))
    found = {cause["quantity"]: cause for cause in printed.causes(rig, mode, 1.1 * mode, draws)}
    for name, cause in found.items():
        known = tuple(cause[what] for what in ("posterior", "hdi94_low", "hdi94_high", "alone"))
        if set(printed.PRODUCTS.get(name, names)) & set(names):
            assert np.all(np.isfinite(known)), name
        else:
            assert known == (None,) * 4, name
        expected = 1.0 if cause["posterior"] is None else cause["heuristic"]
        assert cause["heuristic"] == pytest.approx(expected)


@together("channels", [STATES[:4], ("i",)])
def test_what_a_record_says_alone_is_its_information_without_any_prior(
    channels: tuple[str, ...],
) -> None:
    """Nine unknowns, seven of whose products show: by slopes of differences and their null space.

    The current alone leaves the size of a turn open: k_e, and w_end with it, can be anything.
    """
    point, sigma = vector(skewed()), UNEVEN[: len(channels)]
    rig = posterior(experiment(151, 0.02, measures={c: {c: 1.0} for c in channels}), sigma)

    def slopes(h: float) -> Array:
        moved = point * np.exp(np.vstack([h * np.eye(9), -h * np.eye(9)]))
        y = rig.likelihood.signals(moved) / sigma
        return np.asarray((y[:9] - y[9:]).reshape(9, -1).T / (2 * h))

    _, values, rows = np.linalg.svd((4 * slopes(1e-3) - slopes(2e-3)) / 3, full_matrices=False)
    assert values[6] > 100 * values[7]

    def logs(h: float) -> Array:
        p = [dict(zip(ORDER, point * np.exp(row), strict=True)) for row in h * np.eye(9)]
        return np.log([[speed(x), damping(x)] for x in p]).T

    following = (logs(1e-5) - logs(-1e-5)) / 2e-5
    exponents = {
        name: np.array([powers.get(x, 0.0) for x in ORDER])
        for name, powers in printed.PRODUCTS.items()
    } | dict(zip(("w_end", "zeta"), following, strict=True))
    draws = point * np.exp(0.1 * np.random.default_rng(1).standard_normal((500, 9)))
    found = {c["quantity"]: c for c in printed.causes(rig, point, 1.1 * point, draws)}
    assert set(found) == set(exponents)
    infinite = set()
    for name, own in exponents.items():
        along = rows[:7] @ own
        if np.linalg.norm(own - rows[:7].T @ along) > 0.1:
            assert found[name]["alone"] == np.inf
            infinite.add(name)
        else:
            expected = np.linalg.norm(along / values[:7])
            assert found[name]["alone"] == pytest.approx(expected, rel=0.01)
    assert infinite >= {"k_e", "w_end"} if channels == ("i",) else not infinite
    # And the draws: of k_s/j_1, over its value at the guesses of the paper.
    ratio = draws[:, ORDER.index("k_s")] / draws[:, ORDER.index("j_1")] / (0.26 / 28.3e-3)
    cause = found["k_s/j_1"]
    assert cause["posterior"] == pytest.approx(np.median(ratio))
    assert np.mean((cause["hdi94_low"] <= ratio) & (ratio <= cause["hdi94_high"])) == pytest.approx(
        0.94, abs=0.005
    )


# MATLAB's fminsearch


@together("n", [1, 2, 4])
def test_fminsearch_gives_up_where_matlab_documents_it(n: int) -> None:
    """On a slope without end: MaxFunEvals and MaxIter are 200 times the number of unknowns."""
    endless = Task(
        names=tuple("abcd"[:n]),
        density=lambda theta: np.asarray(theta.sum(axis=-1)),
        coordinates=Coordinates((False,) * n),
        covariance=lambda theta: np.eye(n),
    )
    (found,) = Fminsearch()(endless, np.ones((1, n)), 100_000)
    assert not found.settled
    assert max(found.evaluations, len(found.history)) == 200 * n
    assert Fminsearch()(endless, np.ones((1, n)), 50)[0].evaluations == 50
