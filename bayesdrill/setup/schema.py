"""The JSON schema of configs."""

from __future__ import annotations

import json

from bayesdrill.setup.config import Config


def as_text() -> str:
    schema = Config.model_json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "bayesdrill experiment config"
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"
