"""Parts of configs that the puzzles share."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from benchmarks.zoo import entries
from benchmarks.zoo.row import Entry

Array = NDArray[np.float64]


def decades(low: float, high: float) -> Entry:
    """Uniform in the log, SI."""
    return {"prior": "log_uniform", "low": low, "high": high}


def between(low: float, high: float) -> Entry:
    """Uniform, SI."""
    return {"prior": "uniform", "low": low, "high": high}


def channel(name: str, unit: str, sigma: float | Entry, **more: object) -> Entry:
    return {name: {"column": name, "unit": unit, "sigma": sigma, **more}}


def measured(unit: str, column: str, hold: str = "zero", **more: object) -> Entry:
    return {"column": column, "unit": unit, "hold": hold, **more}


def driven(channels: Entry, parameters: Entry, inputs: Entry, **rest: object) -> Entry:
    """A rotor on a shaft whose upper end is moved."""
    return _entries({"name": "driven_shaft"}, channels, parameters, inputs, rest)


def alone(
    channels: Entry, parameters: Entry, inputs: Entry, i_m: float = 1.0, **rest: object
) -> Entry:
    """A motor alone."""
    return _entries({"name": "motor", "i_m": i_m}, channels, parameters, inputs, rest)


def _entries(model: Entry, channels: Entry, parameters: Entry, inputs: Entry, rest: Entry) -> Entry:
    return {
        "record": {"channels": channels, **rest.pop("record", {})},
        "inputs": inputs,
        "model": {**model, **rest.pop("model", {})},
        "parameters": parameters,
        **rest,
    }


def shaft(
    rig: str,
    i_m: float,
    values: Mapping[str, float],
    channels: Entry,
    inputs: Entry,
    unknown: Entry,
    **rest: object,
) -> Entry:
    """A motor, a shaft and a rotor: held at `values`, but for what is `unknown`."""
    made = _entries({"name": rig, "i_m": i_m}, channels, {**values, **unknown}, inputs, rest)
    truth = {n: values[n] for n in unknown if n in values}
    made["simulation"] = {**truth, **made.get("simulation", {})}
    return made


def square(t: Array, amplitude: float, period: float, offset: float = 0.0) -> Array:
    return offset + np.where(np.floor(2.0 * t / period + 1e-9) % 2 == 0, amplitude, -amplitude)


def sine(t: Array, amplitude: float, period: float, offset: float = 0.0) -> Array:
    return offset + amplitude * np.sin(2.0 * np.pi * t / period)


def repeated_bits(t: Array, amplitude: float, hold: float, bits: int, seed: int) -> Array:
    """Plus or minus `amplitude`, the same `bits` again and again."""
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], bits)
    return amplitude * signs[np.floor(t / hold + 1e-9).astype(np.intp) % bits]


PAPER, SERVO = entries.paper().values, entries.servo().values
