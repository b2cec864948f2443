"""Make cases from arrays, without any file."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from numpy.typing import ArrayLike

from bayesdrill.api import arguments
from bayesdrill.api.case import Case
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.equality import Value
from bayesdrill.basics.errors import InputError, Issue, count_noun
from bayesdrill.config import job
from bayesdrill.record.experiment import raise_if_any
from bayesdrill.rig.models.linear import Model

CHANNELS = "a bd.Channel(values, unit, sigma) for each name"
INPUTS = "a number in SI or a bd.Input(values, unit) for each name"
PRIORS = "a prior, a number or 'nominal' for each name"


@dataclass(frozen=True, slots=True, eq=False)
class Channel(Value):
    """A channel is a measured signal of the rig; `bd.case` checks its entries.

    Parameters
    ----------
    values : array_like, shape (T,)
        The samples in `unit`, at the times of the case; NaN where a sample is missing.
    unit : str
        The unit, such as `"rpm"`.
    sigma : float or mapping
        The standard deviation of the noise in `unit`, or its prior, written as in a config.
    measures : str, optional
        A state or a sum of states, such as `"theta_1 - theta_2"`; by default the channel's name.
    noise : str or mapping, optional
        The kind of noise, or its entries, written as in a config; by default white.
    gain, offset, lag : float or mapping, optional
        Errors of the sensor: a factor, an offset in `unit` and a lag in s, as numbers or priors.

    Examples
    --------
    >>> channel = bd.Channel([0.0, 1.5, 2.9], "deg", sigma=0.5, measures="theta_1 - theta_2")
    >>> channel.unit
    'deg'
    """

    values: ArrayLike
    unit: str
    sigma: float | Mapping[str, Any]
    measures: str | None = None
    noise: str | Mapping[str, Any] | None = None
    gain: float | Mapping[str, Any] | None = None
    offset: float | Mapping[str, Any] | None = None
    lag: float | Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Input(Value):
    """An input is a measured signal that drives the rig; `bd.case` checks its entries.

    Parameters
    ----------
    values : array_like, shape (T,)
        The samples in `unit`, at the times of the case.
    unit : str
        The unit, such as `"V"`.
    hold : {"zero", "first"}, optional
        How the input continues between samples: constant (zero-order hold) or linear (first-order
        hold).  By default, angles are linear between samples, and all other inputs constant.
    gain, offset, lag : float or mapping, optional
        Errors of the sensor, see `Channel`.

    Examples
    --------
    >>> bd.Input([0.0, 8.0, 8.0], "V").hold is None
    True
    """

    values: ArrayLike
    unit: str
    hold: str | None = None
    gain: float | Mapping[str, Any] | None = None
    offset: float | Mapping[str, Any] | None = None
    lag: float | Mapping[str, Any] | None = None


@arguments.check_arguments
def case(
    t: ArrayLike,
    channels: Annotated[Mapping[str, Channel], CHANNELS],
    inputs: Annotated[Mapping[str, Input | float], INPUTS],
    parameters: Annotated[Mapping[str, Any], PRIORS],
    *,
    rig: str | Model = "motor_shaft",
    nominal: Any = None,
    seed: int = 0,
    name: str = "case",
    **entries: Any,
) -> Case:
    """Make a case from arrays, without any file.

    The rig starts at rest, at 0 s or, if an input is measured, at the first sample.  The section
    `initial={"w_1": ...}` sets another start state.

    Parameters
    ----------
    t : array_like, shape (T,)
        Increasing times in s.
    channels : mapping of str to Channel
        The measured channels.
    inputs : mapping of str to Input or float
        For each input of the rig, measured values, or a constant value in SI.
    parameters : mapping of str to prior, float or "nominal"
        For each parameter of the rig, a prior, such as `{"prior": "uniform", "low": 0.1, "high":
        1.0}`, a fixed value in SI, or `"nominal"` for its nominal value.  The model has an
        optional parameter of the rig, such as `c_s`, only if the mapping names it.
    rig : str or Model
        The name of a rig, or a model such as `bd.MotorShaft(i_m=1 / 8)`.
    nominal : str or mapping of str to float, optional
        The nominal values: the name of a table, or values in SI.  By default, they come from the
        table `"tables_2_3"` if a parameter is `"nominal"`.
    seed : int
        The integer seed from which all random streams are derived.
    name : str
        The name of the case in reports.
    **entries
        Other sections of a config (see `docs/config.md`), such as `sampler={"ess": 1000}` or
        `record={"missing": "drop"}`.

    Returns
    -------
    Case
        The case; see `bd.Case` for an example.

    Raises
    ------
    InputError
        With all mistakes in the arguments.
    """
    columns, measured = _columns(t, channels, inputs)
    record = entries.pop("record", {})
    if not isinstance(record, Mapping):
        message = f"give entries, such as a window, not {type(record).__name__}"
        raise InputError.at("record", message)
    refused = ["model"] if "model" in entries else []
    given_by_arrays = ("file", "format", "time", "channels")
    refused += [f"record.{name}" for name in given_by_arrays if name in record]
    if refused:
        raise InputError.at(refused[0], "arrays and `rig` give this already; leave it out")
    model = arguments.rig(rig)
    priors = dict(parameters)
    missing = [name for name in model.added if name not in priors]
    raise_if_any([Issue(f"parameters.{n}", f"is missing; give {PRIORS}") for n in missing])
    given = {
        "name": name,
        "seed": seed,
        "record": {
            **record,
            "channels": {key: _entry(key, channel) for key, channel in channels.items()},
        },
        "inputs": {**inputs, **{key: _entry(key, column) for key, column in measured.items()}},
        "model": job.model_entry(model),
        "parameters": priors,
        **({} if nominal is None else {"nominal": nominal}),
        **entries,
    }
    return Case(job.job_in_memory(columns, given), columns)


def _columns(
    t: ArrayLike, channels: Mapping[str, Channel], inputs: Mapping[str, Input | float]
) -> tuple[dict[str, Array], dict[str, Input]]:
    """Return the columns `(T,)` of the times, channels and inputs, and the specs of the inputs."""
    issues: list[Issue] = []
    columns: dict[str, Array] = {job.TIME_COLUMN: arguments.series("t", t, issues)}
    for name, channel in channels.items():
        if isinstance(channel, Channel):
            columns[name] = arguments.series(f"channels.{name}", channel.values, issues)
        else:
            text = f"give {CHANNELS}, not {type(channel).__name__}"
            issues.append(Issue(f"channels.{name}", text))
    measured = {}
    for name, given in inputs.items():
        if isinstance(given, Input) and name in channels:
            text = "an input has this name; give the channel another name, with `measures`"
            issues.append(Issue(f"channels.{name}", text))
        elif isinstance(given, Input):
            measured[name] = given
            columns[name] = arguments.series(f"inputs.{name}", given.values, issues)
        elif not isinstance(given, Mapping):
            arguments.number(f"inputs.{name}", given, issues)
    if not issues and not channels:
        issues.append(Issue("channels", f"nothing is measured; give {CHANNELS}"))
    lengths = {name: len(values) for name, values in columns.items()}
    if not issues:
        issues += [
            Issue(name, f"{count_noun(n, 'value')}, but there are {lengths[job.TIME_COLUMN]} times")
            for name, n in lengths.items()
            if n != lengths[job.TIME_COLUMN]
        ]
    hints = {"inputs": f"; give {INPUTS}"}
    raise_if_any([Issue(i.place, i.message + hints.get(i.place.split(".")[0], "")) for i in issues])
    return columns, measured


def _entry(column: str, spec: Channel | Input) -> dict[str, Any]:
    """Return the config entry of a channel or an input with its samples in `column`."""
    fields = {f.name: getattr(spec, f.name) for f in dataclasses.fields(spec) if f.name != "values"}
    return {"column": column, **{key: value for key, value in fields.items() if value is not None}}
