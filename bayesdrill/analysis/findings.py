"""Findings on a rig, its values or its record, which `report.findings` puts into sentences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that looks wrong: its kind, and the names and numbers that its sentence has.

    kind: which sentence says it
    names: names, units and parts, by the places that they have in the sentence
    numbers: numbers, by the places that they have in the sentence
    """

    kind: str
    names: Mapping[str, str]
    numbers: Mapping[str, float] = field(default_factory=dict)
