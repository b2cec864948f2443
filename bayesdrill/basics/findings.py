"""Record what looks wrong with a rig, its values, a record or its chains, without sentences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Finding:
    """A finding is something that looks wrong, with the names and numbers for its sentence.

    kind: the key of its sentence
    names: names, units and parts, by their placeholders in the sentence
    numbers: numbers, by their placeholders in the sentence
    rows: several numbers of each unknown, or of each ensemble
    """

    kind: str
    names: Mapping[str, str] = field(default_factory=dict)
    numbers: Mapping[str, float] = field(default_factory=dict)
    rows: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
