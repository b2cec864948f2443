"""Whether the record is as the posterior predicts it: where each sample lies in its own prediction; and
how well draws predict samples (held out, PSIS-LOO).

The probability integral transform (PIT) of a sample is the share of its prediction below it; where model
and noise are right they are uniform.  Each is of the posterior without that sample, for a sample that
helps to predict itself is predicted too well: draws weigh as one over what they give that sample, but
none more than the root of their number times the mean (Ionides 2008).  Pareto smoothing would refuse
samples at which all draws agree, such as the first of a rig at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from bayesdrill.analysis.calibration import Band, ecdf_band, shape
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.units import Unit
from bayesdrill.inference.likelihood import Likelihood, Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.residual_checks import ResidualSummary
from bayesdrill.record.experiment import Channel
from bayesdrill.rig.models.linear import dynamics
from bayesdrill.rig.simulators.sensors import Walkers

BINS = 100
MOST_CHECKED = 2000  # samples of a channel that are looked at
FALSE_ALARM = 0.01  # of records of the model, with its noise, leave any band, at most
SAYS = {
    "posterior too low": "measured lies above",
    "posterior too high": "measured lies below",
    "posterior too narrow": "prediction too narrow",
    "posterior too wide": "prediction too wide",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """Of one channel: `pit (T,)`, and the band of their distribution; `label`: of its experiment."""

    channel: Channel
    pit: Array
    band: Band
    label: str = ""

    @property
    def ranks(self) -> NDArray[np.int64]:
        """In which of `BINS` equal parts of its prediction each sample lies."""
        return np.minimum((BINS * self.pit).astype(np.int64), BINS - 1)

    @property
    def holds(self) -> bool:
        return self.band.holds(self.ranks)

    @property
    def says(self) -> str:
        """What is wrong with the prediction; empty where chance explains all."""
        if self.holds:
            return ""
        return SAYS.get(shape(self.ranks, BINS - 1) or "", "not as predicted")


def checks(likelihood: Likelihood, theta: Array) -> tuple[Check, ...]:
    """Of each channel, by draws `theta (N, D)`."""
    every = [
        (one.label, channel, pit[~np.isnan(pit)])
        for one in likelihood.observations
        for channel, pit in zip(
            one.experiment.channels, leave_one_out_check(likelihood, one, theta).T, strict=True
        )
        if not np.isnan(pit).all()
    ]
    return tuple(
        Check(
            channel=channel,
            label=label,
            pit=pit,
            band=ecdf_band(len(pit), BINS - 1, FALSE_ALARM / len(every)),  # kept for each length
        )
        for label, channel, pit in every
    )


def leave_one_out_check(likelihood: Likelihood, one: Observation, theta: Array) -> Array:
    """PITs `(T, K)` of at most `MOST` samples, evenly spaced; NaN where nothing was measured.

    What is left of a sample is whitened, so that each counts on those before it where the noise
    remembers them.
    """
    rest = one.residuals(likelihood.space.full(theta)).samples
    n = len(one.experiment.t)
    seen = np.unique(np.linspace(0, n - 1, min(n, MOST_CHECKED)).round().astype(int))
    below = scipy.special.ndtr(one.whiten(rest, theta)[:, seen])
    log_p = one.pointwise(rest, theta)[:, seen]
    weights = np.exp(log_p.min(axis=0) - log_p)
    weights = np.minimum(weights, weights.mean(axis=0) * len(theta) ** 0.5)
    return np.asarray((weights * below).sum(axis=0) / weights.sum(axis=0))


DRAWS = 800  # looked at
MOST_SCORED = 50_000  # samples whose densities are kept for all draws
AGREED = 1e-12  # of the log densities of a sample: all draws give it the same
BAD = 0.7  # of Pareto's k, from which on a sample leans on a few draws
FEW = 0.01  # of the samples may


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOut:
    """`score`: sum of the logs of the predictive densities of so many `samples`, SI; `each (n,)`."""

    score: float
    samples: int
    each: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """Of each sample without itself: `elpd`, its parts `each (n,)`, and the share that is `doubtful`."""

    elpd: float
    each: Array
    doubtful: float


def held_out(posterior: Posterior, theta: Array) -> HeldOut | None:
    """By draws `theta (N, D)`: stretches and whole experiments; None where nothing is held out."""
    theta, found = _some(theta), []
    full, likelihood = posterior.space.full(theta), posterior.likelihood
    stretches = [(one, one.experiment.held_out) for one in likelihood.observations]
    for one, held in (*stretches, *((one, one.experiment.y) for one in likelihood.held_out)):
        if held is not None:
            rest = held - one.signals(full)
            # By itself: what remembers is not told what stands beside it.
            log_p = one.for_record(held).pointwise(rest, theta)[:, ~np.isnan(held)]
            found.append(scipy.special.logsumexp(log_p, axis=0) - np.log(len(theta)))
    if not found:
        return None
    each = np.concatenate(found)
    return HeldOut(score=float(each.sum()), samples=len(each), each=each)


def leave_one_out(
    posterior: Posterior, theta: Array, left: tuple[ResidualSummary, ...]
) -> LeftOut | str:
    """By draws `theta (N, D)`; or why that would tell nothing: samples that tell of each other by more
    than the unknowns, or too many of them.
    """
    observations = posterior.likelihood.observations
    if sum(one.n_measured for one in observations) > MOST_SCORED:
        return f"more than {MOST_SCORED} samples"
    if any(remembers(one, theta) for one in observations):
        return "its noise remembers: a sample that is left out is told by those beside it"
    if coloured := [one for one in left if one.correlated]:
        worst = max(coloured, key=lambda one: abs(one.correlation))
        return (
            f"what it leaves is not white (correlation of neighbours {worst.correlation:.2f} in "
            f"{worst.name}): a sample that is left out is told by those beside it"
        )
    from arviz_stats.base import array_stats  # late: it takes half a second to load

    smoothed: Any = array_stats.psislw
    theta = _some(theta)
    full, found = posterior.space.full(theta), []
    for one in observations:
        log_p = one.pointwise(one.residuals(full).samples, theta)
        found.append(log_p[:, one.experiment.seen].T)
    log_p = np.concatenate(found)
    each, told = log_p.mean(axis=1), np.zeros(len(log_p))
    differ = np.ptp(log_p, axis=1) > AGREED  # of those at rest nothing is to be smoothed
    log_w, told[differ] = smoothed(log_p[differ])
    each[differ] = scipy.special.logsumexp(log_w + log_p[differ], axis=1)
    return LeftOut(elpd=float(each.sum()), each=each, doubtful=float((told > BAD).mean()))


def remembers(one: Observation, theta: Array) -> bool:
    """Whether its noise says of a sample what those before it were, at the first of `theta (N, D)`."""
    if one.white:
        return False
    first, seen = theta[:1], one.experiment.seen
    samples = np.where(seen, np.zeros((2, *seen.shape)), np.nan)
    for k, sigma in enumerate(one.scales(first)[0]):
        rows = np.flatnonzero(seen[:, k])
        samples[1, rows[len(rows) // 2], k] = sigma
    quiet, struck = one.whiten(samples, np.repeat(first, 2, axis=0))
    felt = np.abs(struck - quiet)[samples[1] == 0.0]
    return bool(np.nanmax(felt, initial=0.0) > AGREED)


def _some(theta: Array) -> Array:
    return theta[:: max(1, -(-len(theta) // DRAWS))]


SEGMENTS = 8  # of a record, half over each other, that a spectrum is the mean of
SMOOTH = 7  # frequencies over which the spectrum of noise is alike
LEAST_SEEN = 0.9  # of the samples of a channel; the others count as the model has them
EXCITED = 0.25  # sd over magnitude of a response, to which an input that excites lets it be known


@dataclass(frozen=True, slots=True, kw_only=True)
class FrequencyResponse:
    """From a measured `input`, shown in `unit`, to a `channel`, SI, at `frequencies (F,)` [Hz]:
    `modelled` and `measured (F,)`, complex, and sd over magnitude `error (F,)`; NaN where the input does
    not excite the channel.
    """

    channel: Channel
    input: str
    unit: Unit
    frequencies: Array
    modelled: NDArray[np.complex128]
    measured: NDArray[np.complex128]
    error: Array
    label: str = ""


def frequency_responses(posterior: Posterior, theta: Array) -> tuple[FrequencyResponse, ...]:
    """Return those of each experiment at the MAP `theta (D,)`: of linear rigs with measured inputs and
    equal steps.

    What is measured is what the model has, and what Welch's method says of the residuals by the inputs:
    so the start and leakage at a resonance bias it only as far as the model is wrong (errors: Bendat
    and Piersol, Random Data, 4th ed., section 9.2).
    """
    from scipy.ndimage import uniform_filter1d
    from scipy.signal import csd  # late: it takes half a second to load

    full, found = posterior.space.full(theta[None]), []
    for one in posterior.likelihood.observations:
        experiment = one.experiment
        series = {name: u for name, u in experiment.series.items() if np.ptp(u) > 0}
        if one.response.model.frictions or not experiment.uniform or not series:
            continue
        u, e = np.array([*series.values()]), np.nan_to_num(one.residuals(full).samples[0].T)
        length, both = 2 * u.shape[1] // (SEGMENTS + 1), np.concatenate([u, e])
        f, every = csd(both[:, None], both[None], 1.0 / experiment.dt, nperseg=length)
        f, spectra, n = f[1:], np.moveaxis(every[..., 1:], -1, 0), len(u)  # (F, S + K, S + K)
        inverse = np.linalg.pinv(spectra[:, :n, :n], hermitian=True)
        more = (inverse @ spectra[:, :n, n:]).swapaxes(1, 2)  # (F, K, S)
        noise = np.einsum("fkk->fk", spectra[:, n:, n:] - more.conj() @ spectra[:, :n, n:]).real
        # By itself it has few degrees of freedom.
        noise = uniform_filter1d(noise, SMOOTH, axis=0)
        share = np.einsum("fss->fs", inverse).real / (2.0 * max(SEGMENTS - n, 1))
        modelled = _response(one, one.simulator_parameters(full), f, [*series])
        measured = modelled + more
        error = np.sqrt(np.maximum(noise, 0.0)[:, :, None] * share[:, None]) / np.abs(measured)
        measured[(error > EXCITED) | (share == 0.0)[:, None]] = np.nan
        found += [
            FrequencyResponse(
                channel=channel,
                input=name,
                unit=experiment.unit_of_input(name),
                frequencies=f,
                modelled=modelled[:, k, column],
                measured=measured[:, k, column],
                error=error[:, k, column],
                label=one.label,
            )
            for k, channel in enumerate(experiment.channels)
            for column, name in enumerate(series)
            if experiment.seen[:, k].mean() > LEAST_SEEN
        ]
    return tuple(found)


def _response(one: Observation, told: Array, f: Array, names: list[str]) -> NDArray[np.complex128]:
    """`(F, K, S)`: C (i w - A)^-1 B, with sensors, and inputs held or straight from sample to sample."""
    walkers = Walkers(one.response.model, one.experiment, one.response.sensing)
    rig, sensing, dt = walkers.wired, walkers.sensing, one.experiment.dt
    linear = rig.linear(dict(zip(rig.parameters, walkers.told(told)[0], strict=True)))
    b, s = np.zeros((len(rig.states), len(names))), 2j * np.pi * f[:, None, None]
    for (row, name), value in linear.B.items():
        if name in names:
            b[rig.states.index(row), names.index(name)] = value
    states = np.linalg.solve(s * np.eye(len(b)) - dynamics(linear, rig.states, 1), b[None])
    late = np.zeros(len(names))
    for name, lag in sensing.input_lags.items():
        late[names.index(name)] = walkers.column(lag, told)[0]
    late = late + walkers.later(told)[0][:, None]
    held = np.sinc(s.imag * dt / (2 * np.pi))
    held = held**2 if one.experiment.first_order else held * np.exp(-s * dt / 2)
    shown = walkers.gains(told)[0][:, None] * walkers.weights
    return np.asarray(shown @ states * held * np.exp(-s * late))
