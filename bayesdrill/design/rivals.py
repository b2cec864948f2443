"""Design an experiment that distinguishes a model from a rival, fitted to the same record.

The rival's signals are linearised in the rival's unknowns, near its fit to the expected record.
The difference between the signals of both models then acts as the slope of an additional unknown,
whose value is one.  The information on this unknown is the sum of squared whitened differences
that the rival cannot fit (T-optimality; Atkinson and Fedorov 1975).  The search maximises it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics import seeds
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import Reporter
from bayesdrill.design.knowledge import PresentKnowledge, prior_knowledge
from bayesdrill.design.limited_motion import LimitCheck
from bayesdrill.design.responses import ComingExperiment, TargetCovariance
from bayesdrill.design.study import (
    DESIGNED,
    RECORDED,
    DesignRequest,
    ExperimentDesign,
    describe_expected,
    search_levels,
)
from bayesdrill.design.waveforms import FAMILIES, FREE
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.posterior import Posterior, Problem
from bayesdrill.inference.unknowns import SIMULATOR_ROLES
from bayesdrill.sampling.gauss_newton import gauss_newton

FIRST_STARTS = 4  # number of starts of the first fit to each draw; later fits start at its result
FIT_STEPS = 25  # number of Gauss-Newton steps in each fit
ROUNDS = 2  # number of rounds (fit, then search), as the rival's best fit depends on the waveform
LEAST_INFORMATION = 1e-6  # lower limit, so that its logarithm is finite for equal signals
LEAST_LOG_ODDS = 1.0  # a design with lower expected log odds does not distinguish the models


@dataclass(frozen=True, kw_only=True)
class ComparedExperiment(ComingExperiment):
    """Two models describe the same experiment, at the unknowns `theta (W, D + E)` of both.

    The slopes are those of `rival`, followed by the difference between the signals of both models.
    The source is that of the first model.
    """

    rival: ComingExperiment

    def _split(self, theta: Array) -> tuple[Array, Array]:
        space = self.observation.space
        assert space is not None
        return theta[..., : len(space.free)], theta[..., len(space.free) :]

    def slopes(self, theta: Array, levels: Array) -> Array:
        """Return slopes `(W, m + 1, T, K)`, the difference last."""
        ours, theirs = self._split(theta)
        difference = self.motion(ours, levels)[0] - self.rival.motion(theirs, levels)[0]
        return np.concatenate([self.rival.slopes(theirs, levels), difference[:, None]], axis=1)

    def whitened(self, slopes: Array, theta: Array) -> Array:
        """Return slopes `(n, T, K)` whitened by the noise of the rival, reshaped to `(n, T K)`."""
        return self.rival.whitened(slopes, self._split(theta)[1])


def design_against(
    problem: Problem,
    rival: Problem,
    request: DesignRequest,
    knowledge: PresentKnowledge,
    report: Reporter,
) -> ExperimentDesign:
    """Design the experiment whose record gives the largest odds against a fitted rival.

    `problem` is taken as the truth.  Raises `InputError` if no waveform distinguishes the models.
    """
    _check_comparable(problem, rival, request)
    ours, theirs = problem.observations[0], rival.observations[0]
    coming = ComingExperiment.from_observation(ours, request.source)
    other = ComingExperiment.from_observation(theirs, request.source)
    compared = ComparedExperiment(observation=coming.observation, source=coming.source, rival=other)
    check = LimitCheck.between_samples(coming, request.limits, knowledge.checked)
    rng = seeds.stream(request.seed, "design", 1)
    start = prior_knowledge(rival, FIRST_STARTS, 0, request.seed)
    precision = np.diag(np.append(start.precision.diagonal(), LEAST_INFORMATION))
    precision = np.tile(precision, (len(knowledge.draws), 1, 1))
    slopes = np.zeros_like(precision[:, :1])
    slopes[..., -1] = 1.0
    targets = TargetCovariance(slopes=slopes, precision=precision)
    levels = next(FAMILIES["prbs"](request.source, rng))
    fits, designed = [start.draws] * len(knowledge.draws), []
    for number in range(ROUNDS):

        def progress(fraction: float, number: int = number) -> None:
            report.update(0.9 * (number + fraction) / ROUNDS, "search of the levels")

        compared_at = coming.posterior(levels), other.posterior(levels)
        fits = [fit[None] for fit in fitted_rivals(*compared_at, knowledge.draws, fits)[1]]
        theta = np.hstack([knowledge.draws, np.concatenate(fits)])
        smooth = problem.model.smooth and rival.model.smooth
        waveforms, levels = search_levels(
            compared, knowledge, targets, check, request, rng, progress, smooth=smooth, theta=theta
        )
        designed.append(levels)

    def log_odds(ours: Posterior, theirs: Posterior) -> float:
        information = fitted_rivals(ours, theirs, knowledge.draws, fits)[0]
        return float(np.exp(np.log(np.maximum(information, LEAST_INFORMATION)).mean()) / 2.0)

    def expected(levels: Array) -> float:
        return log_odds(coming.posterior(levels), other.posterior(levels))

    odds = {name: expected(u) for name, u in waveforms.items()}
    if request.family == FREE:
        # If the linearisation of the rival fails, a usual waveform may be best.
        designed.append(waveforms[max(odds, key=lambda name: odds[name])])
    levels = max(designed, key=expected)
    odds[DESIGNED] = expected(levels)
    if _shapes(problem) == _shapes(rival):
        odds[RECORDED] = log_odds(problem.posterior, rival.posterior)
    if odds[DESIGNED] < LEAST_LOG_ODDS:
        message = (
            f"the best waveform within these limits has expected log odds of {odds[DESIGNED]:.2g}"
        )
        way_out = "measure longer, with less noise, or with further channels"
        raise InputError.at(
            "--tell", f"{message}, so that nothing distinguishes the two; {way_out}"
        )
    report.update(1.0, "")
    return describe_expected(coming, request, levels[None], knowledge, check, odds=odds)


def _check_comparable(problem: Problem, rival: Problem, request: DesignRequest) -> None:
    """Raise `InputError` unless both models have the source's input and the same channels."""
    request.source.check()
    if request.experiments > 1:
        raise InputError.at(
            "--experiments", "models are distinguished by one experiment; give only --tell"
        )
    ours, theirs = problem.observations[0], rival.observations[0]
    if ours.experiment.names != theirs.experiment.names:
        message = f"the channels {', '.join(theirs.experiment.names)} are not those of the config"
        raise InputError.at("--tell", f"{message}, {', '.join(ours.experiment.names)}")
    if request.source.input not in theirs.response.model.inputs:
        raise InputError.at("--tell", f"its rig has no input {request.source.input}")


def fitted_rivals(
    ours: Posterior, theirs: Posterior, draws: Array, starts: Sequence[Array]
) -> tuple[Array, Array]:
    """Fit a rival to the signals at each of `draws (W, D)`, starting at its `starts (n, E)`.

    Returns the sums of squared whitened residuals `(W,)`, and the fitted unknowns `(W, E)`.
    """
    squares, fits = [], []
    for draw, begin in zip(draws, starts, strict=True):
        signals = ours.likelihood.all_signals(draw[None])
        seen = [each.experiment.is_measured for each in theirs.likelihood.observations]
        pairs = zip(signals, seen, strict=True)
        expected = theirs.edit(records=[np.where(s, x[0], np.nan) for x, s in pairs])
        coordinates = expected.coordinates
        surface = LogDensity(expected, physical=True)
        climbed = gauss_newton(surface, coordinates.from_physical(begin), FIT_STEPS)
        best = coordinates.to_physical(climbed.u[[np.argmax(climbed.value)]])[0]
        # The noise unknowns stay fixed, since signals without noise would make them zero.
        noise = len(expected.space.columns(*SIMULATOR_ROLES))
        best[noise:] = begin[0, noise:]
        residuals = expected.likelihood.whitened_residuals(best)
        squares.append(residuals @ residuals)
        fits.append(best)
    return np.array(squares), np.array(fits)


def _shapes(problem: Problem) -> list[tuple[int, ...]]:
    return [observation.experiment.y.shape for observation in problem.observations]
