"""Return nominal parameters of the paper's rig, and simulate any rig without a record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from bayesdrill.api import arguments
from bayesdrill.basics import symbols
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError, Issue, short_repr
from bayesdrill.basics.formulas import linear_combination
from bayesdrill.config.schema.vocabulary import idle_inputs
from bayesdrill.inference import step_error
from bayesdrill.record.experiment import (
    Channel,
    Experiment,
    channels_first,
    frozen,
    raise_if_any,
    with_states,
)
from bayesdrill.rig.models.linear import (
    Model,
    missing_requirements,
    requirement_text,
    weak_statics,
    with_named,
)
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.sensors import ObservationModel, signal_names, state_weights

NUMBERS = "a number for each name"


@arguments.check_arguments
def nominal(table: str = symbols.DEFAULT_NOMINAL) -> dict[str, float]:
    """Return the nominal values of all parameters of the paper's rig, in SI.

    Parameters
    ----------
    table : str
        `tables_2_3` or `table_1` of the paper (Sandoval, Cunha Jr and Sampaio, ENIEF 2013).

    Returns
    -------
    dict of str to float
        The value of each parameter, by name.

    Raises
    ------
    InputError
        If there is no such table.

    Examples
    --------
    >>> bd.nominal()["k_s"]  # N m/rad
    0.26
    """
    return dict(arguments.known(symbols.NOMINAL, table, "nominal", "nominal table"))


@arguments.check_arguments
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
    """Simulate the response of a rig; it is exact if the rig is linear (Van Loan 1978).

    Parameters
    ----------
    rig : str or Model
        The name of a rig, or a model such as `bd.MotorShaft(i_m=1 / 8)`.
    parameters : mapping of str to float
        The value of each parameter in SI.  The model has an optional parameter, such as `c_s`, only
        if the mapping names it.
    t : array_like, shape (T,)
        Increasing times in s; their spacing may vary.
    inputs : mapping of str to array_like, shape () or (T,)
        A constant or T samples of each input, in SI; loads that are not named are zero.
    signals : str or sequence of str
        The signals to return: states, or sums of states such as `"theta_1 - theta_2"`.
    initial : mapping of str to float, optional
        The states at 0 s or, if an input has samples, at `t[0]`; states not named are zero.
    hold : {"zero", "first"}
        Whether inputs are constant (`zero`) or linear (`first`) between samples.

    Returns
    -------
    dict of str to array, shape (T,)
        Each signal in SI, by name.

    Raises
    ------
    InputError
        With all mistakes in the arguments.

    Examples
    --------
    >>> t = np.linspace(0.0, 2.0, 401)
    >>> rig = bd.MotorShaft(i_m=1 / 8)
    >>> response = bd.respond(rig, bd.nominal(), t, {"v": 8.0}, ["w_1", "theta_1 - theta_2"])
    >>> response["w_1"].shape
    (401,)
    """
    model, issues = with_named(arguments.rig(rig), parameters), list[Issue]()
    missing = missing_requirements(model).items()
    issues += [Issue(f"parameters.{n}", requirement_text(n, of)) for n, of in missing]
    signals = [signals] if isinstance(signals, str) else signals
    times = arguments.times(t, issues)
    values = _parameters(model, parameters, issues)
    states = dict.fromkeys(model.states, 0.0) | dict(initial or {})
    arguments.check_names(model.states, states, "initial", "the rig", issues)
    start = {n: arguments.number(f"initial.{n}", states[n], issues) for n in model.states}
    idle: dict[str, ArrayLike] = dict.fromkeys(idle_inputs(model), 0.0)
    given: dict[str, Array] = {}
    for name, value in (idle | dict(inputs)).items():
        given[name] = arguments.number_or_series(f"inputs.{name}", value, issues)
    arguments.check_names(model.inputs, given, "inputs", "the rig", issues)
    if hold not in ("zero", "first"):
        issues.append(Issue("hold", f"'{hold}' is neither zero nor first"))
    series = {name: signal for name, signal in given.items() if signal.ndim}
    for name, signal in series.items():
        if signal.shape != times.shape or not np.isfinite(signal).all():
            issues.append(Issue(f"inputs.{name}", "give one finite number for each time"))
    if not signals:
        issues.append(Issue("signals", "no signal is named; name a state, or a sum of states"))
    raise_if_any(issues)
    experiment = Experiment(
        t=frozen(times),
        y=frozen(np.zeros((len(times), len(signals)))),
        channels=tuple(_channel(name, model) for name in signals),
        constant={name: float(value) for name, value in given.items() if not value.ndim},
        series={name: frozen(signal) for name, signal in series.items()},
        first_order=hold == "first",
        start=start,
        input_symbols={name: model.symbols[name] for name in model.inputs},
        t_start=float(times[0]) if series else min(0.0, float(times[0])),
    )
    theta = np.array([[values[name] for name in model.parameters]])
    shown = with_states(experiment, model.states, alone=True)
    response = simulator(model, shown, ObservationModel(), step_error.MAX_CHOSEN_PIECES)
    response_values = channels_first(experiment, model.states, response.signals(theta)[0])
    return {name: response_values[:, k] for k, name in enumerate(signals)}


def _parameters(rig: Model, values: Mapping[str, float], issues: list[Issue]) -> dict[str, float]:
    """Check and return the parameters of a rig; mistakes are added to `issues`."""
    arguments.check_names(rig.parameters, values, "parameters", "the rig", issues)
    read = {}
    for name in (name for name in rig.parameters if name in values):
        symbol, location = rig.symbols[name], f"parameters.{name}"
        positive = symbol.held == "positive"
        read[name] = arguments.number(location, values[name], issues, positive=positive)
        if symbol.held == "not negative" and read[name] < 0:
            issues.append(Issue(location, f"{short_repr(values[name])} is negative"))
        if read[name] > symbol.at_most:
            message = f"{short_repr(values[name])} is more than {symbol.at_most:g}"
            issues.append(Issue(location, message))
    issues += [Issue(f"parameters.{name}", why) for name, why in weak_statics(rig, read).items()]
    return read


def _channel(name: str, rig: Model) -> Channel:
    try:
        combines = linear_combination(name, (*signal_names(rig), *rig.inner))
    except ValueError as error:
        raise InputError.at("signals", str(error)) from None
    unit = rig.symbols[next(iter(combines))].unit
    weights = state_weights(rig, combines)
    return Channel(name=name, weights=weights, unit=unit, latex=name, latex_unit=unit)
