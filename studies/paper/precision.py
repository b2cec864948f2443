"""Compute the paper's misfit, Cramer-Rao bounds, and records of known truth.

Where a truth is claimed the record is made anew, and must be the one there is: a measured record
that takes the place of a simulated one has no truth, whatever configs say.
"""

from __future__ import annotations

import dataclasses
import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import chi2

from bayesdrill.analysis import SensitivityStudy, from_sensitivities
from bayesdrill.basics import Array, seeds
from bayesdrill.config import ResolvedCase, path_of, simulate
from bayesdrill.config import truth as simulated_truth
from bayesdrill.inference import Likelihood, Posterior
from bayesdrill.rig import Model, MotorShaft, Response, TwoRotors
from bayesdrill.sampling import NelderMead, Optimum, Task, mode_search
from studies.paper import printed
from studies.paper.forward import regular
from studies.paper.optimisers import fminsearch
from studies.paper.printed import Row


def bounds(likelihood: Likelihood, truth: Array) -> Array:
    """Return Cramer-Rao bounds of the unknowns `(D,)`, physical, for sigma 1 in every channel."""
    sensitivity = SensitivityStudy(likelihood, len(likelihood.only_observation.experiment.t))
    sigma = likelihood.only_observation.scales(truth[None])[0]
    rows = sensitivity.sensitivities(truth)
    each = (rows.reshape(-1, len(sigma), rows.shape[1]) * sigma[:, None]).reshape(rows.shape)
    known = from_sensitivities(sensitivity.unknowns, each)
    return np.asarray(known.bounds() * truth)


def at_sigma_1(likelihood: Likelihood, truth: Mapping[str, float]) -> dict[str, float]:
    """Return `bounds` relative to the truth, by unknown."""
    theta = likelihood.space.vector(truth)
    relative = bounds(likelihood, theta) / theta
    return dict(zip(likelihood.space.free, map(float, relative), strict=True))


ATTAINED = printed.TWO_PARAMETERS[1.0]["c_m"].deviation  # per cent of c_m at sigma 1


def lengths(
    likelihood: Likelihood, truth: Mapping[str, float], grid: Sequence[tuple[float, float]]
) -> Iterator[Row]:
    """Yield bounds at sigma 0.001 of records of (duration [s], rate [Hz]), otherwise like this one.

    `repeats`: how many such records at sigma 1 know c_m to `ATTAINED`.
    """
    observation = likelihood.only_observation
    for duration, rate in grid:
        experiment = regular(observation.experiment, duration, rate)
        response = Response(observation.response.model, experiment)
        noise = observation.noise.for_length(len(experiment.t))
        long = dataclasses.replace(observation, response=response, noise=noise)
        longer = dataclasses.replace(likelihood, observations=(long,))
        relative = at_sigma_1(longer, truth)
        yield {
            "duration": duration,
            "rate": rate,
            "c_m_percent": 0.1 * relative["c_m"],  # 100 % at a thousandth
            "k_e_percent": 0.1 * relative["k_e"],
            "repeats": (100 * relative["c_m"] / ATTAINED) ** 2,
        }


def implied_noise(values: Mapping[str, float]) -> list[Row]:
    """Return deviations in per cent, by sigma_n, `rms` or `bound`, and the noise whose bound each is.

    `values`: relative bounds at sigma 1.
    """
    table = {
        f"{sigma:g}": {name: cell.deviation for name, cell in row.items()}
        for sigma, row in printed.TWO_PARAMETERS.items()
    }
    squares = {
        name: float(np.mean([row[name] ** 2 for row in table.values()]))
        for name in printed.TWO_UNKNOWNS
    }
    table["rms"] = {name: math.sqrt(square) for name, square in squares.items()}
    table["bound"] = {name: 100 * 1e-3 * values[name] for name in printed.TWO_UNKNOWNS}
    return [
        {
            "row": label,
            "c_m_percent": row["c_m"],
            "k_e_percent": row["k_e"],
            "ratio": row["c_m"] / row["k_e"],
            "noise_c_m": row["c_m"] / 100 / values["c_m"],
            "noise_k_e": row["k_e"] / 100 / values["k_e"],
        }
        for label, row in table.items()
    ]


type Search = Callable[[Task, Array, int], Sequence[Optimum]]

# Nelder-Mead in scaled coordinates goes to the very optimum: no slopes go the rest of the way here.
SCALED = NelderMead(enough=1e-3, per_unknown=math.inf)
WAYS: Mapping[str, Search] = {"fminsearch": fminsearch, "scaled": SCALED}
SHARE = 0.95  # of records have a misfit within `expected` at their truth


def misfit_task(posterior: Posterior) -> Task:
    """Pose the likelihood alone, where the priors have a density: they bound a search, no more."""
    whole = mode_search.task(posterior)

    def density(theta: Array) -> Array:
        both = whole.density(theta)
        inside = both > -np.inf
        both[inside] -= posterior.space.log_prior(theta)[inside]
        return both

    return dataclasses.replace(whole, density=density)


def misfit_per_number(posterior: Posterior, theta: Array) -> float:
    """Return the misfit at `theta (D,)` per measured number: 1 where only noise is left."""
    return float(posterior.likelihood.mean_square(theta[None])[0])


def expected_misfit(numbers: int) -> tuple[float, float]:
    """Return the misfit per number at the truth, in all but one of twenty records."""
    low, high = chi2.ppf([0.5 - 0.5 * SHARE, 0.5 + 0.5 * SHARE], numbers) / numbers
    return float(low), float(high)


def made_record(posterior: Posterior, truth: Array, seed: int, index: int) -> Posterior:
    """Return a copy with record `index` of the rig `truth (D,)`; its noise scales with sigma."""
    rng = seeds.stream(seed, "study", index)
    y = posterior.likelihood.signals(truth[None])
    observation = posterior.likelihood.only_observation
    return posterior.edit(records=[*observation.draw(y, truth[None], rng)])


def clean_record(posterior: Posterior, truth: Array) -> Posterior:
    """Return a copy with a record without noise."""
    return posterior.edit(records=[*posterior.likelihood.signals(truth[None])])


def with_sigma(posterior: Posterior, sigma: float) -> Posterior:
    """Return a copy with this noise in every channel."""
    noise: Any = posterior.likelihood.only_observation.noise
    known = dict.fromkeys(range(noise.n_channels), sigma)
    other = dataclasses.replace(noise, known=known)
    return posterior.edit(convert=lambda observation: dataclasses.replace(observation, noise=other))


SAME = 1e-6  # relative, and absolute: records hold nine digits


def truth_of(case: ResolvedCase, makers: Sequence[ResolvedCase]) -> dict[str, float] | None:
    """Return parameters of its model with which its record was simulated by one of `makers`."""
    path = path_of(case.experiments[0])
    for other in makers:
        if path_of(other.experiments[0]).resolve() != path.resolve():
            continue
        text = path.read_text(encoding="utf-8", errors="replace")
        if _same(simulate(other, other.config.seed), text):
            return _of_model(case.model, other.model, simulated_truth(other.experiments[0]))
    return None


def _of_model(model: Model, rig: Model, values: dict[str, float]) -> dict[str, float] | None:
    """Return the parameters of `model` that make it the `rig` with these `values`, or None."""
    if model == rig:
        return values
    if isinstance(model, MotorShaft) and isinstance(rig, TwoRotors) and model.i_m == rig.i_m:
        return {name: float(x) for name, x in rig.whole(values).items()}
    return None


def _same(text: str, other: str) -> bool:
    """Of two CSV records."""
    if text.partition("\n")[0] != other.partition("\n")[0]:
        return False
    try:
        first, second = (
            np.loadtxt(io.StringIO(table), delimiter=",", skiprows=1, ndmin=2)
            for table in (text, other)
        )
    except ValueError:  # other numbers than a simulation writes
        return False
    return first.shape == second.shape and np.allclose(first, second, rtol=SAME, atol=SAME)
