"""Check predictions of samples by their PIT, and compute held-out and leave-one-out scores.

The probability integral transform (PIT) of a sample is the predicted probability of a smaller value.
If model and noise are right, PITs are uniform.  A sample that helps to predict itself would be
predicted too well, so each PIT refers to the posterior without that sample: draws are weighted by the
sample's inverse density, with weights of at most their mean times sqrt(n_draws) (Ionides 2008).
Weights are not Pareto-smoothed, which fails if all draws agree (as at the first sample at rest).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from bayesdrill.analysis.calibration import RankBand, ecdf_band, shape
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.findings import Finding
from bayesdrill.basics.symbols import Symbol
from bayesdrill.basics.units import Unit
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Likelihood, Posterior
from bayesdrill.inference.residual_checks import ResidualSummary
from bayesdrill.record.experiment import Channel, frozen
from bayesdrill.rig.models.linear import dynamics

PIT_BINS = 100  # number of bins of PITs
MAX_CHECKED = 2000  # largest number of samples of a channel that are checked
FALSE_ALARM = 0.01  # probability that a record simulated by the model leaves any band
SAYS = {
    "posterior too low": "measured lies above",
    "posterior too high": "measured lies below",
    "posterior too narrow": "prediction too narrow",
    "posterior too wide": "prediction too wide",
}


@dataclass(frozen=True, slots=True)
class PredictionCheck:
    """A check compares the PITs `pit (T,)` of a channel with the `band` of uniform ranks."""

    channel: Channel
    pit: Array
    band: RankBand
    label: str = ""

    @property
    def ranks(self) -> NDArray[np.int64]:
        """Return the bin of each PIT, 0 to `PIT_BINS` - 1."""
        return np.minimum((PIT_BINS * self.pit).astype(np.int64), PIT_BINS - 1)

    @property
    def is_consistent(self) -> bool:
        """Return whether chance explains the ranks."""
        return self.band.contains(self.ranks)

    @property
    def says(self) -> str:
        """Return what is wrong with the prediction; empty if chance explains the ranks."""
        if self.is_consistent:
            return ""
        return SAYS.get(shape(self.ranks, PIT_BINS - 1) or "", "not as predicted")


def prediction_checks(likelihood: Likelihood, theta: Array) -> tuple[PredictionCheck, ...]:
    """Check each channel by draws `theta (N, D)`."""
    transforms = []
    for observation in likelihood.observations:
        pits = leave_one_out_check(likelihood, observation, theta).T
        pairs = zip(observation.experiment.channels, pits, strict=True)
        known = ((channel, pit[~np.isnan(pit)]) for channel, pit in pairs)
        transforms += [(observation.label, channel, pit) for channel, pit in known if len(pit)]
    alarm = FALSE_ALARM / max(len(transforms), 1)
    return tuple(
        PredictionCheck(channel, pit, ecdf_band(len(pit), PIT_BINS - 1, alarm), label)
        for label, channel, pit in transforms
    )


def leave_one_out_check(likelihood: Likelihood, observation: Observation, theta: Array) -> Array:
    """Return PITs `(T, K)` of at most `MAX_CHECKED` samples, evenly spaced; NaN if not measured.

    Residuals are whitened, so a prediction uses earlier samples if the noise is correlated.
    """
    residuals = observation.residuals(likelihood.space.full(theta)).samples
    n = len(observation.experiment.t)
    checked = np.unique(np.linspace(0, n - 1, min(n, MAX_CHECKED)).round().astype(int))
    below = scipy.special.ndtr(observation.whiten(residuals, theta)[:, checked])
    log_p = observation.pointwise(residuals, theta)[:, checked]
    weights = np.exp(log_p.min(axis=0) - log_p)
    weights = np.minimum(weights, weights.mean(axis=0) * len(theta) ** 0.5)
    return np.asarray((weights * below).sum(axis=0) / weights.sum(axis=0))


MAX_DRAWS = 800  # draws are thinned to this number
MAX_SCORED = 50_000  # largest number of scored samples, as the densities of all draws are in memory
EQUAL_LOG_DENSITY = 1e-12  # log densities of a sample that differ by less count as equal
BAD_PARETO_K = 0.7  # Pareto k above which the score of a sample depends on a few draws
MAX_BAD_SHARE = 0.01  # largest fraction of samples that may have such a k


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutScore:
    """The score of held-out `samples` is the sum of `terms (n,)`, log predictive densities in SI."""

    score: float
    samples: int
    terms: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class LooScore:
    """The score `elpd` sums `terms (n,)`; `unreliable` is the fraction of terms with a large k."""

    elpd: float
    terms: Array
    unreliable: float


def held_out(posterior: Posterior, theta: Array) -> HeldOutScore | None:
    """Score held-out segments and experiments by draws `theta (N, D)`; None if there are none."""
    theta, log_densities = _thinned(theta), []
    full, likelihood = posterior.space.full(theta), posterior.likelihood
    segments = [(part, part.experiment.held_out) for part in likelihood.observations]
    whole = [(part, part.experiment.y) for part in likelihood.held_out]
    for observation, measured in (*segments, *whole):
        if measured is not None:
            residuals = measured - observation.signals(full)
            # Correlated noise is predicted from earlier samples of this part only.
            record = replace(observation.experiment, y=frozen(measured))
            log_p = observation.for_record(record).pointwise(residuals, theta)
            log_p = log_p[:, ~np.isnan(measured)]
            log_densities.append(scipy.special.logsumexp(log_p, axis=0) - np.log(len(theta)))
    if not log_densities:
        return None
    terms = np.concatenate(log_densities)
    return HeldOutScore(score=float(terms.sum()), samples=len(terms), terms=terms)


def leave_one_out(
    posterior: Posterior, theta: Array, residual_rows: tuple[ResidualSummary, ...]
) -> LooScore | Finding:
    """Score each sample as predicted from all others, by draws `theta (N, D)`, or say why not."""
    observations = posterior.likelihood.observations
    if sum(observation.n_measured for observation in observations) > MAX_SCORED:
        return Finding("too many samples to leave out", {}, {"most": MAX_SCORED})
    if any(has_memory(observation, theta) for observation in observations):
        return Finding("noise with memory")
    if coloured := [row for row in residual_rows if row.correlated]:
        worst = max(coloured, key=lambda row: abs(row.correlation))
        numbers = {"correlation": worst.correlation}
        return Finding("residuals with memory", {"channel": worst.name}, numbers)
    from arviz_stats.base import array_stats  # imported here, as loading takes half a second

    smoothed: Any = array_stats.psislw
    theta = _thinned(theta)
    full, log_densities = posterior.space.full(theta), []
    for observation in observations:
        log_p = observation.pointwise(observation.residuals(full).samples, theta)
        log_densities.append(log_p[:, observation.experiment.is_measured].T)
    log_p = np.concatenate(log_densities)
    terms, pareto_k = log_p.mean(axis=1), np.zeros(len(log_p))
    differ = np.ptp(log_p, axis=1) > EQUAL_LOG_DENSITY  # smoothing needs different densities
    log_w, pareto_k[differ] = smoothed(log_p[differ])
    terms[differ] = scipy.special.logsumexp(log_w + log_p[differ], axis=1)
    doubtful = float((pareto_k > BAD_PARETO_K).mean())
    return LooScore(elpd=float(terms.sum()), terms=terms, unreliable=doubtful)


def has_memory(observation: Observation, theta: Array) -> bool:
    """Return whether a change of one sample changes other whitened samples, at `theta (N, D)`."""
    if observation.white:
        return False
    first, sampled = theta[:1], observation.experiment.is_measured
    samples = np.where(sampled, np.zeros((2, *sampled.shape)), np.nan)
    for k, sigma in enumerate(observation.scales(first)[0]):
        rows = np.flatnonzero(sampled[:, k])
        samples[1, rows[len(rows) // 2], k] = sigma
    unchanged, changed = observation.whiten(samples, np.repeat(first, 2, axis=0))
    differences = np.abs(changed - unchanged)[samples[1] == 0.0]
    return bool(np.nanmax(differences, initial=0.0) > EQUAL_LOG_DENSITY)


def _thinned(theta: Array) -> Array:
    return theta[:: max(1, -(-len(theta) // MAX_DRAWS))]


SEGMENTS = 8  # number of segments of Welch's method, with an overlap of one half
SMOOTHED_FREQUENCIES = 7  # number of frequencies over which the spectrum of noise is averaged
MIN_SAMPLED_SHARE = 0.9  # smallest fraction of measured samples; missing residuals count as zero
# Sd of a response divided by its magnitude, above which the input does not excite the channel.
MAX_RELATIVE_SD = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class FrequencyResponse:
    """A frequency response relates a channel (SI) to an `input` (in `unit`), by `frequencies (F,)` [Hz].

    Responses `modelled (F,)` and `measured (F,)` are complex.  `error (F,)` is the relative sd of
    `measured`, which is NaN if the input does not excite the channel.
    """

    channel: Channel
    input: Symbol
    unit: Unit
    frequencies: Array
    modelled: NDArray[np.complex128]
    measured: NDArray[np.complex128]
    error: Array
    label: str = ""


def frequency_responses(posterior: Posterior, theta: Array) -> tuple[FrequencyResponse, ...]:
    """Return the frequency responses, at the MAP `theta (D,)`, of experiments with equal steps.

    The rig has to be linear, with measured inputs.  A measured response is the model's response plus
    that of the residuals to the inputs, by Welch's method.  Initial states and leakage at a
    resonance therefore bias it only if the model is wrong.  Errors follow Bendat and Piersol
    (Random Data, 4th ed., section 9.2).
    """
    from scipy.ndimage import uniform_filter1d
    from scipy.signal import csd  # imported here, as loading takes half a second

    full, responses = posterior.space.full(theta[None]), []
    for observation in posterior.likelihood.observations:
        experiment = observation.experiment
        series = {name: u for name, u in experiment.series.items() if np.ptp(u) > 0}
        if not (observation.response.model.smooth and experiment.uniform and series):
            continue
        u, e = np.array([*series.values()]), np.nan_to_num(observation.residuals(full).samples[0].T)
        length, both = 2 * u.shape[1] // (SEGMENTS + 1), np.concatenate([u, e])
        f, cross_spectra = csd(both[:, None], both[None], 1.0 / experiment.dt, nperseg=length)
        f, n = f[1:], len(u)
        spectra = np.moveaxis(cross_spectra[..., 1:], -1, 0)  # (F, S + K, S + K)
        inverse = np.linalg.pinv(spectra[:, :n, :n], hermitian=True)
        correction = (inverse @ spectra[:, :n, n:]).swapaxes(1, 2)  # (F, K, S)
        explained = correction.conj() @ spectra[:, :n, n:]
        noise = np.einsum("fkk->fk", spectra[:, n:, n:] - explained).real
        # A single frequency has few degrees of freedom.
        noise = uniform_filter1d(noise, SMOOTHED_FREQUENCIES, axis=0)
        variance = np.einsum("fss->fs", inverse).real / (2.0 * max(SEGMENTS - n, 1))
        modelled = _response(observation, observation.simulator_parameters(full), f, [*series])
        measured = modelled + correction
        error = np.sqrt(np.maximum(noise, 0.0)[:, :, None] * variance[:, None]) / np.abs(measured)
        measured[(error > MAX_RELATIVE_SD) | (variance == 0.0)[:, None]] = np.nan
        responses += [
            FrequencyResponse(
                channel=channel,
                input=observation.response.model.symbols[name],
                unit=experiment.unit_of_input(name),
                frequencies=f,
                modelled=modelled[:, k, column],
                measured=measured[:, k, column],
                error=error[:, k, column],
                label=observation.label,
            )
            for k, channel in enumerate(experiment.channels)
            for column, name in enumerate(series)
            if experiment.is_measured[:, k].mean() > MIN_SAMPLED_SHARE
        ]
    return tuple(responses)


def _response(
    observation: Observation, arguments: Array, f: Array, names: list[str]
) -> NDArray[np.complex128]:
    """Return C (i w - A)^-1 B, `(F, K, S)`, with sensors, and inputs held or linear between samples."""
    sensors = observation.response.sensors
    rig, sensing, dt = sensors.observed_model, sensors.sensing, observation.experiment.dt
    p = dict(zip(rig.parameters, sensors.simulator_parameters(arguments)[0], strict=True))
    linear = rig.linear(p)
    b, s = np.zeros((len(rig.states), len(names))), 2j * np.pi * f[:, None, None]
    for (row, name), value in linear.B.items():
        if name in names:
            b[rig.states.index(row), names.index(name)] = value
    states = np.linalg.solve(s * np.eye(len(b)) - dynamics(linear, rig.states, 1), b[None])
    lags = np.zeros(len(names))
    for name, lag in sensing.input_lags.items():
        lags[names.index(name)] = sensors.column(lag, arguments)[0]
    delays = lags + sensors.channel_delays(arguments)[0][:, None]
    hold = np.sinc(s.imag * dt / (2 * np.pi))
    hold = hold**2 if observation.experiment.first_order else hold * np.exp(-s * dt / 2)
    shown = sensors.gains(arguments)[0][:, None] * sensors.weights
    return np.asarray(shown @ states * hold * np.exp(-s * delays))
