"""Superposed pulses agree with the simulator, and slopes of a criterion with differences."""

from functools import cache
from pathlib import Path

import numpy as np
from support.array_cases import late_angle, two

import bayesdrill as bd
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.design.limited_motion import LimitCheck, LimitPenalty
from bayesdrill.design.limits import parse_limits
from bayesdrill.design.responses import ComingExperiment, SuperposedPulses, TargetCovariance
from bayesdrill.design.source import SourceLimits
from bayesdrill.design.targets import gradients, parse_targets

SOURCE = SourceLimits(input="v", low=0.0, high=12.0, hold=0.5, duration=4.0, rate=40.0)
SUPPLY = {"value": 5.0, "unit": "V", "offset": {"prior": "normal", "mean": 0.0, "sd": 0.1}}
LEVELS = np.array([12.0, 3.0, 0.0, 11.0, 7.0, 12.0, 1.0, 5.0])


def evaluation(case: bd.Case, names: tuple[str, ...] = ("k_s", "t_f")) -> SuperposedPulses:
    problem = case.job.problem
    space = problem.posterior.space
    draws = space.draw(3, np.random.default_rng(1))
    coming = ComingExperiment.from_observation(problem.observations[0], SOURCE)
    slopes = gradients(parse_targets(problem, names, draws), space, draws)
    precision = np.diag(SensitivityStudy(problem.posterior.likelihood).prior_spreads ** -2.0)
    return SuperposedPulses(coming, draws, TargetCovariance(slopes=slopes, precision=precision))


@cache
def small() -> SuperposedPulses:
    return evaluation(two())


def test_superposed_pulses_have_the_information_of_the_simulated_waveform() -> None:
    """They agree for a late channel with AR(1) noise, too, and with unknown offsets of both columns."""
    late = two(channels={"theta_2": late_angle()}, inputs={"v": SUPPLY})
    for each in (small(), evaluation(late, ("k_s",))):
        posterior = each.coming.posterior(LEVELS)
        study = SensitivityStudy(posterior.likelihood)
        draws = posterior.space.draw(3, np.random.default_rng(1))
        for theta, information in zip(draws, each.information(LEVELS), strict=True):
            rows_there = study.with_nuisances(theta)
            expected = rows_there.T @ rows_there
            scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
            np.testing.assert_allclose(information / scale, expected / scale, atol=1e-8)


def test_slopes_of_the_criterion_and_of_penalties_are_those_of_differences() -> None:
    each, step = small(), 1e-5
    value, slope = each.value_and_slope(LEVELS)
    assert np.isclose(value, each.targets.criterion(each.information(LEVELS))[0])
    posterior, model = two().job.problem.posterior, two().job.problem.model
    texts = "w_2=0:20", "theta_1 - theta_2=-2:2", "integral(v*i)=:20", "k_s*w_1**2=:5", "v*i=:9"
    limits = parse_limits(texts, model.states, ("v",), posterior.space.model)
    draws = posterior.space.draw(3, np.random.default_rng(1))
    check = LimitCheck.between_samples(each.coming, limits, draws)
    penalty = LimitPenalty(check, draws)
    assert check.coming.source.rate > each.coming.source.rate
    assert check.broken(LEVELS).all()
    for function, tolerance in ((each.value_and_slope, 1e-6), (penalty, 1e-6)):
        slope = function(LEVELS)[1]
        moves = step * np.eye(len(LEVELS))
        pairs = [(function(LEVELS + m)[0], function(LEVELS - m)[0]) for m in moves]
        expected = np.array([(up - down) / (2 * step) for up, down in pairs])
        np.testing.assert_allclose(slope, expected, atol=tolerance * np.abs(expected).max())


def test_a_target_may_be_a_parameter_a_product_or_a_formula_of_the_config() -> None:
    case = bd.load(Path("configs/nominal_step.yaml"))
    problem, space = case.job.problem, case.job.problem.posterior.space
    theta = space.vector(space.start)[None]
    names = ("k_s", "k_s/(j_1*r_m**2)", "sqrt(k_s/j_1)")
    slopes = gradients(parse_targets(problem, names, theta), space, theta)[0]
    expected = np.zeros((3, 9))
    for row, powers in enumerate(
        ({"k_s": 1}, {"k_s": 1, "j_1": -1, "r_m": -2}, {"k_s": 0.5, "j_1": -0.5})
    ):
        for name, power in powers.items():
            expected[row, problem.names.index(name)] = power
    np.testing.assert_allclose(slopes, expected, atol=1e-14)
