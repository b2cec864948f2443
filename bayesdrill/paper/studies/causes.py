"""What Table 3 says in quantities that a record can show, and what missing physics would do to them.

An inertia j_2 at the output of the gearbox and a resistance r_s in series make the rig another one
of the same model: with j_m + i_m^2 j_2 and r_m + r_s (`models.two_rotors`).  So they move products
of the paper's parameters by factors known beforehand, and a fit of the paper's model finds those.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference import Posterior
from bayesdrill.insight import Scenery, derived, from_sensitivities, hdi
from bayesdrill.paper.studies import printed
from bayesdrill.record import usual_inputs
from bayesdrill.rig import Model, MotorShaft, Named, TwoRotors

Array = NDArray[np.float64]

# The seven products that neither symmetry changes, and some that follow from them.
PRODUCTS: Mapping[str, Mapping[str, int]] = {
    "k_s/j_1": {"k_s": 1, "j_1": -1},
    "k_s/j_m": {"k_s": 1, "j_m": -1},
    "c_m/j_m": {"c_m": 1, "j_m": -1},
    "t_f/j_m": {"t_f": 1, "j_m": -1},
    "k_e": {"k_e": 1},
    "r_m/l_m": {"r_m": 1, "l_m": -1},
    "k_T/(l_m j_m)": {"k_T": 1, "l_m": -1, "j_m": -1},
    "k_T/(r_m j_m)": {"k_T": 1, "r_m": -1, "j_m": -1},
    "r_m j_m/(k_T k_e)": {"r_m": 1, "j_m": 1, "k_T": -1, "k_e": -1},
}
FOLLOWING = ("w_end", "zeta")  # of `derived`: no products, but no symmetry changes them either
J_2, R_S = 7.0e-3, 0.2  # kg m^2, ohm
STEP = 1e-4  # of a log, for slopes
GIVEN = 1e-9  # logs of draws that all lie within this are rounding alone


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """A quantity over its value at the initial guesses of the paper.

    `table_3`: of the printed estimates, `table_3_digits` of those with the digits of the percentages;
    `j_2`, `r_s`, `both`: of a rig with that missing; `k_T`: of one whose k_T equals k_e; the rest: of
    the record, by the heuristic and the posterior (median, and 94 % HDI of the logarithm).  `alone`:
    Cramer-Rao bound of the sd of its log without any prior, at the MAP; inf if not determined.  None
    where the config itself gives the quantity, so that the record says nothing of it.
    """

    quantity: str
    table_3: float
    table_3_digits: float
    j_2: float
    r_s: float
    both: float
    k_T: float
    heuristic: float
    posterior: float | None
    hdi_low: float | None
    hdi_high: float | None
    alone: float | None


def causes(posterior: Posterior, mode: Array, estimate: Array, draws: Array) -> tuple[Cause, ...]:
    """From the MAP and the heuristic's estimate `(D,)`, and draws `(N, D)`."""
    inputs = usual_inputs(posterior.likelihood.response.experiment)
    guess = quantities(MotorShaft(), printed.GUESS, inputs, 1)
    rigs: dict[str, Mapping[str, float]] = {
        "table_3": {n: e.value for n, e in printed.NINE_PARAMETERS.items()},
        "table_3_digits": {n: printed.implied(n) for n in printed.GUESS},
        "j_2": with_missing(j_2=J_2),
        "r_s": with_missing(r_s=R_S),
        "both": with_missing(j_2=J_2, r_s=R_S),
        "k_T": {**printed.GUESS, "k_T": printed.GUESS["k_e"]},
    }
    columns = {name: quantities(MotorShaft(), rig, inputs, 1) for name, rig in rigs.items()}
    columns["heuristic"] = _at(posterior, estimate[None], inputs)
    drawn = _at(posterior, draws, inputs)
    alone = _alone(posterior, mode, inputs)
    found = []
    for name, value in guess.items():
        logs = np.log(drawn[name] / value)
        logs = logs[np.isfinite(logs)]
        there = np.ptp(logs) > GIVEN
        low, high = np.exp(hdi(logs)).tolist() if there else (None, None)
        found.append(
            Cause(
                quantity=name,
                **{column: float((own[name] / value)[0]) for column, own in columns.items()},
                posterior=float(np.exp(np.median(logs))) if there else None,
                hdi_low=low,
                hdi_high=high,
                alone=alone[name] if there else None,
            )
        )
    return tuple(found)


def quantities(model: Model, p: Named, inputs: Mapping[str, float], n: int) -> dict[str, Array]:
    """By name, each `(n,)`, SI; NaN where a draw has no such value."""
    found = {
        name: np.asarray(math.prod(np.asarray(p[q]) ** float(e) for q, e in powers.items()))
        for name, powers in PRODUCTS.items()
    }
    # With arrays, whatever is held: the poles are those of n rigs.
    rigs = {name: np.broadcast_to(np.asarray(p[name], dtype=float), n) for name in model.parameters}
    linear = model.linear(rigs)
    both = {**derived.poles(model, linear, n), **derived.steady(model, linear, n, inputs)}
    every = {**found, **{name: both[name] for name in FOLLOWING}}
    return {name: np.broadcast_to(x, n) for name, x in every.items()}


def with_missing(*, j_2: float = 0.0, r_s: float = 0.0) -> dict[str, float]:
    """The nominal rig with these, as a rig of the paper's model."""
    whole = TwoRotors(j_2=j_2, r_s=r_s).whole(printed.GUESS)
    return {name: float(x) for name, x in whole.items()}


def _at(posterior: Posterior, theta: Array, inputs: Mapping[str, float]) -> dict[str, Array]:
    """At unknowns `(W, D)`."""
    model = posterior.likelihood.response.model
    return quantities(model, posterior.space.named(theta), inputs, len(theta))


def _alone(posterior: Posterior, mode: Array, inputs: Mapping[str, float]) -> dict[str, float]:
    scenery = Scenery(posterior.likelihood)
    names = scenery.unknowns
    known = from_sensitivities(names, scenery.sensitivities(mode))
    steps = STEP * np.eye(len(names), len(mode))
    up, down = (_at(posterior, mode * np.exp(sign * steps), inputs) for sign in (1, -1))
    with np.errstate(invalid="ignore"):
        slopes = {name: (np.log(up[name]) - np.log(down[name])) / (2 * STEP) for name in up}
    return {
        name: known.bound(slope) if np.isfinite(slope).all() else float("nan")
        for name, slope in slopes.items()
    }
