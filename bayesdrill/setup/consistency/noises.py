"""Noise of channels: entries that mean nothing, and the unknowns that it has."""

from __future__ import annotations

from bayesdrill.basics.entries import strange
from bayesdrill.basics.symbols import noise_name
from bayesdrill.inference.noise import NOISES
from bayesdrill.inference.unknowns import Unknown
from bayesdrill.rig.models.linear import Model
from bayesdrill.setup import build, missing_torque, number_entries
from bayesdrill.setup.config import Config
from bayesdrill.setup.experiment_entries import ChannelSpec


def in_vain(spec: ChannelSpec) -> dict[str, str]:
    """Entries that mean nothing to the kind of noise, and what to do about each."""
    kinds = {name: one.Entries for name, one in NOISES.usable().items()}
    if spec.noise.name not in kinds:
        return {}
    return strange(("name", "noise"), kinds, kinds[spec.noise.name], spec.noise)


def scatter(config: Config, model: Model) -> dict[str, Unknown | None]:
    """Unknowns of the noise by name.  Of a channel with a mistake, which is said elsewhere, only what is
    given, as None: what a kind has unless it is told otherwise may be what its entry was to hold.
    """
    found: dict[str, Unknown | None] = {}
    for name, spec in config.record.channels.items():
        if spec.derived_from is not None:
            continue
        own = _of_channel(name, spec, model)
        if own is not None:
            found |= own
        elif isinstance(spec.sigma, number_entries.PriorBase):
            found[noise_name(name)] = None
    return found | _of_torque(config)


def _of_torque(config: Config) -> dict[str, Unknown | None]:
    try:
        return {unknown.name: unknown for unknown in missing_torque.unknowns(config)}
    except ValueError:  # said of its entry
        return {}


def _of_channel(name: str, spec: ChannelSpec, model: Model) -> dict[str, Unknown | None] | None:
    """None where something is wrong with it."""
    if in_vain(spec):
        return None
    try:
        noise = build.noise([build.measured(name, spec, model.outer)], n_samples=1)
    except ValueError:
        return None
    return {unknown.name: unknown for unknown in noise.unknowns}
