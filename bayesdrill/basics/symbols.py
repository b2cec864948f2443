"""Define the symbols with their meanings, units and LaTeX, and tables of nominal values.

The first nine parameters are those of the paper (Sandoval, Cunha Jr and Sampaio, ENIEF 2013, Table
1); all others describe further physics.  Note that `t_f` is a torque, whereas `t` is time.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Literal

# The unit of a speed for each unit of the coordinate.
SPEED_UNITS: Mapping[str, str] = MappingProxyType({"rad": "rad/s", "m": "m/s"})


@dataclass(frozen=True, slots=True)
class Symbol:
    """A symbol has a name, an SI unit in pint's notation, a meaning, and LaTeX for name and unit.

    `held` is the range of values at which a parameter may be fixed. An unknown parameter must be
    positive unless `held` is "any". `at_most` is the upper bound of values.  `typical` quotes SI
    values of known rigs with their sources. `drives` marks an input that moves the rig.
    """

    name: str
    unit: str
    latex: str
    latex_unit: str
    meaning: str
    held: Literal["positive", "not negative", "any"] = "positive"
    at_most: float = math.inf
    typical: str = ""
    drives: bool = field(default=False, repr=False)  # not in `repr`, as fingerprints of runs use it

    @property
    def signed(self) -> bool:
        """Return whether a parameter may be negative if it is unknown."""
        return self.held == "any"

    @property
    def plain_unit(self) -> str:
        """Return the unit for tables and sentences, such as `kg m^2`."""
        return plain(self.unit)


def plain(unit: str) -> str:
    """Convert a unit from pint's notation to plain text: `kg*m**2` to `kg m^2`."""
    return unit.replace("**", "^").replace("*", " ")


def fraction(above: Sequence[str], below: Sequence[str], times: str) -> str:
    """Return a quotient of two products as text, `a b/(c d)`; `times` separates factors."""
    over = times.join(above)
    if not below:
        return over
    under = times.join(below)
    return f"{over or '1'}/{under if len(below) == 1 else f'({under})'}"


def unit_product(units: Sequence[str], exponents: Sequence[int]) -> str:
    """Return the product of powers of units in pint's notation, such as `(N*m/rad)*(H)**2`."""
    powers = [(unit, e) for unit, e in zip(units, exponents, strict=False) if e]
    if len(powers) == 1 and powers[0][1] == 1:
        return powers[0][0]
    return "*".join(f"({unit})" + (f"**{e}" if e != 1 else "") for unit, e in powers)


def product_latex(exponents: Sequence[int], symbols: Sequence[Symbol]) -> str:
    r"""Return the LaTeX of a product of powers, without dollar signs: `k_T/(r_m\,k_s)`."""
    above, below = (
        [
            superscript(symbol.latex, str(sign * e)) if sign * e > 1 else symbol.latex
            for symbol, e in zip(symbols, exponents, strict=False)
            if sign * e > 0
        ]
        for sign in (1, -1)
    )
    return fraction(above, below, r"\,")


def superscript(latex: str, index: str) -> str:
    """Return `latex` with an exponent; `{}` keeps TeX from dropping the braces around an accent."""
    return (f"{{{{}}{latex}}}" if {"^", "'"} & {*latex} else latex) + f"^{{{index}}}"


_SIGNS = {  # special characters in units, and their LaTeX
    **dict.fromkeys("\u00b7\u22c5", "*"),
    **dict.fromkeys("\u00b5\u03bc", r"{\mu}"),
    **dict.fromkeys("\u03a9", r"{\Omega}"),
    "\u00b0": r"{{}^{\circ}}",
    **{chr(raised): f"**{digit}" for digit, raised in zip("23", (0xB2, 0xB3), strict=True)},
}


def latex_unit(unit: str) -> str:
    r"""Convert a unit from pint's notation to LaTeX without dollar signs: `mN*m` to `mN\,m`.

    Raises `ValueError` for letters that the fonts for formulas do not have.
    """
    if unit in ("1", ""):
        return ""
    for sign, latex in _SIGNS.items():
        unit = unit.replace(sign, latex)
    if not unit.isascii():
        raise ValueError(f"unit '{unit}' has letters that formulas do not have")
    # Even items are products of names, and odd items are the powers after them.
    parts = re.split(r"(?:\*\*|\^)\s*\(?\s*(-?[\d.]+)\s*\)?", unit.strip())
    shown = [
        re.sub(r"\s*\*\s*|(?<=\w)\s+(?=\w)", r"\\,", re.sub(r"([%#&_$])", r"\\\1", part))
        for part in parts[::2]
    ]
    powers = [f"^{{{power}}}" for power in parts[1::2]]
    joined = "".join(a + b for a, b in zip(shown, [*powers, ""], strict=True))
    return re.sub(r"\bohms?\b", r"\\Omega", joined).replace(" ", "")


def _symbol(name: str, unit: str, latex: str, meaning: str) -> Symbol:
    unit_in_formulas = latex_unit(unit).replace("^{2}", "^2")
    return Symbol(name, unit, latex, unit_in_formulas, meaning, typical=_TYPICAL.get(name, ""))


def _or_zero(name: str, unit: str, latex: str, meaning: str) -> Symbol:
    return replace(_symbol(name, unit, latex, meaning), held="not negative")


def _drive(name: str, unit: str, latex: str, meaning: str) -> Symbol:
    return replace(_symbol(name, unit, latex, meaning), drives=True)


def _table(*rows: Symbol) -> Mapping[str, Symbol]:
    return MappingProxyType({row.name: row for row in rows})


_UFRJ = "a drill-string rig (Real, Lobo, Ritto, Pinto, JPSE 170, 2018)"
_TYPICAL = {
    "c_s": f"0.017 fits {_UFRJ}, whose shaft has 4.1 N m/rad",
    "j_2": "7e-3 behind a gear of 8:1 raises j_m from the paper's guess to its estimate",
    "r_s": "0.2 raises r_m from the paper's guess to its estimate",
    "t_cm": "0.1 is the paper's t_f; 7e-4 fits a small servo with a flexible link",
    "t_c1": f"1.3 to 2.2 is the torque at the bit of {_UFRJ} at 12 to 15 rad/s",
    "v_d": "3.7 is that of an L298 driver at 2 A, by its data sheet",
    "eta": "0.87 is that of a small spur gearbox of 6.3:1, 0.9 of each mesh (Machine Design, A "
    "second look at gearbox efficiencies)",
    "j_s": "1.5e-7 is that of the paper's shaft, of steel",
    "b_0": "0.024 of a full-scale bit (a code of LAVI, COPPE/UFRJ)",
}

PARAMETERS = _table(
    _symbol("j_m", "kg*m**2", "j_m", "moment of inertia of the motor"),
    # Damping and friction of a motor may be zero; t_f is negative if the motor turns backwards.
    _or_zero("c_m", "N*m*s/rad", "c_m", "internal damping of the motor"),
    _symbol("k_e", "V*s/rad", "k_e", "voltage constant of the motor"),
    _symbol("k_T", "N*m/A", "k_T", "torque constant of the motor"),
    _symbol("r_m", "ohm", "r_m", "internal resistance of the motor"),
    _symbol("l_m", "H", "l_m", "internal inductance of the motor"),
    _symbol("k_s", "N*m/rad", "k_s", "torsional stiffness of the shaft"),
    _symbol("j_1", "kg*m**2", "j_1", "moment of inertia of rotor 1"),
    replace(
        _symbol("t_f", "N*m", "t_f", "torque of the motor's internal friction (not a time)"),
        held="any",
    ),
    # Optional parameters: a rig has only those that its config names.
    _or_zero("c_s", "N*m*s/rad", "c_s", "damping of the shaft"),
    _or_zero("j_2", "kg*m**2", "j_2", "moment of inertia at the output of the gearbox"),
    _or_zero("r_s", "ohm", "r_s", "resistance in series with the motor"),
    _or_zero("c_1", "N*m*s/rad", "c_1", "viscous damping at rotor 1"),
    _or_zero("t_cm", "N*m", "t_{cm}", "sliding friction at the motor, which changes its sign"),
    _or_zero("t_sm", "N*m", "t_{sm}", "static friction at the motor"),
    _symbol("w_sm", "rad/s", "w_{sm}", "speed scale of the decay of static friction at the motor"),
    _or_zero("t_c1", "N*m", "t_{c1}", "sliding friction at rotor 1"),
    _or_zero("t_s1", "N*m", "t_{s1}", "static friction at rotor 1"),
    _symbol("w_s1", "rad/s", "w_{s1}", "speed scale of the decay of static friction at rotor 1"),
    _or_zero(
        "v_d", "V", "v_d", "voltage that driver and brushes take, against the sign of the current"
    ),
    replace(_symbol("eta", "1", r"\eta", "efficiency of the gear"), at_most=1.0),
    _or_zero("d_m", "N*m*s**2/rad**2", "d_m", "quadratic drag at the motor"),
    _or_zero("d_1", "N*m*s**2/rad**2", "d_1", "quadratic drag at rotor 1"),
    _symbol("k_0", "N*m/rad", "k_0", "torsional stiffness between rotor 1 and rotor 0"),
    _symbol("j_0", "kg*m**2", "j_0", "moment of inertia of rotor 0, beyond rotor 1"),
    _or_zero("c_0", "N*m*s/rad", "c_0", "damping between rotor 1 and rotor 0"),
    _symbol("j_s", "kg*m**2", "j_s", "moment of inertia of the shaft itself"),
    # Parameters of a drill bit that cuts rock under a weight.
    _symbol("b_0", "m", "b_0", "torque at the bit over the weight on it, at high speed"),
    _symbol("b_1", "s/rad", "b_1", "how steeply the torque at the bit begins with its speed"),
    _or_zero("b_2", "s/rad", "b_2", "how high the hump of the torque at the bit is at low speed"),
    _symbol("b_3", "s**2/rad**2", "b_3", "how soon that hump ends"),
)

STATES = _table(
    _symbol("theta_1", "rad", r"\theta_1", "angle of rotor 1, at the far end of the shaft"),
    _symbol("theta_2", "rad", r"\theta_2", "angle of the shaft at the gearbox"),
    _symbol("w_1", "rad/s", r"\dot\theta_1", "speed of rotor 1"),
    _symbol("w_2", "rad/s", r"\dot\theta_2", "speed of the shaft at the gearbox"),
    _symbol("i", "A", r"\dot q", "motor current"),
    _symbol("theta_0", "rad", r"\theta_0", "angle of rotor 0, beyond rotor 1"),
    _symbol("w_0", "rad/s", r"\dot\theta_0", "speed of rotor 0"),
)

INPUTS = _table(
    _drive("v", "V", "v", "voltage supplied to the motor"),
    _symbol("t_1", "N*m", "t_1", "friction torque on rotor 1 (load)"),
    # Inputs of rigs that a speed or a torque drives, and of rigs with a bit.
    _drive("w_2", "rad/s", r"\dot\theta_2", "speed imposed on the shaft at the gearbox"),
    _drive("t_m", "N*m", "t_m", "torque that the motor is driven with (motor side)"),
    _symbol("wob", "N", "W", "weight on the bit"),
)

# Quantities that are computed from the parameters of each draw (`inference.derived`).
DERIVED = _table(
    _symbol("omega_n", "rad/s", r"\omega_n", "natural frequency of the oscillating pair"),
    _symbol("zeta", "1", r"\zeta", "damping ratio of the oscillating pair"),
    _symbol("tau_e", "s", r"\tau_e", "shortest time constant: that of the current"),
    _symbol("tau_m", "s", r"\tau_m", "longest time constant that does not oscillate: the motor's"),
    _symbol("w_end", "rad/s", r"\dot\theta_\infty", "steady speed at the usual inputs"),
    _symbol("i_end", "A", r"\dot q_\infty", "steady current at the usual inputs"),
)

# Names of axes in `posterior.nc`; quantities must not have these names.
AXES = frozenset({"chain", "draw", "time"})


# Initial guesses of Table 3, from which Tables 2 and 3 give deviations.  The geometry of the shaft
# agrees with k_s: pi G d^4 / (32 L) = 0.263 N m/rad.
_TABLES_2_3 = {
    "j_m": 4.0e-4,
    "c_m": 19.0e-5,
    "k_e": 601.6e-4,
    "k_T": 1.2e-1,
    "r_m": 3.3e-1,
    "l_m": 1.1e-3,
    "k_s": 2.6e-1,
    "j_1": 28.3e-3,
    "t_f": 1.0e-1,
}
# Table 1 as printed; its k_s and c_m contradict Tables 2 and 3.
_TABLE_1 = {**_TABLES_2_3, "k_s": 3.0e-1, "c_m": 18.0e-5}
# Nominal values of the nine parameters in SI, by the name of the table.
NOMINAL: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {"tables_2_3": MappingProxyType(_TABLES_2_3), "table_1": MappingProxyType(_TABLE_1)}
)

DEFAULT_NOMINAL = "tables_2_3"


_GREEK = re.compile(
    "alpha|beta|gamma|delta|epsilon|zeta|eta|theta|kappa|lambda|mu|nu|xi|rho|sigma|tau|phi|chi|psi|"
    "omega|Gamma|Delta|Theta|Lambda|Xi|Pi|Sigma|Phi|Psi|Omega"
)


def own_symbol(name: str, unit: str, latex: str | None, meaning: str) -> Symbol:
    """Return a symbol for a name in a config; `omega_1` becomes a Greek letter with index 1."""
    head, _, index = name.partition("_")
    shown = (
        rf"\{head}" if _GREEK.fullmatch(head) else head if len(head) == 1 else rf"\mathrm{{{head}}}"
    )
    if index:
        plain = index.replace("_", ",")
        shown += rf"_{{{plain}}}" if len(plain) == 1 else rf"_{{\mathrm{{{plain}}}}}"
    return Symbol(name, unit, latex or shown, latex_unit(unit), meaning)


def noise_name(channel: str) -> str:
    """Return the name of the unknown standard deviation of a channel's noise."""
    return f"sigma_{channel}"


def noise_symbol(channel: str, unit: str, latex: str, latex_unit: str) -> Symbol:
    """Return the symbol of the standard deviation of a channel's noise, named `sigma_<channel>`."""
    return Symbol(
        noise_name(channel),
        unit,
        rf"\sigma_{{{latex}}}",
        latex_unit,
        f"noise sd of channel {channel}",
    )
