"""List what the paper prints, what follows from it, and what missing physics would do to it.

The tables are those of Sandoval, Cunha Jr and Sampaio (ENIEF 2013), Tables 1 to 3.

An inertia j_2 at the output of the gearbox and a resistance r_s in series make the rig another one
of the same model: with j_m + i_m^2 j_2 and r_m + r_s (`TwoRotors`).  So they move products
of the paper's parameters by factors known beforehand, and a fit of the paper's model finds those.

Torsion of the shaft as a continuum, which the paper proposes, beside the spring of its model.

    I rho theta_tt = G I theta_xx
    at x = 0: J_1 theta_tt = G I theta_x;  at x = L: J_2 theta_tt = -G I theta_x

with I = pi d^4/32, c^2 = G/rho, and a_n = J_n c w/(G I):
    (a_1 + a_2) cos(w L/c) + (1 - a_1 a_2) sin(w L/c) = 0.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

import numpy as np

from bayesdrill.analysis import SensitivityStudy, from_sensitivities, plausibility
from bayesdrill.basics import Array, symbols
from bayesdrill.inference import Posterior, derived, hdi
from bayesdrill.record import typical_inputs
from bayesdrill.rig import Model, MotorShaft, Named, TwoRotors

Row = Mapping[str, Any]  # a line of a table by the names of its columns; what is None is empty

TWO_UNKNOWNS = ("c_m", "k_e")  # of Table 2


@dataclass(frozen=True, slots=True)
class Estimate:
    """As printed, digit by digit: an estimate (SI) and its deviation in per cent, without a sign."""

    text: str
    percent: str

    @property
    def value(self) -> float:
        """The printed estimate, SI."""
        return float(self.text)

    @property
    def deviation(self) -> float:
        """The printed deviation in per cent."""
        return float(self.percent)


def half_digit(text: str) -> float:
    """Return half a unit of the last digit of a number as printed."""
    exponent = Decimal(text).as_tuple().exponent
    assert isinstance(exponent, int)  # a number
    return float(Decimal(5).scaleb(exponent - 1))


# Table 2, by sigma_n.
TWO_PARAMETERS: Mapping[float, Mapping[str, Estimate]] = {
    0.001: {"c_m": Estimate("18.9e-5", "0.77"), "k_e": Estimate("601.6e-4", "0.0064")},
    0.01: {"c_m": Estimate("19.1e-5", "0.77"), "k_e": Estimate("601.6e-4", "0.0068")},
    0.1: {"c_m": Estimate("19.0e-5", "0.60"), "k_e": Estimate("601.6e-4", "0.0051")},
    1.0: {"c_m": Estimate("18.9e-5", "0.82"), "k_e": Estimate("601.9e-4", "0.0061")},
}

# Table 3, in its order; its initial guesses are the nominal table `tables_2_3`.
NINE_PARAMETERS: Mapping[str, Estimate] = {
    "j_m": Estimate("5.0e-4", "28.0"),
    "c_m": Estimate("18.0e-5", "6.6"),
    "k_e": Estimate("587.7e-4", "2.3"),
    "k_T": Estimate("1.3e-1", "5.0"),
    "r_m": Estimate("5.3e-1", "60.0"),
    "l_m": Estimate("0.8e-3", "23.3"),
    "k_s": Estimate("2.7e-1", "3.0"),
    "j_1": Estimate("29.8e-3", "5.4"),
    "t_f": Estimate("1.0e-1", "0.0"),
}

GUESS = symbols.NOMINAL["tables_2_3"]
TABLE_1 = symbols.NOMINAL["table_1"]
MENDED: Mapping[str, str] = {
    "k_s": "the guess of Table 3; the shaft's geometry supports it",
    "c_m": "the guess of Table 3, which the deviations of Table 2 refer to",
}  # where Table 1 is not believed, and what is believed instead


def table_1() -> list[Row]:
    """Return the lines of Table 1, SI: what it prints, what is the nominal value here, and why."""
    return [
        {
            "parameter": name,
            "unit": symbols.PARAMETERS[name].plain_unit,
            "printed": value,
            "nominal": GUESS[name],
            "says": "" if value == GUESS[name] else MENDED[name],
        }
        for name, value in TABLE_1.items()
    ]


def inconsistencies() -> list[Row]:
    """Return what numbers contradict; what is wrong with the matrix is in `forward.AsPrinted`.

    `printed` and `implied`: two numbers of the paper for one thing; `says`: our reading.
    """
    of_tables = [
        {
            "what": f"{name}: Table 1, and the initial guess of Table 3",
            "printed": TABLE_1[name],
            "implied": GUESS[name],
            "unit": symbols.PARAMETERS[name].plain_unit,
            "says": reading,
        }
        for name, reading in MENDED.items()
    ]
    estimates = [
        (f"{name} in Table 2 at sigma_n {sigma:g}: deviation", name, cell)
        for sigma, row in TWO_PARAMETERS.items()
        for name, cell in row.items()
    ]
    estimates += [(f"{n} in Table 3: deviation", n, cell) for n, cell in NINE_PARAMETERS.items()]
    return [*of_tables, *_of_rig(), *filter(None, (_odd(*estimate) for estimate in estimates))]


def _of_rig() -> list[Row]:
    stiffness, disc = (plausibility.GEOMETRY[role][0] for role in ("shaft", "rotor_1"))
    modulus = plausibility.STEEL * TABLE_1["k_s"] / stiffness
    return [
        {
            "what": "k_s: Table 1, and G pi d^4/(32 L) of a steel shaft (G 79.3 GPa)",
            "printed": TABLE_1["k_s"],
            "implied": stiffness,
            "unit": "N m/rad",
            "says": f"0.26; 0.30 would need a shear modulus of {modulus / 1e9:.1f} GPa",
        },
        {
            "what": "j_1: Table 1, and m r^2/2 with 188 mm as the radius, as printed",
            "printed": TABLE_1["j_1"],
            "implied": 4 * disc,
            "unit": "kg m^2",
            "says": f"188 mm is the diameter, which gives {disc:.4f} kg m^2",
        },
        {
            "what": "k_T: Table 1, and k_e, which it equals in SI units in an ideal motor",
            "printed": TABLE_1["k_T"],
            "implied": TABLE_1["k_e"],
            "unit": "N m/A",
            "says": f"{TABLE_1['k_T'] / TABLE_1['k_e']:.3f} times as much mechanical power as the "
            "back-EMF takes from the current. So k_T, k_e, v or i_m is not what it is said to be",
        },
    ]


def _odd(what: str, name: str, cell: Estimate) -> Row | None:
    """A printed deviation that the estimate printed beside it excludes, however they were rounded."""
    plain = 100 * abs(cell.value / GUESS[name] - 1)
    half, digit = 100 * half_digit(cell.text) / GUESS[name], half_digit(cell.percent)
    if plain - half <= cell.deviation + digit and cell.deviation - digit <= plain + half:
        return None
    return {
        "what": what,
        "printed": cell.deviation,
        "implied": plain,
        "unit": "%",
        "says": f"{cell.value:g} is {plain:.2g} % from {GUESS[name]:g}, give or take {half:.2g} for "
        "its rounding",
    }


def implied(name: str) -> float:
    """Return the estimate of Table 3 with the digits that its percentage has, SI."""
    return GUESS[name] * (1.0 + signed_deviation(name) / 100)


def signed_deviation(name: str) -> float:
    """Return the deviation of Table 3 in per cent, with the sign that its estimate has."""
    cell = NINE_PARAMETERS[name]
    return math.copysign(cell.deviation, cell.value - GUESS[name])


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


def causes(posterior: Posterior, mode: Array, estimate: Array, draws: Array) -> list[Row]:
    """Compare quantities of the MAP, the heuristic's estimate `(D,)`, and draws `(N, D)`.

    Each is over its value at the initial guesses of the paper.  `table_3`: of the printed estimates,
    `table_3_digits` of those with the digits of the percentages; `j_2`, `r_s`, `both`: of a rig with
    that missing; `k_T`: of one whose k_T equals k_e; the rest: of the record, by the heuristic and
    the posterior (median, and 94 % HDI of the logarithm).  `alone`: Cramer-Rao bound of its log
    without any prior, at the MAP.  None where the config itself gives it.
    """
    inputs = typical_inputs(posterior.likelihood.only_observation.experiment)
    guess = quantities(MotorShaft(), GUESS, inputs, 1)
    rigs: dict[str, Mapping[str, float]] = {
        "table_3": {n: e.value for n, e in NINE_PARAMETERS.items()},
        "table_3_digits": {n: implied(n) for n in GUESS},
        "j_2": with_missing(j_2=J_2),
        "r_s": with_missing(r_s=R_S),
        "both": with_missing(j_2=J_2, r_s=R_S),
        "k_T": {**GUESS, "k_T": GUESS["k_e"]},
    }
    columns = {name: quantities(MotorShaft(), rig, inputs, 1) for name, rig in rigs.items()}
    columns["heuristic"] = _at(posterior, estimate[None], inputs)
    drawn = _at(posterior, draws, inputs)
    alone = _alone(posterior, mode, inputs)

    def cause(name: str, value: Array) -> Row:
        logs = np.log(drawn[name] / value)
        logs = logs[np.isfinite(logs)]
        there = np.ptp(logs) > GIVEN
        low, high = np.exp(hdi(logs)).tolist() if there else (None, None)
        return {
            "quantity": name,
            **{column: float((each[name] / value)[0]) for column, each in columns.items()},
            "posterior": float(np.exp(np.median(logs))) if there else None,
            "hdi94_low": low,
            "hdi94_high": high,
            "alone": alone[name] if there else None,
        }

    return [cause(name, value) for name, value in guess.items()]


def quantities(model: Model, p: Named, inputs: Mapping[str, float], n: int) -> dict[str, Array]:
    """Return quantities by name, each `(n,)`, SI; NaN where a draw has no such value."""
    values = {
        name: np.asarray(math.prod(np.asarray(p[q]) ** float(e) for q, e in powers.items()))
        for name, powers in PRODUCTS.items()
    }
    # With arrays, whatever is held: the poles are those of n rigs.
    rigs = {name: np.broadcast_to(np.asarray(p[name], dtype=float), n) for name in model.parameters}
    linear = model.linear(rigs)
    both = {**derived.poles(model, linear, n), **derived.steady_values(model, linear, n, inputs)}
    quantities = {**values, **{name: both[name] for name in FOLLOWING}}
    return {name: np.broadcast_to(x, n) for name, x in quantities.items()}


def with_missing(*, j_2: float = 0.0, r_s: float = 0.0) -> dict[str, float]:
    """Return the nominal rig with these, as a rig of the paper's model."""
    whole = TwoRotors(j_2=j_2, r_s=r_s).whole(GUESS)
    return {name: float(x) for name, x in whole.items()}


def _at(posterior: Posterior, theta: Array, inputs: Mapping[str, float]) -> dict[str, Array]:
    """At unknowns `(W, D)`."""
    model = posterior.likelihood.only_observation.response.model
    return quantities(model, posterior.space.named(theta), inputs, len(theta))


def _alone(posterior: Posterior, mode: Array, inputs: Mapping[str, float]) -> dict[str, float]:
    sensitivity = SensitivityStudy(posterior.likelihood)
    names = sensitivity.unknowns
    known = from_sensitivities(names, sensitivity.sensitivities(mode))
    steps = STEP * np.eye(len(names), len(mode))
    up, down = (_at(posterior, mode * np.exp(sign * steps), inputs) for sign in (1, -1))
    with np.errstate(invalid="ignore"):
        slopes = {name: (np.log(up[name]) - np.log(down[name])) / (2 * STEP) for name in up}
    return {
        name: known.bound(slope) if np.isfinite(slope).all() else float("nan")
        for name, slope in slopes.items()
    }


DENSITY = 7850.0  # kg/m^3, of steel; the paper gives none


def natural_frequencies(j_1: float, j_2: float, n: int) -> list[Row]:
    """Return the first `n` [Hz], with inertias `j_1` and `j_2` [kg m^2] at the ends of a free shaft.

    `lumped`: that of the spring.
    """
    from scipy.optimize import brentq

    area = math.pi * plausibility.SHAFT_DIAMETER**4 / 32
    speed = math.sqrt(plausibility.STEEL / DENSITY)
    stiffness = plausibility.STEEL * area / plausibility.SHAFT_LENGTH
    lumped = math.sqrt(stiffness * (1 / j_1 + 1 / j_2)) / (2 * math.pi)

    def residue(phase: float) -> float:
        """At w L/c = phase; a_n is then J_n phase over the inertia of the shaft itself."""
        inertia = DENSITY * area * plausibility.SHAFT_LENGTH
        a_1, a_2 = j_1 * phase / inertia, j_2 * phase / inertia
        return (a_1 + a_2) * math.cos(phase) + (1 - a_1 * a_2) * math.sin(phase)

    def tone(mode: int) -> Row:
        low, high = (mode - 1) * math.pi + 1e-9, mode * math.pi - 1e-9
        phase = brentq(residue, low, high, xtol=1e-15, rtol=1e-14)
        frequency = phase * speed / plausibility.SHAFT_LENGTH / (2 * math.pi)
        return {
            "mode": mode,
            "distributed": frequency,
            "lumped": lumped if mode == 1 else None,
        }

    return [tone(mode) for mode in range(1, n + 1)]
