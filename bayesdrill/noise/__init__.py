"""The registry of noise models: to add one, write its file and one line here."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from bayesdrill.noise.gaussian import Gaussian

NOISES: Mapping[str, type[Gaussian]] = MappingProxyType({"gaussian": Gaussian})
