"""The density of a posterior against SciPy, term by term, and posteriors that are edited."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from support import stepped_friction, two_experiments
from support.case_tables import run_cases
from support.friction_cases import CASES
from support.scipy_oracles import NOMINAL, ORDER
from support.small_problems import noisy_step, posterior, posterior_of, vector

from bayesdrill.inference import step_error
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.unknowns import Unknown
from bayesdrill.rig.models import PARAMETERS
from bayesdrill.rig.models.linear import with_named
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.sampling import mode_search

SIGMA = np.array([0.1, 0.07, 0.2, 0.15])
RECORD = noisy_step(SIGMA, n=150)
LOG_VOLUME = np.log(vector(NOMINAL)).sum()  # each prior is one nominal value wide


def points(n: int) -> np.ndarray:
    return vector(NOMINAL) * np.random.default_rng(1).uniform(0.8, 1.2, (n, 9))


def test_the_density_with_known_sigma_is_a_product_of_normal_densities() -> None:
    target, theta = posterior(RECORD, SIGMA), points(5)
    normal = scipy.stats.norm(target.likelihood.signals(theta), SIGMA)
    expected = normal.logpdf(RECORD.y).sum(axis=(1, 2)) - LOG_VOLUME
    assert target.density(theta) == pytest.approx(expected, rel=1e-10)


def test_unknown_sigmas_are_those_of_their_channels() -> None:
    target = posterior(RECORD, None)
    sigmas = np.array([[0.3, 0.05, 0.11, 0.7], [0.02, 0.6, 0.4, 0.09]])
    theta = np.hstack([points(2), sigmas])
    terms = scipy.stats.norm(target.likelihood.signals(theta), sigmas[:, None]).logpdf(RECORD.y)
    expected = terms.sum(axis=(1, 2)) - LOG_VOLUME - 4 * np.log(0.99)
    assert target.density(theta) == pytest.approx(expected, rel=1e-10)
    observation = target.likelihood.only_observation
    residuals = RECORD.y - target.likelihood.signals(theta)
    assert observation.noise.pointwise(residuals, sigmas) == pytest.approx(terms, rel=1e-10)


@run_cases("coordinates, logs", [("linear", 0), ("log", 9), ("mixed", 7)])
def test_the_density_over_coordinates_carries_the_jacobian(coordinates: str, logs: int) -> None:
    zero = {name: Uniform(0.0, 2 * NOMINAL[name]) for name in ("c_m", "k_T")}
    priors, choice = (zero if coordinates == "mixed" else {}), coordinates == "linear"
    target = posterior(RECORD, SIGMA, priors=priors, logs=False if choice else None)
    assert sum(target.coordinates.logs) == logs
    theta = points(4)
    z = target.coordinates.from_physical(theta)
    h = 1e-6 * np.abs(z)
    slopes = target.coordinates.to_physical(z + h) - target.coordinates.to_physical(z - h)
    jacobian = np.log(slopes / (2 * h)).sum(axis=1)
    assert target(z) == pytest.approx(target.density(theta) + jacobian, rel=0, abs=1e-4)


def test_the_density_outside_the_prior_is_minus_infinity() -> None:
    target, theta = posterior(RECORD, SIGMA), points(6)
    theta[1, 3] *= 5
    theta[4, 0] = np.nan
    theta[5, 2] = -1.0
    with np.errstate(invalid="ignore"):
        density = target.density(theta)
    assert list(np.isfinite(density)) == [True, False, True, True, False, False]
    assert np.all(density[[1, 4, 5]] == -np.inf)


def test_a_simulation_that_fails_is_counted_and_has_no_density() -> None:
    target = posterior(RECORD, SIGMA, priors={"l_m": Uniform(0.0, 1.0)}, logs=False)
    theta = points(5)
    theta[2, ORDER.index("l_m")] = 1e-320
    density, failures = target.evaluate(theta)
    assert failures == 1
    assert density[2] == -np.inf
    assert np.isfinite(np.delete(density, 2)).all()


def test_fixed_parameters_are_held_by_their_names() -> None:
    target, values = posterior(RECORD, SIGMA, free=("k_T", "c_m")), {"k_T": 0.1, "c_m": 3e-4}
    theta = np.array([[*values.values()]])
    assert dict(zip(ORDER, target.space.full(theta)[0], strict=True)) == {**NOMINAL, **values}
    nine = posterior(RECORD, SIGMA).likelihood(vector({**NOMINAL, **values})[None])
    assert target.likelihood(theta)[0] == nine[0]


def test_a_maximum_at_the_end_of_a_prior_that_may_be_negative_is_noticed() -> None:
    """On the scale of the prior: ratios of values say nothing of an end at zero."""
    target = two_experiments.rich_job().problem.posterior
    values, sds = dict(target.space.start), np.ones(len(target.space.free))
    before = mode_search._at_bound(target, target.space.vector(values), sds)
    values |= {"lag_twist_late": 1e-7, "offset_v_late": -0.9999, "t_0_late": 0.0}
    at_bound = mode_search._at_bound(target, target.space.vector(values), sds)
    assert "lag_twist_late" not in before
    assert {"lag_twist_late", "offset_v_late"} <= set(at_bound)
    assert "t_0_late" not in at_bound


# --- editing ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stepped() -> Posterior:
    """Return one of a rig that is stepped, whose experiment has a twin that is held out."""
    case = CASES["falling"]
    rig = stepped_friction.stepped(case)
    values = dict(zip(rig.model.parameters, stepped_friction.parameters(case)[0], strict=True))
    priors = {name: Uniform(0.3 * values[name], 3 * values[name]) for name in ("k_e", "k_s", "j_1")}
    plain = posterior_of(rig, [0.1] * 5, priors, values)
    target = step_error.with_steps(plain, {"": (2, 3)})
    twin = replace(target.likelihood.only_observation, label="twin")
    return replace(target, likelihood=replace(target.likelihood, held_out=(twin,)))


def at(target: Posterior, **values: float) -> np.ndarray:
    return target.space.vector({**target.space.start, **values})[None]


def test_an_edit_of_nothing_changes_nothing(stepped: Posterior) -> None:
    same = stepped.edit()
    assert same.space is stepped.space
    assert same.density(at(stepped)) == stepped.density(at(stepped))
    assert step_error.chosen_steps(same) == {"": (2, 3), "twin": (2, 3)}


def test_a_parameter_that_was_fixed_is_freed_behind_those_of_the_rig(stepped: Posterior) -> None:
    space = stepped.space
    name = next(name for name in space.model if space.fixed.get(name, 0.0) > 0)
    value = space.fixed[name]
    prior = Uniform(0.5 * value, 2 * value)
    new = Unknown(symbol=PARAMETERS[name], role="rig", prior=prior, start=value)
    freed = stepped.edit(free=[new])
    rig = len(space.columns("rig", "quantity"))
    assert freed.space.free == (*space.free[:rig], name, *space.free[rig:])
    assert freed.likelihood(at(freed)) == stepped.likelihood(at(stepped))
    assert freed.likelihood(at(freed, **{name: 1.1 * value})) != stepped.likelihood(at(stepped))
    assert [one.label for one in freed.likelihood.held_out] == ["twin"]


def test_another_record_is_explained_instead(stepped: Posterior) -> None:
    theta = at(stepped)
    signals = stepped.likelihood.signals(theta)
    assert stepped.edit(records=[*signals]).likelihood.mean_square(theta) < 1e-24
    assert stepped.likelihood.mean_square(theta) > 0.1
    with pytest.raises(ValueError, match="longer"):
        stepped.edit(records=[*signals, *signals])
    with pytest.raises(ValueError, match="shape"):
        stepped.likelihood.only_observation.response.with_record(signals[0][:-1])


def test_another_rig_with_other_sensors_takes_the_same_steps(stepped: Posterior) -> None:
    """With damping that is none and a gain of one the likelihood is the same number."""
    channel = stepped.likelihood.only_observation.experiment.names[0]
    new = [
        Unknown(
            symbol=replace(PARAMETERS["c_s"], name=name),
            role="sensor",
            prior=Uniform(0.0, 2.0),
            start=start,
        )
        for name, start in (("c_s", 0.0), ("gain", 1.0))
    ]
    sensing = ObservationModel(gains={channel: "gain"})
    damped = stepped.edit(
        free=new, convert=lambda one: one.for_rig(with_named(one.response.model, ["c_s"]), sensing)
    )
    assert step_error.chosen_steps(damped) == step_error.chosen_steps(stepped)
    assert damped.likelihood(at(damped)) == stepped.likelihood(at(stepped))
    assert damped.likelihood(at(damped, c_s=1e-3)) != stepped.likelihood(at(stepped))
    assert damped.likelihood(at(damped, gain=1.1)) != stepped.likelihood(at(stepped))
