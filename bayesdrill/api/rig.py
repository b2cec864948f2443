"""A rig by itself: nominal values of its parameters, and how it moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesdrill.basics import symbols
from bayesdrill.basics.errors import InputError, did_you_mean
from bayesdrill.basics.expressions import linear_combination
from bayesdrill.record.experiment import Channel, Experiment, frozen
from bayesdrill.rig.models import Rig
from bayesdrill.rig.response import Response

Array = NDArray[np.float64]


def nominal(table: str = symbols.DEFAULT_NOMINAL) -> dict[str, float]:
    """The paper's values of all parameters, SI; raises `InputError` for a table it has not."""
    if table not in symbols.NOMINAL:
        hint = did_you_mean(table, symbols.NOMINAL)
        raise InputError.one("nominal", f"'{table}' is not a nominal table{hint}")
    return dict(symbols.NOMINAL[table].values)


def respond(
    rig: Rig,
    parameters: Mapping[str, float],
    t: ArrayLike,
    inputs: Mapping[str, ArrayLike],
    signals: Sequence[str],
    *,
    initial: Mapping[str, float] | None = None,
    hold: str = "zero",
) -> dict[str, Array]:
    """`signals` (states, or sums such as `theta_1 - theta_2`) at times `t (T,)`, exact, all in SI.

    `inputs`: a number, or `(T,)` values between which they are held (`zero`) or straight (`first`).
    The state is `initial` (else zero) at 0 s; with measured inputs at the first time.
    Raises `InputError` for names that the rig has not.
    """
    times = np.array(t, dtype=np.float64)
    missing = [name for name in rig.parameters if name not in parameters]
    unknown = [
        name for name in {*inputs, *(initial or {})} if name not in {*rig.inputs, *rig.states}
    ]
    if missing or unknown:
        said = [f"{', '.join(missing)} missing"] if missing else []
        said += [f"'{name}' is neither input nor state of {rig.name}" for name in unknown]
        raise InputError.one("respond", "; ".join(said))
    given = {name: np.asarray(inputs.get(name, 0.0), dtype=np.float64) for name in rig.inputs}
    series = {name: frozen(values) for name, values in given.items() if values.ndim}
    wrong = [name for name, values in series.items() if values.shape != times.shape]
    if wrong:
        raise InputError.one("respond", f"{', '.join(wrong)}: one value for each of the times")
    experiment = Experiment(
        t=frozen(times),
        y=frozen(np.zeros((len(times), len(signals)))),
        channels=tuple(_channel(name, rig) for name in signals),
        constant={name: float(values) for name, values in given.items() if not values.ndim},
        series=series,
        first_order=hold == "first",
        start={name: float((initial or {}).get(name, 0.0)) for name in rig.states},
        t_start=float(times[0]) if series else min(0.0, float(times[0])),
    )
    theta = np.array([[parameters[name] for name in rig.parameters]])
    found = Response(rig, experiment).signals(theta)[0]
    return {name: found[:, k] for k, name in enumerate(signals)}


def _channel(name: str, rig: Rig) -> Channel:
    try:
        weights = linear_combination(name, rig.states)
    except ValueError as error:
        raise InputError.one("signals", str(error)) from None
    unit = symbols.STATES[next(iter(weights))].unit
    return Channel(name=name, weights=weights, unit=unit, latex=name, latex_unit=unit)
