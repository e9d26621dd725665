"""Writes the schemas of brains as the Go client reads them, so that it judges documents by the same ones.

`python tools/go_schemas.py` writes `clients/go/brain/schemas.json`; a test compares that with what it would write.
References are replaced by what they mean, what is only for people is left out, and words for what a schema allows
(`x-words`) and the order of its properties (`x-order`) are added, since a map of Go's has none.
"""

from __future__ import annotations

import json
import re
from typing import Any

from layout import ROOT
from nmes.brain import KINDS
from nmes.schemas import describe, load

PATH = ROOT / "clients" / "go" / "brain" / "schemas.json"
_KEPT = ("type", "const", "enum", "minimum", "maximum", "minLength", "maxLength", "minItems", "maxItems", "required")
_SPACES = r"\s\v\x{00a0}\x{1680}\x{2000}-\x{200a}\x{2028}\x{2029}\x{202f}\x{205f}\x{3000}\x{feff}"  # of ECMAScript's \s
_LEFT_OUT = {"$schema", "title", "description", "examples", "x-unit", "x-parameter"}


def written() -> str:
    """Returns the file as it should be.

    Raises:
        ValueError: A schema has a keyword that the client would not heed.
    """
    return json.dumps({kind: _bare(load(f"brain-{kind}.json")) for kind in KINDS}, indent=1) + "\n"


def _bare(schema: dict[str, Any]) -> dict[str, Any]:
    """Returns a schema without what is for people, with words for what it allows, and all schemas in it likewise."""
    bare: dict[str, Any] = {key: schema[key] for key in (*_KEPT, "default") if key in schema}
    unknown = schema.keys() - bare.keys() - _LEFT_OUT - {"properties", "items", "additionalProperties", "pattern"}
    if unknown:
        raise ValueError(f"schema.go knows nothing of {', '.join(sorted(unknown))}")
    bare["x-words"] = describe(schema)
    if "pattern" in schema:  # as Go writes one
        bare["x-pattern"] = re.sub(r"\\u([0-9a-f]{4})", r"\\x{\1}", schema["pattern"]).replace(r"\s", _SPACES)
    if "properties" in schema:
        bare["properties"] = {name: _bare(part) for name, part in schema["properties"].items()}
        bare["x-order"] = list(schema["properties"])
        bare["x-closed"] = schema.get("additionalProperties", True) is False
    if "items" in schema:
        bare["items"] = _bare(schema["items"])
    return bare


if __name__ == "__main__":
    PATH.write_text(written(), encoding="utf-8")
