"""Writes the schemas of brains and genomes as the Go client reads them, so that it judges documents by the same ones.

`python tools/go_schemas.py` writes `clients/go/brain/schemas.json`, and `clients/go/genome/schemas.json`, which has
those of the brains too; tests compare them with what it would write.
References are replaced by what they mean, what is only for people is left out, and words for what a schema allows
(`x-words`) and the order of its properties (`x-order`) are added, since a map of Go's has none.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

from layout import ROOT
from nmes.brain import KINDS
from nmes.schemas import describe, load

PATH = ROOT / "clients" / "go" / "brain" / "schemas.json"
GENOMES = ROOT / "clients" / "go" / "genome" / "schemas.json"
_BOUNDS = ("minimum", "maximum", "minLength", "maxLength", "minItems", "maxItems", "uniqueItems")
_KEPT = ("type", "const", "enum", *_BOUNDS, "required", "default", "x-parameter")
_INSIDE = ("items", "contains")
_SPACES = r"\s\v\x{00a0}\x{1680}\x{2000}-\x{200a}\x{2028}\x{2029}\x{202f}\x{205f}\x{3000}\x{feff}"  # of ECMAScript's \s
_LEFT_OUT = {"$schema", "$defs", "title", "description", "examples", "x-unit"}


def written() -> str:
    """Returns the file of the brains as it should be.

    Raises:
        ValueError: A schema has a keyword that the client would not heed.
    """
    return _written({kind: f"brain-{kind}.json" for kind in KINDS})


def written_genomes() -> str:
    """Returns the file of the genomes as it should be.

    Raises:
        ValueError: A schema has a keyword that the client would not heed.
    """
    return _written({name: f"{name}.json" for name in ("genome", *(f"brain-{kind}" for kind in KINDS))})


def _written(names: Mapping[str, str]) -> str:
    return json.dumps({name: _bare(load(path)) for name, path in names.items()}, indent=1) + "\n"


def _bare(schema: dict[str, Any]) -> dict[str, Any]:
    """Returns a schema without what is for people, with words for what it allows, and all schemas in it likewise."""
    bare: dict[str, Any] = {key: schema[key] for key in _KEPT if key in schema}
    handled = {*_LEFT_OUT, *_INSIDE, "anyOf", "properties", "additionalProperties", "pattern"}
    unknown = schema.keys() - bare.keys() - handled
    if unknown:
        raise ValueError(f"schema.go knows nothing of {', '.join(sorted(unknown))}")
    bare["x-words"] = describe(schema)
    if "pattern" in schema:  # as Go writes one
        bare["x-pattern"] = re.sub(r"\\u([0-9a-f]{4})", r"\\x{\1}", schema["pattern"]).replace(r"\s", _SPACES)
    if "properties" in schema:
        bare["properties"] = {name: _bare(part) for name, part in schema["properties"].items()}
        bare["x-order"] = list(schema["properties"])
        bare["x-closed"] = schema.get("additionalProperties", True) is False
    bare |= {key: _bare(schema[key]) for key in _INSIDE if key in schema}
    if "anyOf" in schema:
        bare["anyOf"] = [_bare(choice) for choice in schema["anyOf"]]
    return bare


if __name__ == "__main__":
    PATH.write_text(written(), encoding="utf-8")
    GENOMES.write_text(written_genomes(), encoding="utf-8")
