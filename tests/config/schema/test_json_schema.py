"""The JSON schema of configs, by which editors complete and describe entries."""

import json
import re
from typing import Any

import pytest
from support.command_line import ROOT

from bayesdrill.config.schema.json_schema import campaign_schema, json_schema


@pytest.fixture(scope="module")
def schema() -> dict[str, Any]:
    return dict(json.loads(json_schema()))


def test_the_committed_schema_is_that_of_the_code() -> None:
    """`make schema` writes it anew."""
    assert (ROOT / "configs" / "schema.json").read_text() == json_schema()


def test_the_file_of_a_campaign_has_a_schema_of_its_own() -> None:
    schema = json.loads(campaign_schema())
    assert {"base", "runs", "name"} == {*schema["required"]}
    assert "effective draws" in schema["properties"]["effort"]["description"].lower()
    assert schema["additionalProperties"] is False


def test_symbols_have_their_unit_and_meaning(schema: dict[str, Any]) -> None:
    entry = schema["$defs"]["Parameters"]["properties"]["t_f"]
    assert "not a time" in entry["description"]
    assert "N*m" in entry["description"]
    assert schema["additionalProperties"] is False


def test_names_of_parts_are_known_beside_a_train_alone(schema: dict[str, Any]) -> None:
    names = schema["else"]["properties"]
    assert schema["if"]["properties"]["model"]["properties"]["name"] == {"enum": ["train"]}
    for section in ("parameters", "nominal", "inputs", "initial", "simulation"):
        kind = schema["$defs"][section.capitalize()]
        assert names[section]["propertyNames"]["enum"] == [*kind["properties"]]
        ((pattern, _),) = kind["patternProperties"].items()
        assert kind["additionalProperties"] is False
        for name in ("j_load", "t_c_load", "theta_arm_2", "k_T_motor"):
            assert re.search(pattern, name), name
    assert names["missing_torque"]["properties"]["at"]["enum"] == ["motor", "rotor_1"]
