"""What a config says of a missing torque: where it acts, and what is believed of it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.noise.contract import Noise
from bayesdrill.inference.noise.shaken import ShakenObservation
from bayesdrill.inference.unknowns import Unknown
from bayesdrill.rig.filtered import Filtered, steps_of
from bayesdrill.rig.missing_torque import SIZE, TIME, MissingTorque, pushes
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.sensing import Sensing
from bayesdrill.rig.simulator import Simulator
from bayesdrill.setup.config import Config
from bayesdrill.setup.number_objects import prior, start

SYMBOLS = (
    Symbol(SIZE, "N*m", "s_d", r"N\,m", "size of the missing torque: its standard deviation"),
    Symbol(TIME, "s", r"\tau_d", "s", "time after which the missing torque is forgotten"),
)


ENTRIES: Mapping[str, str] = MappingProxyType({SIZE: "size", TIME: "time"})


def torque(config: Config) -> MissingTorque | None:
    given = config.missing_torque
    return None if given is None else MissingTorque(at=given.at, smoothness=given.smoothness)


def numbers(config: Config) -> dict[str, float | Unknown]:
    """Size and time; raises `ValueError`."""
    return {name: number(config, entry) for name, entry in ENTRIES.items()}


def number(config: Config, entry: str) -> float | Unknown:
    """One of them, `size` or `time`."""
    symbol = next(one for one in SYMBOLS if ENTRIES[one.name] == entry)
    spec = getattr(config.missing_torque, entry)
    if isinstance(spec, float | int):
        return float(spec)
    if spec.relative:
        raise ValueError(f"it has no nominal value; write its prior in {symbol.plain_unit}")
    built = prior(spec, 1.0)
    return Unknown(symbol=symbol, role="noise", prior=built, start=start(spec, built))


def unknowns(config: Config) -> tuple[Unknown, ...]:
    """Those of a config that has a missing torque; raises `ValueError`."""
    if config.missing_torque is None:
        return ()
    return tuple(one for one in numbers(config).values() if isinstance(one, Unknown))


def observation(config: Config, response: Simulator, noise: Noise, label: str = "") -> Observation:
    """With the missing torque that the config has; raises `ValueError` where it cannot be.

    Parameters and unknowns are called as in an experiment that has no others beside it.
    """
    acts, parameters = torque(config), response.parameters
    levels = [one.name for one in noise.unknowns]
    if acts is None:
        return Observation(
            response=response, noise=noise, parameters=parameters, levels=levels, label=label
        )
    if not noise.white:
        raise ValueError(
            "beside a missing torque the noise of every channel has to be white: they could hardly be "
            "told apart; remove `noise:` of the channels, or this entry"
        )
    if said := refusal(response.model, acts, response.sensing):
        raise ValueError(said)
    steps_of(response.experiment)
    return ShakenObservation(
        response=response,
        noise=noise,
        filtered=Filtered(response.model, acts, response.experiment),
        process=numbers(config),
        parameters=parameters,
        levels=[*levels, *(one.name for one in unknowns(config))],
        label=label,
    )


def refusal(model: Model, acts: MissingTorque, sensing: Sensing) -> str:
    """Why a rig can have no missing torque; empty where it can."""
    odd = [*sensing.gains, *sensing.lags]
    if odd:
        return (
            "a missing torque allows for no gain and no lag of a sensor "
            f"({', '.join(odd)}); mend the column, or remove this entry"
        )
    try:
        one = dict.fromkeys(model.parameters, 1.0)
        pushes(model, acts, one, model.linear(one))
    except ValueError as error:
        return str(error)
    return ""
