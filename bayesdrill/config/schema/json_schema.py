"""Write the JSON schema of a config, with which editors complete and check configs.

The schema lists all symbols that do not depend on the config. Names of parts that a config lists
itself, as in `j_load`, are checked only against a pattern.
"""

from __future__ import annotations

import json
from typing import Any

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema

from bayesdrill.config.schema.campaign import CampaignSpec
from bayesdrill.config.schema.config import Config, Nominal
from bayesdrill.config.schema.numbers import NamedSection
from bayesdrill.config.schema.records import Initial
from bayesdrill.config.schema.validation import SECTIONS, adapter, named_entries
from bayesdrill.config.schema.vocabulary import HOUSE, described_rigs

NAME_OF_PART = "^[A-Za-z]+(_[A-Za-z0-9]+)+$"  # a letter for the quantity, then the name of a part


def json_schema() -> str:
    """Return the JSON schema of a config as text."""
    named = {place: entries for place, entries in named_entries(HOUSE).items() if place}
    known: dict[str, Any] = {}
    kinds = [((p, name), kind) for p, entries in named.items() for name, kind in entries.items()]
    adapters: list[Any] = [(key, "validation", adapter(kind)) for key, kind in kinds]
    plain, whole = TypeAdapter.json_schemas([((), "validation", adapter(Config)), *adapters])
    schemas = {key: GenerateJsonSchema().sort(schema) for (key, _), schema in plain.items()}
    defs = whole["$defs"]
    schema = defs.pop("Config")
    # Names with the least restricted entries: signed parameters, states and driving inputs.
    free_names = {name for name, symbol in HOUSE.parameters.items() if symbol.signed}
    free_names |= {*HOUSE.inputs, *HOUSE.starts} - {*HOUSE.optional_inputs}
    for place, entries in named.items():
        section = SECTIONS[place]
        if not issubclass(section, NamedSection):
            continue
        definition, defaults = defs[section.__name__], section.defaults(HOUSE)
        definition["additionalProperties"] = False
        for name in entries:
            entry = dict(schemas[place, name])
            entry |= {"default": defaults[name]} if name in defaults else {}
            if not any("$ref" in choice for choice in entry.get("anyOf", ())):
                entry["title"] = name.replace("_", " ").title()
            definition["properties"][name] = dict(sorted(entry.items()))
        _nested(known, place)["propertyNames"] = {"enum": [*definition["properties"]]}
        free = schemas[place, next(name for name in entries if name in free_names)]
        free = {key: value for key, value in free.items() if key != "description"}
        definition["patternProperties"] = {NAME_OF_PART: free}
    _nested(known, ("missing_torque", "at"))["enum"] = [*HOUSE.inertias]
    for name, empty in {"initial": Initial(), "nominal": Nominal()}.items():
        schema["properties"][name]["default"] = empty.model_dump()
    described = {"properties": {"name": {"enum": described_rigs()}}, "required": ["name"]}
    schema = {"$defs": defs, **schema}
    schema["if"] = {"properties": {"model": described}, "required": ["model"]}
    schema["else"] = known
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "bayesdrill experiment config"
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def campaign_schema() -> str:
    """Return the JSON schema of the file of a campaign as text."""
    schema = {**adapter(CampaignSpec).json_schema(), "title": "bayesdrill campaign"}
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def _nested(schema: dict[str, Any], path: tuple[str, ...]) -> dict[str, Any]:
    """Return the subschema at `path`; missing levels are created."""
    for name in path:
        schema = schema.setdefault("properties", {}).setdefault(name, {})
    return schema
