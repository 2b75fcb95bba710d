"""What `--json` prints is held against docs/schemas.json."""

import json
from pathlib import Path

import jsonschema

SCHEMAS = json.loads((Path(__file__).parents[1] / "docs" / "schemas.json").read_text("utf-8"))


def validate(command: str, printed: str) -> dict:
    """The object that a command printed. jsonschema.ValidationError: not what its schema promises."""
    told = json.loads(printed)
    jsonschema.Draft202012Validator(SCHEMAS | {"$ref": f"#/$defs/{command}"}).validate(told)
    return told
