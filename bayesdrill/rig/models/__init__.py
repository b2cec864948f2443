"""The registry of models: to add one, write its file and one line here.

The fields of a model are the constants that `model:` in a config may give (`config.ModelSpec`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType

from bayesdrill.rig.models.as_printed import AsPrinted
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.models.two_rotors import TwoRotors

Rig = MotorShaft | TwoRotors | AsPrinted
Kind = type[MotorShaft] | type[TwoRotors] | type[AsPrinted]

MODELS: Mapping[str, Kind] = MappingProxyType(
    {"motor_shaft": MotorShaft, "two_rotors": TwoRotors, "as_printed": AsPrinted}
)


def constants(kind: Kind) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(kind))
