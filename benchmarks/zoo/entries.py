"""Parts of configs that the rows share: rigs, channels, priors."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

from bayesdrill.basics import symbols
from bayesdrill.basics.symbols import NOMINAL
from benchmarks.zoo.row import Entry

RELATIVE = {"relative": True}
FOUR = ("theta_1", "theta_2", "w_1", "w_2")
TABLE = NOMINAL["tables_2_3"]


@dataclass(frozen=True, slots=True)
class Rig:
    """A gear and nominal values, SI."""

    i_m: float
    values: Mapping[str, float]

    def but(self, **values: float) -> Rig:
        return dataclasses.replace(self, values={**self.values, **values})

    def geared(self, i_m: float) -> Rig:
        return dataclasses.replace(self, i_m=i_m)


def paper() -> Rig:
    return Rig(1 / 8, dict(TABLE))


def reversing() -> Rig:
    """The same with hardly any dry friction, whose sign the rig does not change."""
    return paper().but(t_f=1e-3)


def servo() -> Rig:
    """A small motor that turns a light arm through a weak spring."""
    return Rig(
        1 / 14,
        {
            "j_m": 4.5e-6,
            "c_m": 2e-6,
            "k_e": 0.02,
            "k_T": 0.02,
            "r_m": 1.8,
            "l_m": 0.6e-3,
            "k_s": 0.9,
            "j_1": 2.4e-3,
            "t_f": 1e-4,
        },
    )


def small() -> Rig:
    """A rotor of half a gram cm^2 that swings at 50 Hz."""
    return Rig(
        1 / 4,
        {
            "j_m": 2e-8,
            "c_m": 2e-8,
            "k_e": 2e-3,
            "k_T": 2e-3,
            "r_m": 5.0,
            "l_m": 1e-3,
            "k_s": 0.05,
            "j_1": 5e-7,
            "t_f": 2e-5,
        },
    )


def large() -> Rig:
    """A rotor of two tonnes m^2 that takes a minute to swing once."""
    return Rig(
        1 / 10,
        {
            "j_m": 5.0,
            "c_m": 0.5,
            "k_e": 2.0,
            "k_T": 2.0,
            "r_m": 0.5,
            "l_m": 0.05,
            "k_s": 20.0,
            "j_1": 2000.0,
            "t_f": 5.0,
        },
    )


def experiment(
    rig: Rig,
    channels: Entry,
    parameters: Entry,
    *,
    v: float | Entry = 8.0,
    simulation: Entry | None = None,
    **rest: Entry,
) -> Entry:
    """A config without name, seed and file; `rest` are sections that most rows do not have."""
    inputs = {"v": v, **rest.pop("inputs", {})}
    model = {"name": "motor_shaft", "i_m": rig.i_m, **rest.pop("model", {})}
    own = {name: value for name, value in rig.values.items() if value != TABLE[name]}
    made = {"simulation": simulation} if simulation else {}
    return {
        "record": {"time": {"column": "t", "unit": "s"}, "channels": channels},
        "inputs": inputs,
        "model": model,
        "nominal": {"table": "tables_2_3", **own},
        "parameters": parameters,
        **rest,
        **made,
    }


def states(sigma: float | Entry, *names: str) -> Entry:
    """Channels that measure states in SI, all with the same noise."""
    return {name: channel(name, symbols.STATES[name].unit, sigma) for name in names or FOUR}


def channel(name: str, unit: str, sigma: float | Entry, measures: str | None = None) -> Entry:
    """Its column has its name."""
    said = {} if measures is None else {"measures": measures}
    return {"column": name, "unit": unit, **said, "sigma": sigma}


def in_degrees(sigma: float | Entry) -> Entry:
    """What a servo with a flexible link measures: the gear's angle, and the twist."""
    return {
        "theta_2": channel("theta_2", "deg", sigma),
        "twist": channel("twist", "deg", sigma, "theta_1 - theta_2"),
    }


def measured(name: str, hold: str = "zero") -> Entry:
    """An input from the record."""
    return {"column": name, "unit": symbols.INPUTS[name].unit, "hold": hold}


def parameters(rest: str | Entry, **own: float | str | Entry) -> Entry:
    """All nine, `rest` for those that are not named, and what else is."""
    return {**dict.fromkeys(symbols.NOMINAL[symbols.DEFAULT_NOMINAL], rest), **own}


def box(low: float = 0.5, high: float = 1.5) -> Entry:
    """Uniform, in nominal values."""
    return {"prior": "uniform", "low": low, "high": high, **RELATIVE}


def decades(low: float, high: float) -> Entry:
    """Uniform in the log, in nominal values."""
    return {"prior": "log_uniform", "low": low, "high": high, **RELATIVE}


def half_normal(scale: float) -> Entry:
    """In nominal values."""
    return {"prior": "half_normal", "scale": scale, **RELATIVE}


def unknown(low: float, high: float) -> Entry:
    """A noise level, in the unit of its column."""
    return {"prior": "log_uniform", "low": low, "high": high}


def noise(level: float, *names: str) -> Entry:
    """True levels of unknown noise."""
    return dict.fromkeys(names or FOUR, level)
