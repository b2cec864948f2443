"""Test whether noise alone explains the residuals of the best fit.

All statements on the unknowns assume the model and white noise of the given size.  Residuals show
whether both hold: by their size / sigma, by outliers, by their autocorrelation, and by their
correlation with an input (Ljung, System Identification, 2nd ed., section 16.6).
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
from bayesdrill.basics.findings import Finding
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Likelihood
from bayesdrill.record.experiment import Channel

FALSE_ALARM = 0.01  # probability of a finding if the model and its noise are right
# Above this rms / sigma, statements that assume the noise are not believed.
MAX_BELIEVABLE_RMS = 1.5
# If neighbouring residuals are correlated this much, sds are too small by a factor of two.
MAX_BELIEVABLE_CORRELATION = 0.6
TESTS_PER_CHANNEL = 5  # size and correlation in both directions, and the largest residual
N_LAGS = 25  # largest lag [samples] at which correlations are shown
MAX_MEMORY_LAG = 100  # largest lag [samples] of autocorrelations that increase sds
BAND_PROBABILITY = 0.99  # probability that an uncorrelated value lies inside its band
MAX_STEPS_PER_SAMPLE = 4  # a record with more steps of its time grid per sample has no regular step


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualLimits:
    """Noise alone keeps rms / sigma from `least` to `most`; others limit correlation and outliers."""

    least: float
    most: float
    correlation: float
    farthest: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualSummary:
    """A summary describes the residuals of one channel.

    `rms` is relative to sigma, and `correlation` is that of neighbouring samples.  The largest
    residual, `farthest` in sigmas, is at `time` [s].  `share` is rms error / sd of the channel;
    `simulated` is this ratio for the simulation alone, and `ahead` for predictions one step ahead.
    The three ratios are NaN if the channel is constant.  `experiment` is a label or empty.
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
        """Return whether the residuals are larger than noise."""
        return self.rms > self.limits.most

    @property
    def small(self) -> bool:
        """Return whether the residuals are smaller than noise."""
        return self.rms < self.limits.least

    @property
    def correlated(self) -> bool:
        """Return whether neighbours are correlated."""
        return abs(self.correlation) > self.limits.correlation

    @property
    def like_noise(self) -> bool:
        """Return whether nothing contradicts the model; small residuals are allowed."""
        return not (self.large or self.correlated or self.far)

    @property
    def unbelievable(self) -> bool:
        """Return whether residuals are so large or correlated that no sd can be trusted."""
        too_alike = self.correlated and self.correlation > MAX_BELIEVABLE_CORRELATION
        return self.far_too_large or too_alike

    @property
    def far_too_large(self) -> bool:
        """Return whether the residuals are so large that sds are meaningless."""
        return self.large and self.rms > MAX_BELIEVABLE_RMS

    @property
    def far(self) -> bool:
        """Return whether there are outliers although the rms is not too large."""
        return self.farthest > self.limits.farthest and not self.large


def like_noise(summaries: Sequence[ResidualSummary]) -> bool:
    """Return whether no channel has residuals beyond its noise."""
    return all(summary.like_noise for summary in summaries)


def residual_summaries(likelihood: Likelihood, theta: Array) -> tuple[ResidualSummary, ...]:
    """Return the summaries of all channels at the unknowns `theta (D,)`.

    If sigma is unknown, rms / sigma is near one unless the prior of sigma prevents it.
    """
    full, observations = likelihood.space.full(theta[None]), likelihood.observations
    n_channels = sum(len(observation.experiment.channels) for observation in observations)
    summaries = []
    for observation in observations:
        experiment = observation.experiment
        prediction_errors = (experiment.y - observation.predict(full, theta[None]))[0]
        samples = observation.residuals(full).samples
        whitened = observation.whiten(samples, theta[None])[0]
        errors = prediction_errors, samples[0], observation.innovations(samples, theta[None])[0]
        for k, measured in enumerate(experiment.is_measured.T):
            residuals, n = whitened[measured, k], int(measured.sum())
            squares = float(residuals @ residuals)
            spread = float(experiment.y[measured, k].std())
            worst = int(np.abs(residuals).argmax())
            sizes = [math.sqrt(np.mean(error[measured, k] ** 2)) for error in errors]
            ratios = [size / spread if spread > 0 else math.nan for size in sizes]
            summary = ResidualSummary(
                channel=experiment.names[k],
                rms=math.sqrt(squares / n),
                share=ratios[0],
                correlation=float(residuals[1:] @ residuals[:-1]) / squares if squares > 0 else 0.0,
                farthest=float(abs(residuals[worst])),
                time=float(experiment.t[measured][worst]),
                limits=limits(n, n_channels, len(theta)),
                experiment=observation.label,
                simulated=ratios[1],
                ahead=ratios[2],
            )
            summaries.append(summary)
    return tuple(summaries)


def limits(samples: int, channels: int, unknowns: int) -> ResidualLimits:
    """Return the limits within which noise alone keeps the residuals of one channel.

    Upper limits hold for residuals at the true values, since a fit only reduces them.  The lower
    limit allows for the number of fitted unknowns.
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
    """The whitened residuals of a channel are correlated with a measured `input`, or themselves.

    An autocorrelation has an empty `input`.  A positive lag in `lags (L,)` [samples] means that the
    input comes first.  `values (L,)` have the standard deviations `sds (L,)` if there is no
    correlation. Samples are `step` [s] apart.  `experiment` is a label, empty if there is only one.
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
        """Return half the width `(L,)` of the band that holds each value with `BAND_PROBABILITY`."""
        return np.asarray(float(scipy.special.ndtri(0.5 + 0.5 * BAND_PROBABILITY)) * self.sds)


def correlations(likelihood: Likelihood, theta: Array) -> tuple[ResidualCorrelation, ...]:
    """Return correlations of each channel with itself, then with each measured input.

    Residuals are those at `theta (D,)`, and pairs with a missing sample are left out.  Before their
    correlation, input and residuals are filtered by the AR(1) of the residuals (prewhitening, Box and
    Jenkins).  Standard deviations allow for the autocorrelation that remains (Ljung, section 16.6).
    """
    full = likelihood.space.full(theta[None])
    pairs = (_correlations(each, full, theta[None]) for each in likelihood.observations)
    return tuple(chain.from_iterable(pairs))


def followed_inputs(correlations: Sequence[ResidualCorrelation]) -> tuple[Finding, ...]:
    """Return findings on residuals that follow an input more than by chance at any of the lags."""
    of_inputs = [correlation for correlation in correlations if correlation.input]
    looks = sum(len(correlation.lags) for correlation in of_inputs)
    findings = []
    for correlation in of_inputs:
        z_scores = np.abs(correlation.values) / correlation.sds
        k = int(z_scores.argmax())
        limit = -float(scipy.special.ndtri(0.5 * FALSE_ALARM / looks))
        if z_scores[k] > limit:
            where = f" in {correlation.experiment}" if correlation.experiment else ""
            lag, sd = int(correlation.lags[k]), float(correlation.sds[k])
            names = {"channel": correlation.channel.name + where, "input": correlation.input}
            numbers = {"lag": lag, "seconds": lag * correlation.step}
            numbers |= {"correlation": float(correlation.values[k]), "chance": limit * sd}
            kind = "residuals before an input" if lag < 0 else "residuals after an input"
            findings.append(Finding(kind, names, numbers))
    return tuple(findings)


def _correlations(
    observation: Observation, full: Array, theta: Array
) -> Iterator[ResidualCorrelation]:
    experiment = observation.experiment
    whitened = observation.whiten(observation.residuals(full).samples, theta)[0]
    inputs = {name: u for name, u in experiment.series.items() if np.ptp(u) > 0}
    for k, measured in enumerate(experiment.is_measured.T):
        t = experiment.t[measured]
        if len(t) < 4:
            continue
        step = float(np.median(np.diff(t)))
        indices = np.round((t - t[0]) / step).astype(int)
        if (np.diff(indices) < 1).any() or indices[-1] > MAX_STEPS_PER_SAMPLE * len(t):
            indices = np.arange(len(t))  # without a regular step, lags count samples
        residuals = np.full(indices[-1] + 1, np.nan)
        residuals[indices] = whitened[measured, k]
        lags = np.arange(min(MAX_MEMORY_LAG, len(t) // 4) + 1)
        memory, counts = _correlated(residuals, residuals, lags)
        last, sds = min(N_LAGS, int(lags[-1])), 1.0 / np.sqrt(counts)
        after = slice(1, last + 1)
        of_record = partial(ResidualCorrelation, experiment=observation.label, step=step)
        build = partial(of_record, channel=experiment.channels[k])
        yield build(input="", lags=lags[after], values=memory[after], sds=sds[after])
        two_sided_lags = np.arange(-last, last + 1)
        rho = memory[1]
        prewhitened = residuals[1:] - rho * residuals[:-1]
        memory, _ = _correlated(prewhitened, prewhitened, lags)
        significant = np.where(np.abs(memory) > 2.0 * sds, memory, 0.0)  # not by chance
        for name, series in inputs.items():
            values = np.full(len(residuals), np.nan)
            values[indices] = series[measured] - series[measured].mean()
            values = values[1:] - rho * values[:-1]
            input_memory, _ = _correlated(values, values, lags)
            cross, counts = _correlated(prewhitened, values, two_sided_lags)
            joint = max(1.0, 1.0 + 2.0 * float(significant[1:] @ input_memory[1:]))
            yield build(input=name, lags=two_sided_lags, values=cross, sds=np.sqrt(joint / counts))


def _correlated(late: Array, early: Array, lags: Indices) -> tuple[Array, Array]:
    """Return correlations `(L,)` of `late (n,)` with `early (n,)` at lags, and numbers of pairs."""
    measured = [np.isfinite(x).astype(float) for x in (late, early)]
    x, y = (np.nan_to_num(x) for x in (late, early))
    n, sums, counts = len(x), np.empty(len(lags)), np.empty(len(lags))
    for row, lag in enumerate(lags):
        after, before = slice(max(lag, 0), n + min(lag, 0)), slice(max(-lag, 0), n - max(lag, 0))
        sums[row], counts[row] = x[after] @ y[before], measured[0][after] @ measured[1][before]
    counts = np.maximum(counts, 1.0)
    n_products = max(measured[0].sum() * measured[1].sum(), 1.0)
    size = math.sqrt(float(x @ x) * float(y @ y) / n_products)
    return (sums / counts / size if size > 0 else np.zeros(len(lags))), counts
