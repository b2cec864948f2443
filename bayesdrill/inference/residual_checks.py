"""Residuals of the best fit, and whether noise alone explains them.

All statements on the unknowns count on the model and on white noise of the given size.  Both show
in the residuals: their size over sigma, single samples far off, and whether one sample has
something to do with the next, with those long before it, or with an input (Ljung, System
Identification, 2nd ed., section 16.6).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array, Indices
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Likelihood
from bayesdrill.record.experiment import Channel

FALSE_ALARM = 0.01  # of records of the model, with its noise, would give any finding at most
# Rms over sigma, from which on nothing that counts on the noise is believed.
MAX_BELIEVABLE_RMS = 1.5
# Correlation of neighbours, from which on sds are too small by a factor of two.
MAX_BELIEVABLE_CORRELATION = 0.6
TESTS_PER_CHANNEL = 5  # at each channel: size and correlation both ways, and the farthest sample
N_LAGS = 25  # samples of a channel, at which correlations are shown
MAX_MEMORY_LAG = 100  # lags over which residuals and inputs may remember
BAND_PROBABILITY = 0.99  # of a correlation where there is none: inside its band
MAX_STEPS_PER_SAMPLE = 4  # times as many steps as samples: a record with longer gaps has no step


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualLimits:
    """What noise leaves in one channel of all: rms over sigma, correlation, farthest sample."""

    least: float
    most: float
    correlation: float
    farthest: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualSummary:
    """Residuals of one channel: rms over sigma, correlation of neighbours, farthest sample.

    The sample that is farthest off, in sigmas, is at `time` [s].  `share`: of the channel's spread
    about its mean; NaN where it has none.  `simulated`, `ahead`: the share that the simulation
    without any sample leaves, and the one that predictions one step ahead leave.  `experiment`: its
    label among several.
    """

    channel: str
    rms: float
    share: float
    correlation: float
    farthest: float
    time: float
    limits: ResidualLimits
    experiment: str = ""
    simulated: float = math.nan
    ahead: float = math.nan

    @property
    def name(self) -> str:
        """Return the channel's name for sentences."""
        return f"{self.channel} in {self.experiment}" if self.experiment else self.channel

    @property
    def large(self) -> bool:
        """Whether the residuals are larger than noise."""
        return self.rms > self.limits.most

    @property
    def small(self) -> bool:
        """Whether the residuals are smaller than noise."""
        return self.rms < self.limits.least

    @property
    def correlated(self) -> bool:
        """Whether neighbours are correlated."""
        return abs(self.correlation) > self.limits.correlation

    @property
    def like_noise(self) -> bool:
        """Whether nothing speaks against the model: small ones do not, sds are only too large."""
        return not (self.large or self.correlated or self.far)

    @property
    def unbelievable(self) -> bool:
        """Whether no statement on the unknowns must be believed."""
        too_alike = self.correlated and self.correlation > MAX_BELIEVABLE_CORRELATION
        return self.far_too_large or too_alike

    @property
    def far_too_large(self) -> bool:
        """Whether the residuals are so large that sds mean nothing."""
        return self.large and self.rms > MAX_BELIEVABLE_RMS

    @property
    def far(self) -> bool:
        """Whether a few samples are far off by themselves: not all, which is reported already."""
        return self.farthest > self.limits.farthest and not self.large


def like_noise(summaries: Sequence[ResidualSummary]) -> bool:
    """Whether no channel has residuals beyond its noise."""
    return all(summary.like_noise for summary in summaries)


def residual_summaries(likelihood: Likelihood, theta: Array) -> tuple[ResidualSummary, ...]:
    """Return the summaries of all channels at the unknowns `theta (D,)`.

    An unknown sigma fits the size, unless its prior keeps it off.
    """
    full, observations = likelihood.space.full(theta[None]), likelihood.observations
    channels = sum(len(observation.experiment.channels) for observation in observations)
    summaries = (_channel_summaries(each, full, theta[None], channels) for each in observations)
    return tuple(chain.from_iterable(summaries))


def _channel_summaries(
    observation: Observation, full: Array, theta: Array, channels: int
) -> Iterator[ResidualSummary]:
    """`channels`: how many there are in all observations."""
    experiment = observation.experiment
    prediction_errors = (experiment.y - observation.predict(full, theta))[0]
    samples = observation.residuals(full).samples
    whitened = observation.whiten(samples, theta)[0]
    innovations = observation.innovations(samples, theta)[0]
    for k, measured in enumerate(experiment.seen.T):
        residuals, n = whitened[measured, k], int(measured.sum())
        squares = float(residuals @ residuals)
        spread = float(experiment.y[measured, k].std())
        worst = int(np.abs(residuals).argmax())
        shares = [
            math.sqrt(np.mean(errors[measured, k] ** 2)) / spread if spread > 0 else math.nan
            for errors in (prediction_errors, samples[0], innovations)
        ]
        yield ResidualSummary(
            channel=experiment.names[k],
            rms=math.sqrt(squares / n),
            share=shares[0],
            correlation=float(residuals[1:] @ residuals[:-1]) / squares if squares > 0 else 0.0,
            farthest=float(abs(residuals[worst])),
            time=float(experiment.t[measured][worst]),
            limits=limits(n, channels, theta.shape[1]),
            experiment=observation.label,
            simulated=shares[1],
            ahead=shares[2],
        )


def limits(samples: int, channels: int, unknowns: int) -> ResidualLimits:
    """Return what noise leaves in one channel, at most.

    A fit takes something away from what noise leaves, and never adds to it: the limits above are
    those without a fit, the one below allows for as many unknowns as there are.
    """
    tail = FALSE_ALARM / (TESTS_PER_CHANNEL * channels)
    return ResidualLimits(
        least=math.sqrt(scipy.special.chdtri(max(samples - unknowns, 1), 1 - tail) / samples),
        most=math.sqrt(scipy.special.chdtri(samples, tail) / samples),
        correlation=-float(scipy.special.ndtri(tail)) / math.sqrt(samples),
        farthest=-float(scipy.special.ndtri(0.5 * tail / samples)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualCorrelation:
    """Correlation of a channel's whitened residuals with a measured `input`, or themselves.

    `lags (L,)` [samples] are positive where the input comes first; `input` is empty for
    autocorrelations.  `values (L,)`, and their `sds (L,)` where nothing is related.  `step` [s]:
    between samples; `experiment`: its label among several.
    """

    channel: Channel
    input: str
    lags: Indices
    values: Array
    sds: Array
    step: float
    experiment: str = ""

    @property
    def band(self) -> Array:
        """Return half the width of the band in which most values lie, each by itself `(L,)`."""
        return np.asarray(float(scipy.special.ndtri(0.5 + 0.5 * BAND_PROBABILITY)) * self.sds)


def correlations(likelihood: Likelihood, theta: Array) -> tuple[ResidualCorrelation, ...]:
    """Return correlations of each channel with itself, then with each measured input.

    They are at the unknowns `theta (D,)`; pairs of which a sample is missing are left out.  Of an
    input, both are filtered by the AR(1) of the residuals first, so that these are nearly white
    (prewhitening, Box and Jenkins); sds count on what both still remember (Ljung, section 16.6).
    """
    full = likelihood.space.full(theta[None])
    pairs = (_correlations(each, full, theta[None]) for each in likelihood.observations)
    return tuple(chain.from_iterable(pairs))


def input_sentences(correlations: Sequence[ResidualCorrelation]) -> tuple[str, ...]:
    """Say which residuals follow an input beyond chance, all looks at all inputs taken together."""
    of_inputs = [correlation for correlation in correlations if correlation.input]
    looks = sum(len(correlation.lags) for correlation in of_inputs)
    sentences = []
    for correlation in of_inputs:
        z_scores = np.abs(correlation.values) / correlation.sds
        k = int(z_scores.argmax())
        limit = -float(scipy.special.ndtri(0.5 * FALSE_ALARM / looks))
        lag, sd = int(correlation.lags[k]), correlation.sds[k]
        if z_scores[k] > limit:
            where = f" in {correlation.experiment}" if correlation.experiment else ""
            sentences.append(
                f"the residuals of {correlation.channel.name}{where} follow the input "
                f"{correlation.input}, {lag:+d} samples ({lag * correlation.step:.3g} s) after it "
                f"(correlation {correlation.values[k]:.2g}, chance gives at most {limit * sd:.2g})"
                + (": the input answers to the rig, or times are off" if lag < 0 else "")
            )
    return tuple(sentences)


def _correlations(
    observation: Observation, full: Array, theta: Array
) -> Iterator[ResidualCorrelation]:
    experiment = observation.experiment
    whitened = observation.whiten(observation.residuals(full).samples, theta)[0]
    inputs = {name: u for name, u in experiment.series.items() if np.ptp(u) > 0}
    for k, measured in enumerate(experiment.seen.T):
        t = experiment.t[measured]
        if len(t) < 4:
            continue
        step = float(np.median(np.diff(t)))
        indices = np.round((t - t[0]) / step).astype(int)
        if (np.diff(indices) < 1).any() or indices[-1] > MAX_STEPS_PER_SAMPLE * len(t):
            indices = np.arange(len(t))  # in the order of the samples
        residuals = np.full(indices[-1] + 1, np.nan)
        residuals[indices] = whitened[measured, k]
        lags = np.arange(min(MAX_MEMORY_LAG, len(t) // 4) + 1)
        memory, counts = _correlated(residuals, residuals, lags)
        last, sds = min(N_LAGS, int(lags[-1])), 1.0 / np.sqrt(counts)
        after = slice(1, last + 1)
        build = partial(
            ResidualCorrelation,
            channel=experiment.channels[k],
            step=step,
            experiment=observation.label,
        )
        yield build(input="", lags=lags[after], values=memory[after], sds=sds[after])
        two_sided_lags = np.arange(-last, last + 1)
        rho = memory[1]
        prewhitened = residuals[1:] - rho * residuals[:-1]
        memory, _ = _correlated(prewhitened, prewhitened, lags)
        significant = np.where(np.abs(memory) > 2.0 * sds, memory, 0.0)  # the others are chance
        for name, series in inputs.items():
            values = np.full(len(residuals), np.nan)
            values[indices] = series[measured] - series[measured].mean()
            values = values[1:] - rho * values[:-1]
            input_memory, _ = _correlated(values, values, lags)
            cross, counts = _correlated(prewhitened, values, two_sided_lags)
            joint = max(1.0, 1.0 + 2.0 * float(significant[1:] @ input_memory[1:]))
            yield build(input=name, lags=two_sided_lags, values=cross, sds=np.sqrt(joint / counts))


def _correlated(late: Array, early: Array, lags: Indices) -> tuple[Array, Array]:
    """Of `late (n,)` with what `early (n,)` was so many samples before, and of how many pairs."""
    there = [np.isfinite(x).astype(float) for x in (late, early)]
    x, y = (np.nan_to_num(x) for x in (late, early))
    n, sums, counts = len(x), np.empty(len(lags)), np.empty(len(lags))
    for row, lag in enumerate(lags):
        after, before = slice(max(lag, 0), n + min(lag, 0)), slice(max(-lag, 0), n - max(lag, 0))
        sums[row], counts[row] = x[after] @ y[before], there[0][after] @ there[1][before]
    counts = np.maximum(counts, 1.0)
    size = math.sqrt(float(x @ x) * float(y @ y) / max(there[0].sum() * there[1].sum(), 1.0))
    return (sums / counts / size if size > 0 else np.zeros(len(lags))), counts
