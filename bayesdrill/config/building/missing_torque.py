"""Build the missing torque, a Gaussian process: where it acts, its size, its correlation time."""

from __future__ import annotations

from collections.abc import Mapping

from bayesdrill.basics import symbols
from bayesdrill.basics.symbols import Symbol
from bayesdrill.config.building.parsed_numbers import number_in_si
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import IssueCollector
from bayesdrill.inference.unknowns import Unknown
from bayesdrill.rig.models.latent_torque import SIZE, TIME, MissingTorque, torque_gain
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.sensors import ObservationModel

TORQUE_ENTRIES: Mapping[str, str] = {SIZE: "size", TIME: "time"}


def check_torque(
    errors: IssueCollector, config: Config, model: Model, sensing: ObservationModel | None
) -> dict[str, float | Unknown | None]:
    """Check the missing torque of a config; return its size and correlation time."""
    acts = latent_torque(config)
    if acts is None:
        return {}
    if sensing is not None:
        errors.run(("missing_torque",), check_latent_torque, model, acts, sensing)
    return {
        name: errors.run(("missing_torque", entry), latent_torque_number, config, name)
        for name, entry in TORQUE_ENTRIES.items()
    }


def latent_torque(config: Config) -> MissingTorque | None:
    """Return the missing torque of a config; None without one."""
    spec = config.missing_torque
    return None if spec is None else MissingTorque(at=spec.at, smoothness=spec.smoothness)


def latent_torque_number(config: Config, name: str) -> float | Unknown:
    """Return the torque's size or correlation time; rigs in translation have a missing force."""
    rotary = all(symbol.unit != "m" for symbol in config.vocabulary.states.values())
    noun, unit = ("torque", "N*m") if rotary else ("force", "N")
    about = f"size of the missing {noun}: its standard deviation"
    symbol = Symbol(SIZE, unit, "s_d", symbols.latex_unit(unit), about)
    if name == TIME:
        about = f"correlation time of the missing {noun}"
        symbol = Symbol(TIME, "s", r"\tau_d", "s", about)
    spec = getattr(config.missing_torque, TORQUE_ENTRIES[name])
    value, begin = number_in_si(spec, 1.0, unit=symbol.plain_unit)
    if isinstance(value, float):
        return value
    return Unknown(symbol=symbol, role="noise", prior=value, start=begin)


def check_latent_torque(model: Model, acts: MissingTorque, sensing: ObservationModel) -> None:
    """Raise `ValueError` if no missing torque is possible for a rig with these sensors."""
    if unsupported := ", ".join([*sensing.gains, *sensing.lags]):
        refusal = f"a missing torque allows for no gain and no lag of a sensor ({unsupported})"
        raise ValueError(f"{refusal}; correct the file instead, or remove this entry")
    ones = dict.fromkeys(model.parameters, 1.0)
    torque_gain(model, acts, ones, model.linear(ones))
