"""Define findings: data on what looks wrong; `report` turns them into sentences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Finding:
    """A finding is something that looks wrong in a rig, its parameters, a record or a chain.

    kind: the key of the sentence that describes it
    names: names, units and parts of the sentence, by placeholder
    numbers: numbers of the sentence, by placeholder
    rows: several numbers for each unknown or ensemble, by its name
    """

    kind: str
    names: Mapping[str, str] = field(default_factory=dict)
    numbers: Mapping[str, float] = field(default_factory=dict)
    rows: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
