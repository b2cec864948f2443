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

from bayesdrill.diagnostics import hdi
from bayesdrill.reproduction import printed

Array = NDArray[np.float64]

# The seven products that neither symmetry changes, and what follows from them.
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
J_2, R_S, I_M = 7.0e-3, 0.2, 1 / 8  # kg m^2, ohm


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """A product over its value at the initial guesses.

    `table_3`: of the printed estimates, `table_3_digits` of those with the digits of the percentages;
    `j_2`, `r_s`, `both`: of a rig with that missing; `k_T`: of one whose k_T equals k_e; the rest: of
    the record, by the heuristic and the posterior (median, and 94 % HDI of the logarithm).
    """

    product: str
    table_3: float
    table_3_digits: float
    j_2: float
    r_s: float
    both: float
    k_T: float
    heuristic: float
    posterior: float
    hdi_low: float
    hdi_high: float


def causes(
    names: tuple[str, ...], guess: Array, estimate: Array, draws: Array
) -> tuple[Cause, ...]:
    """From the initial guess, the heuristic's estimate `(D,)` and draws `(N, D)`, all of `names`."""
    found = []
    for product, powers in PRODUCTS.items():
        if not set(powers) <= set(names):
            continue
        exponents = np.array([powers.get(name, 0) for name in names], dtype=float)
        logs = np.log(draws / guess) @ exponents
        low, high = np.exp(hdi(logs))
        found.append(
            Cause(
                product=product,
                table_3=_of({n: e.value for n, e in printed.NINE_PARAMETERS.items()}, powers),
                table_3_digits=_of({n: printed.implied(n) for n in printed.GUESS}, powers),
                j_2=_of(with_missing(j_2=J_2, r_s=0.0), powers),
                r_s=_of(with_missing(j_2=0.0, r_s=R_S), powers),
                both=_of(with_missing(j_2=J_2, r_s=R_S), powers),
                heuristic=float(np.exp(np.log(estimate / guess) @ exponents)),
                k_T=_of({**printed.GUESS, "k_T": printed.GUESS["k_e"]}, powers),
                posterior=float(np.exp(np.median(logs))),
                hdi_low=float(low),
                hdi_high=float(high),
            )
        )
    return tuple(found)


def with_missing(*, j_2: float, r_s: float) -> dict[str, float]:
    """The nominal rig with these, as a rig of the paper's model."""
    guess = dict(printed.GUESS)
    return {**guess, "j_m": guess["j_m"] + I_M**2 * j_2, "r_m": guess["r_m"] + r_s}


def _of(values: Mapping[str, float], powers: Mapping[str, int]) -> float:
    """A product of `values` over that of the initial guesses."""
    return math.prod((values[n] / printed.GUESS[n]) ** e for n, e in powers.items())
