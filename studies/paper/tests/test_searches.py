"""The searches of the paper against least squares, and what is said of their ends."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from numpy.typing import NDArray
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL, ORDER, skewed
from support.small_problems import noisy_step, posterior, replace_only, vector, with_start

from bayesdrill.inference import Posterior, Uniform
from bayesdrill.rig import MotorShaft, Response
from bayesdrill.sampling import Optimum, Plan, Task, WorkerPool
from bayesdrill.sampling.convergence import Targets
from studies.paper import forward, precision, searches
from studies.paper.optimisers import Pairwise, fminsearch
from studies.paper.searches import MisfitSearch, Verification
from studies.paper.tests.records import at, target

Array = NDArray[np.float64]
SIGMA = np.full(4, 0.02)

TWO = ("c_m", "k_e")


@run_cases("way", precision.WAYS)
@run_cases("sigma", [0.001, 0.3])
def test_estimates_are_those_of_least_squares(way: str, sigma: float) -> None:
    """Negative ones too."""
    priors = {"c_m": Uniform(0.0, 0.02), "k_e": Uniform(0.0, 0.2)}
    start = {"c_m": 1e-3, "k_e": 1e-2}
    target = with_start(posterior(noisy_step(SIGMA), SIGMA, free=TWO, priors=priors), start)
    truth = np.array([NOMINAL[name] for name in TWO])
    indices = (3, 4, 5)
    found = searches.estimates(target, way, sigma, truth, 7, indices)
    scale = sigma * precision.bounds(target.likelihood, truth)
    negative = 0
    for row, index in zip(found, indices, strict=True):
        own = precision.made_record(precision.with_sigma(target, sigma), truth, 7, index)
        y = own.likelihood.only_observation.response.experiment.y

        def rest(steps: np.ndarray, y: np.ndarray = y) -> np.ndarray:
            at = (truth + scale * steps)[None]
            return ((target.likelihood.signals(at)[0] - y) / sigma).ravel()

        best = scipy.optimize.least_squares(rest, np.zeros(2), diff_step=1e-3, x_scale=1.0)
        assert row == pytest.approx(truth + scale * best.x, abs=0.05 * scale[0])
        negative += row[0] < 0
    assert negative or sigma < 0.1


def test_distance_from_the_truth_is_split_along_the_symmetries() -> None:
    symmetries = [
        tuple(int(name in ["j_m", "c_m", "k_s", "j_1", "t_f", "k_T"]) for name in ORDER),
        tuple(int(name in ["l_m", "r_m", "k_T"]) for name in ORDER),
    ]
    truth = vector(skewed())
    moved = truth * np.exp(0.7 * np.array(symmetries[0]) - 0.3 * np.array(symmetries[1]))
    scales, rest, distance = searches.distinct_ends(moved, truth, symmetries)
    assert scales == pytest.approx((0.7, -0.3))
    assert rest == pytest.approx(0.0, abs=1e-12)
    moved[ORDER.index("k_e")] *= np.exp(0.6)  # which no symmetry has
    scales, rest, further = searches.distinct_ends(moved, truth, symmetries)
    assert scales == pytest.approx((0.7, -0.3))
    assert rest == pytest.approx(0.6 / 3.0)
    assert further > distance
    assert searches.distinct_ends(moved, truth, [])[1:] == pytest.approx((further, further))


@pytest.mark.slow
def test_path_of_the_heuristic_begins_and_ends_at_its_misfits() -> None:
    target = posterior(noisy_step(SIGMA, n=60), SIGMA, free=("k_e", "k_s", "j_1"))
    names = target.space.free
    own = Pairwise()
    start = {name: 1.15 * NOMINAL[name] for name in names}
    target = with_start(target, start)
    with WorkerPool(target, 1) as pool:
        found = searches.run_heuristic(pool, target, searches.MisfitSearch(own, 5000), 3, 5)
    assert found.misfits[0] == pytest.approx(precision.misfit_per_number(target, found.guess))
    assert found.misfits[-1] == pytest.approx(
        precision.misfit_per_number(target, found.estimate), rel=1e-6
    )
    assert np.all(np.diff(found.misfits) <= 1e-9)
    assert found.misfits[-1] < 0.01 * found.misfits[0]
    assert len(np.unique(found.others[:, 0])) == 3


def test_the_heuristic_ends_lower_in_the_misfit_that_it_searches() -> None:
    names = ("k_e", "t_f")
    rig = target(names, np.full(4, 0.002), 101, at(names, 1.1, 0.9))
    with WorkerPool(rig, 1) as pool:
        found = searches.run_heuristic(pool, rig, MisfitSearch(fminsearch, 400), 1, 5)
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
        found = searches.run_heuristic(pool, measured, MisfitSearch(fminsearch, 60), 1, 5)
    assert (found.stepped, found.stepped_misfit) == (None, None)
    assert found.misfits[-1] < found.misfits[0]


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
        return rig, searches.verify(pool, rig, truth, SIGMAS, 4, plan), truth, one


@pytest.mark.slow
@run_cases("sigma", SIGMAS)
def test_bounds_and_posteriors_grow_with_the_noise(verified: Verified, sigma: float) -> None:
    """The priors, ten sd wide at least, do not matter: the posterior is as wide as the bound.

    Its sd is known to 10 % or better.
    """
    _, found, _, one = verified
    bound = sigma * one
    assert found.converged
    assert found.values[sigma]["bound"] == pytest.approx(bound, rel=1e-4)
    assert found.values[sigma]["posterior_sd"] == pytest.approx(bound, rel=0.3)
    off = (found.values[sigma]["posterior"] - found.values[sigma]["scaled"]) / bound
    assert np.abs(off).max() < 0.4


@pytest.mark.slow
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


@pytest.mark.slow
@run_cases("sigma", SIGMAS)
def test_each_search_ends_low_in_the_misfit_of_its_own_record_and_model(
    verified: Verified, sigma: float
) -> None:
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


@pytest.fixture(scope="module")
def swinging() -> Posterior:
    names = ("k_s", "j_1")
    return target(names, np.full(4, 5.0), 401, at(names, 1.3, 0.6), wide=(0.2, 4.0))


@run_cases("sigma", [5.0, 20.0])
def test_ends_of_searches_are_told_apart_by_their_misfits(
    swinging: Posterior, sigma: float
) -> None:
    """Little but k_s/j_1 shows in the swing, which has a second best frequency.

    In loud noise that one is within the noise, but not as good; in less it is not within it.
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
    (first,) = fminsearch(precision.misfit_task(rig), starts, searches.EVALUATIONS)
    assert ends[0].misfit == pytest.approx(precision.misfit_per_number(rig, first.theta))


def test_the_control_tells_the_largest_of_what_a_search_makes_of_records_with_that_noise() -> None:
    """By a search whose estimates are off by the noise that it finds, and by where its turn is."""
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
        return [Optimum(theta=theta, value=0.0, evaluations=1, settled=True)]

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
