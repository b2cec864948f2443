"""A rig by itself: nominal values of its parameters, and how it moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from bayesdrill.api import arguments
from bayesdrill.basics import symbols
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError, Issue, did_you_mean, shown
from bayesdrill.basics.formulas import linear_combination
from bayesdrill.basics.values import checked
from bayesdrill.inference import step_error
from bayesdrill.record.experiment import Channel, Experiment, frozen, raise_if_any
from bayesdrill.rig import models
from bayesdrill.rig.models.linear import Model, in_vain, lacking, with_named
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.sensors import Sensing

NUMBERS = "a number for each name"


@checked
def nominal(table: str = symbols.DEFAULT_NOMINAL) -> dict[str, float]:
    """The paper's values of all parameters, SI; raises `InputError` for a table it has not."""
    return dict(arguments.known(symbols.NOMINAL, table, "nominal", "nominal table").values)


@checked
def respond(
    rig: str | Model,
    parameters: Annotated[Mapping[str, float], NUMBERS],
    t: ArrayLike,
    inputs: Annotated[Mapping[str, ArrayLike], "their values"],
    signals: Sequence[str] | str,
    *,
    initial: Annotated[Mapping[str, float] | None, "a number for each state"] = None,
    hold: str = "zero",
) -> dict[str, Array]:
    """`signals` (states, or sums such as `theta_1 - theta_2`) at times `t (T,)`, exact, all in SI.

    Times increase, in any steps.  `inputs`: a number, or `(T,)` values between which they are held
    (`zero`) or straight (`first`); loads that are not named are zero.  The state is `initial` (else
    zero) at 0 s; with measured inputs at the first time.  To name a parameter that the rig only offers,
    such as `c_s`, is to switch it on.  Raises `InputError` with all that is wrong.
    """
    own, found = arguments.rig(rig), list[Issue]()
    own = with_named(own, parameters)
    found += [Issue(f"parameters.{n}", in_vain(n, of)) for n, of in lacking(own).items()]
    signals = [signals] if isinstance(signals, str) else signals
    times = arguments.times(t, found)
    values = _numbers(own.parameters, parameters, "parameters", found)
    at_rest = dict.fromkeys(own.states, 0.0)
    start = _numbers(own.states, at_rest | dict(initial or {}), "initial", found)
    idle: dict[str, ArrayLike] = {name: 0.0 for name in own.inputs if name == "t_1"}
    given: dict[str, Array] = {}
    for name, value in (idle | dict(inputs)).items():
        if arguments.is_series(value):
            given[name] = arguments.series(f"inputs.{name}", value, found)
        else:
            given[name] = np.array(arguments.number(f"inputs.{name}", value, found))
    _check_names(own.inputs, given, "inputs", found)
    if hold not in ("zero", "first"):
        found.append(Issue("hold", f"'{hold}' is neither zero nor first"))
    series = {name: one for name, one in given.items() if one.ndim}
    for name, one in series.items():
        if one.shape != times.shape or not np.isfinite(one).all():
            found.append(Issue(f"inputs.{name}", "give one number for each of the times"))
    if not signals:
        found.append(Issue("signals", "none is named; name a state, or a sum of states"))
    raise_if_any(found)
    experiment = Experiment(
        t=frozen(times),
        y=frozen(np.zeros((len(times), len(signals)))),
        channels=tuple(_channel(name, own) for name in signals),
        constant={name: float(one) for name, one in given.items() if not one.ndim},
        series={name: frozen(one) for name, one in series.items()},
        first_order=hold == "first",
        start=start,
        t_start=float(times[0]) if series else min(0.0, float(times[0])),
    )
    theta = np.array([[values[name] for name in own.parameters]])
    response = simulator(own, experiment, Sensing(), step_error.MAX_CHOSEN_PIECES).signals(theta)[0]
    return {name: response[:, k] for k, name in enumerate(signals)}


def _numbers(
    names: Sequence[str], values: Mapping[str, float], place: str, found: list[Issue]
) -> dict[str, float]:
    """One for each of `names`; parameters are as they may be held."""
    _check_names(names, values, place, found)
    read = {}
    for name in (name for name in names if name in values):
        symbol = models.PARAMETERS[name] if place == "parameters" else None
        positive = symbol is not None and symbol.held == "positive"
        read[name] = arguments.number(f"{place}.{name}", values[name], found, positive=positive)
        if symbol is not None and symbol.held == "not negative" and read[name] < 0:
            found.append(Issue(f"{place}.{name}", f"{shown(values[name])} is negative"))
        if symbol is not None and read[name] > symbol.at_most:
            message = f"{shown(values[name])} is more than {symbol.at_most:g}"
            found.append(Issue(f"{place}.{name}", message))
    return read


def _check_names(
    names: Sequence[str], values: Mapping[str, object], place: str, found: list[Issue]
) -> None:
    for name in values:
        if name not in names:
            found.append(Issue(f"{place}.{name}", f"the rig has none{did_you_mean(name, names)}"))
    found += [Issue(f"{place}.{name}", "is missing") for name in names if name not in values]


def _channel(name: str, rig: Model) -> Channel:
    try:
        weights = linear_combination(name, rig.states)
    except ValueError as error:
        raise InputError.one("signals", str(error)) from None
    unit = models.STATES[next(iter(weights))].unit
    return Channel(name=name, weights=weights, unit=unit, latex=name, latex_unit=unit)
