"""Write the JSON schema of a config, with which editors complete and check configs.

Names that only a described rig has, such as `j_load`, are checked by their form alone, and only beside
such a `model:`. The schema lists all other names.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from bayesdrill.config.schema.config import HOUSE_CONFIG
from bayesdrill.config.schema.vocabulary import HOUSE, described_rigs

ABOUT = ("description", "default", "title")
NAME_OF_PART = "^[A-Za-z]+(_[A-Za-z0-9]+)+$"  # a letter for the quantity, and the name of a part

# Path of each section that has names of the rig, by its definition in the schema.
SECTIONS: Mapping[str, tuple[str, ...]] = {
    "Parameters": ("parameters",),
    "Nominal": ("nominal",),
    "Tolerances": ("nominal", "tolerance"),
    "Simulation": ("simulation",),
    "Inputs": ("inputs",),
    "Initial": ("initial",),
}


def json_schema() -> str:
    """Return the JSON schema of a config as text."""
    schema = HOUSE_CONFIG.model_json_schema()
    defs = schema["$defs"]
    known: dict[str, Any] = {}
    # Names with the least restricted entries: numbers that may be negative, and driving inputs.
    free_names = {name for name, symbol in HOUSE.parameters.items() if symbol.held == "any"}
    free_names |= {*HOUSE.inputs, *HOUSE.starts} - {*HOUSE.idle}
    for kind, place in SECTIONS.items():
        entries = defs[kind]["properties"]
        _nested(known, place)["propertyNames"] = {"enum": [*entries]}
        free = next(entry for name, entry in entries.items() if name in free_names)
        plain = {key: value for key, value in free.items() if key not in ABOUT}
        defs[kind]["patternProperties"] = {NAME_OF_PART: plain}
    at = defs["MissingTorqueSpec"]["properties"]["at"]
    _nested(known, ("missing_torque", "at"))["enum"] = at.pop("enum")
    described = {"properties": {"name": {"enum": described_rigs()}}, "required": ["name"]}
    schema["if"] = {"properties": {"model": described}, "required": ["model"]}
    schema["else"] = known
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "bayesdrill experiment config"
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def _nested(schema: dict[str, Any], place: tuple[str, ...]) -> dict[str, Any]:
    """Return the subschema at `place`, which is created where it is missing."""
    for name in place:
        schema = schema.setdefault("properties", {}).setdefault(name, {})
    return schema
