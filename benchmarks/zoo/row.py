"""What a row of the zoo is: a config, how its record is made, and what is expected of a run."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bayesdrill.config.building.case import ResolvedCase

Array = NDArray[np.float64]
Entry = dict[str, Any]  # a part of a config, as YAML has it

MORE_THAN_NOISE = "larger than the noise"
RANKED = 180.0  # seconds that a run may take if it ranks the causes of a bad fit


class Maker(Protocol):
    """Where a record comes from."""

    @property
    def available(self) -> bool:
        """False where it needs a file that is not there."""
        ...

    def record(self, case: ResolvedCase, path: Path) -> str:
        """The text of the record, which the config of `case` names as `path`."""
        ...


class Humps(Protocol):
    """Places that fit."""

    @property
    def exact(self) -> tuple[float, ...]:
        """Shares of the posterior, on a grid."""
        ...

    def shares(self, draws: Mapping[str, Array]) -> tuple[float, ...]:
        """Of draws `(N,)` of each unknown, SI."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Two:
    """Parted at `split` of one unknown, `below` of the posterior in the lower one."""

    name: str
    split: float
    below: float

    @property
    def exact(self) -> tuple[float, ...]:
        return self.below, 1.0 - self.below

    def shares(self, draws: Mapping[str, Array]) -> tuple[float, ...]:
        below = float(np.mean(draws[self.name] < self.split))
        return below, 1.0 - below


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """`config` has all entries but name, seed and `record.file`; `shows` is a phrase.

    `reason`: what one of the reasons of an unsound row must say; None where a run is believed.
    `quick`: small enough for a first look.  `seconds`: that a run may take, if more than of others.
    """

    name: str
    shows: str
    config: Entry
    made: Maker
    reason: str | None = None
    quick: bool = False
    own_seed: int | None = None
    seconds: float = 0.0
    humps: Humps | None = None

    @property
    def sound(self) -> bool:
        return self.reason is None

    @property
    def fits(self) -> bool:
        """Whether the rig fits its record."""
        return self.reason != MORE_THAN_NOISE

    @property
    def seed(self) -> int:
        """By the name unless given, so that no two rows share their noise."""
        return zlib.crc32(self.name.encode()) % 100_000 if self.own_seed is None else self.own_seed
