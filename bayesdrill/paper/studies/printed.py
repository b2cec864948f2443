"""What the paper prints: its tables as they stand, and what follows from them by arithmetic alone.

Sandoval, Cunha Jr and Sampaio (ENIEF 2013), Tables 1 to 3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from types import MappingProxyType

from bayesdrill.basics import symbols
from bayesdrill.insight import plausibility

START = MappingProxyType({"c_m": 1e-3, "k_e": 1e-2})  # of the two-parameter study


@dataclass(frozen=True, slots=True)
class Estimate:
    """As printed, digit by digit: an estimate (SI) and its deviation in per cent, without a sign."""

    text: str
    percent: str

    @property
    def value(self) -> float:
        return float(self.text)

    @property
    def deviation(self) -> float:
        return float(self.percent)


def half_digit(text: str) -> float:
    """Half a unit of the last digit of a number as printed: how far its rounding may have moved it."""
    exponent = Decimal(text).as_tuple().exponent
    assert isinstance(exponent, int)  # a number
    return float(Decimal(5).scaleb(exponent - 1))


# Table 2, by sigma_n.
TWO_PARAMETERS: Mapping[float, Mapping[str, Estimate]] = MappingProxyType(
    {
        0.001: {"c_m": Estimate("18.9e-5", "0.77"), "k_e": Estimate("601.6e-4", "0.0064")},
        0.01: {"c_m": Estimate("19.1e-5", "0.77"), "k_e": Estimate("601.6e-4", "0.0068")},
        0.1: {"c_m": Estimate("19.0e-5", "0.60"), "k_e": Estimate("601.6e-4", "0.0051")},
        1.0: {"c_m": Estimate("18.9e-5", "0.82"), "k_e": Estimate("601.9e-4", "0.0061")},
    }
)

# Table 3, in its order; its initial guesses are the nominal table `tables_2_3`.
NINE_PARAMETERS: Mapping[str, Estimate] = MappingProxyType(
    {
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
)

GUESS = symbols.NOMINAL["tables_2_3"].values
TABLE_1 = symbols.NOMINAL["table_1"].values
MENDED: Mapping[str, str] = MappingProxyType(
    {
        "k_s": "the guess of Table 3; the shaft's geometry supports it",
        "c_m": "the guess of Table 3, which the deviations of Table 2 refer to",
    }
)  # where Table 1 is not believed, and what is believed instead


@dataclass(frozen=True, slots=True, kw_only=True)
class Nominal:
    """A line of Table 1, SI: what it prints, what is the nominal value here, and why."""

    parameter: str
    unit: str
    printed: float
    nominal: float
    says: str


def table_1() -> tuple[Nominal, ...]:
    return tuple(
        Nominal(
            parameter=name,
            unit=symbols.PARAMETERS[name].plain_unit,
            printed=value,
            nominal=GUESS[name],
            says="" if value == GUESS[name] else MENDED[name],
        )
        for name, value in TABLE_1.items()
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Inconsistency:
    """`printed` and `implied`: two numbers of the paper for one thing; `says`: our reading."""

    what: str
    printed: float
    implied: float
    unit: str
    says: str


def inconsistencies() -> tuple[Inconsistency, ...]:
    """Those that numbers show; what is wrong with the matrix is in `models.as_printed`."""
    return (*_of_tables(), *_of_rig(), *_of_table_2(), *_of_table_3())


def _of_tables() -> list[Inconsistency]:
    found = []
    for name, reading in MENDED.items():
        found.append(
            Inconsistency(
                what=f"{name}: Table 1, and the initial guess of Table 3",
                printed=TABLE_1[name],
                implied=GUESS[name],
                unit=symbols.PARAMETERS[name].plain_unit,
                says=reading,
            )
        )
    return found


def _of_rig() -> list[Inconsistency]:
    stiffness, disc = (
        plausibility.GEOMETRY[role][0] for role in ("shaft.stiffness", "rotor.inertia")
    )
    modulus = plausibility.STEEL * TABLE_1["k_s"] / stiffness
    return [
        Inconsistency(
            what="k_s: Table 1, and G pi d^4/(32 L) of a steel shaft (G 79.3 GPa)",
            printed=TABLE_1["k_s"],
            implied=stiffness,
            unit="N m/rad",
            says=f"0.26; 0.30 would need a shear modulus of {modulus / 1e9:.1f} GPa",
        ),
        Inconsistency(
            what="j_1: Table 1, and m r^2/2 with 188 mm as the radius, as printed",
            printed=TABLE_1["j_1"],
            implied=4 * disc,
            unit="kg m^2",
            says=f"188 mm is the diameter, which gives {disc:.4f} kg m^2",
        ),
        Inconsistency(
            what="k_T: Table 1, and k_e, which it equals in SI units in an ideal motor",
            printed=TABLE_1["k_T"],
            implied=TABLE_1["k_e"],
            unit="N m/A",
            says=f"{TABLE_1['k_T'] / TABLE_1['k_e']:.3f} times as much mechanical power as the back-EMF "
            "takes from the current: k_T, k_e, v or i_m is not what it is said to be",
        ),
    ]


def _of_table_2() -> list[Inconsistency]:
    return [
        odd
        for sigma, row in TWO_PARAMETERS.items()
        for name, cell in row.items()
        if (odd := _odd(f"{name} in Table 2 at sigma_n {sigma:g}: deviation", name, cell))
    ]


def _of_table_3() -> list[Inconsistency]:
    return [
        odd
        for name, cell in NINE_PARAMETERS.items()
        if (odd := _odd(f"{name} in Table 3: deviation", name, cell))
    ]


def _odd(what: str, name: str, cell: Estimate) -> Inconsistency | None:
    """A printed deviation that the estimate printed beside it excludes, however they were rounded."""
    plain = 100 * abs(cell.value / GUESS[name] - 1)
    half, digit = 100 * half_digit(cell.text) / GUESS[name], half_digit(cell.percent)
    if plain - half <= cell.deviation + digit and cell.deviation - digit <= plain + half:
        return None
    return Inconsistency(
        what=what,
        printed=cell.deviation,
        implied=plain,
        unit="%",
        says=f"{cell.value:g} is {plain:.2g} % from {GUESS[name]:g}, give or take {half:.2g} for its "
        "rounding",
    )


def implied(name: str) -> float:
    """The estimate of Table 3 with the digits that its percentage has, SI."""
    return GUESS[name] * (1.0 + signed_deviation(name) / 100)


def signed_deviation(name: str) -> float:
    """That of Table 3 in per cent, with the sign that its estimate has."""
    cell = NINE_PARAMETERS[name]
    return math.copysign(cell.deviation, cell.value - GUESS[name])
