"""The registry of models: to add one, write its file and one line here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from bayesdrill.models.linear import Model
from bayesdrill.models.motor_shaft import MotorShaft

MODELS: Mapping[str, Callable[[float], Model]] = MappingProxyType({"motor_shaft": MotorShaft})
