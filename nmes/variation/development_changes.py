"""How development is changed: which parts of a body come later, and by which rules it grows, loses and resizes parts.

Hides how rules are written, and what becomes of them when the body changes. Bodies that are written out and those that
grow of a graph are alike to it, since rules name cubes as they are in the grown body. What comes out fits its schema
but for how many rules there are; whoever mutates looks and draws again.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from typing import Final

from nmes.genome.body import Body
from nmes.genome.development import hanging, read_rules
from nmes.schemas.documents import JsonObject
from nmes.variation.draw import Draw

__all__ = ["carry_over_development", "change_development", "delay"]

_LISTS: Final = ("shed", "adopt", "grow")
_MOST_RULES, _MOST_PARTS, _MOST_STAGES, _MOST_TIMES, _LONGEST = 64, 16, 16, 64, 500
_EVERY: Final = (0.1, 600.0)  # s
_SCALE: Final = (0.25, 4.0)
_AGE: Final = (0.1, 20.0)  # s: ages that are drawn
_UNCHANGED: Final = r"\"[^\"]*\"|'[^']*'|has\([^()]*\)\s*[<>=!]+\s*[0-9.]+"
# Of an expression the numbers, but for those in ids, and those beside `has`, which is 0 or 1.
_NUMBER: Final = re.compile(rf"{_UNCHANGED}|(?P<number>(?:[0-9]+(?:\.[0-9]+)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)")


def change_development(document: JsonObject, body: Body, draw: Draw) -> bool:
    """Makes one change to the `later` and the `development` of a document; returns whether there was any to make.

    Args:
        document: Is changed.
        body: Its body, whole.
        draw: All choices.
    """
    parts = list(hanging(body))
    if not parts:
        return False
    document.setdefault("later", [])
    rules: list[JsonObject] = document.setdefault("development", [])
    changes = {_change_birth: 0.3, _add_rule: 0.3}
    if rules:
        changes |= {_change_rule: 0.4, _remove_rule: 0.15}
    draw.one_of(tuple(changes), tuple(changes.values()))(document, body, draw)
    for name in ("later", "development"):
        if not document[name]:
            del document[name]
    return True


# -- at birth, or later -----------------------------------------------------------------------------------------------


def _change_birth(document: JsonObject, body: Body, draw: Draw) -> None:
    """Makes a part later, with what hangs on it; or there at birth, with what it hangs on."""
    hangs, later = hanging(body), document["later"]
    part = draw.one_of(list(hangs))
    if part not in later:
        delay(document, body, part, _drawn_age(draw))
        return
    while part in later:
        later.remove(part)
        joint = hangs[part]
        part = joint.cube2 if joint.cube1 == part else joint.cube1


def delay(document: JsonObject, body: Body, part: str, age: float) -> None:
    """Makes a part of a body later, with all that hangs on it, and adds the rules by which they grow.

    Args:
        document: Is changed.
        body: Its body, whole.
        part: The id of a cube, which is not the root.
        age: That after which they grow, s.
    """
    later = document.setdefault("later", [])
    new = [name for name in _unborn(body, {*later, part}) if name not in later]
    later += new
    for first in range(0, len(new), _MOST_PARTS):
        rule = {"when": f"age > {_written(age)}", "grow": new[first : first + _MOST_PARTS]}
        document.setdefault("development", []).append(rule)


def _unborn(body: Body, later: Collection[str]) -> list[str]:
    """Returns the ids of the cubes that are not there at birth: those that are later, and what hangs on them alone."""
    there, fresh = {body.cubes[0].id}, [body.cubes[0].id]
    for at in fresh:  # grows meanwhile
        for joint in body.joints:
            if at in (joint.cube1, joint.cube2):
                other = joint.cube2 if joint.cube1 == at else joint.cube1
                if other not in there and other not in later:
                    there.add(other)
                    fresh.append(other)
    return [name for name in hanging(body) if name not in there]


# -- rules ------------------------------------------------------------------------------------------------------------


def _add_rule(document: JsonObject, body: Body, draw: Draw) -> None:
    """Adds a rule at a place among the others."""
    rules = document["development"]
    kind = draw.one_of(("grow", "shed", "adopt", "resize", "enter"), (0.3, 0.25, 0.1, 0.25, 0.1))
    if kind == "resize" and len(body.joints) >= len(body.cubes):
        kind = "grow"  # in a body with loops nothing is resized
    part = draw.one_of(list(hanging(body)))
    orphans = [name for name in document["later"] if not any(name in rule.get("grow", ()) for rule in rules)]
    if kind == "grow" and orphans:
        part = draw.one_of(orphans)
    rule: JsonObject
    if kind == "adopt" or (kind == "grow" and part not in document["later"]):
        rule = {"when": f'has("{part}") < 1', kind: [part]}
        rule |= {"every": _drawn_every(draw), "times": draw.count(1, 8)}
    else:
        rule = {"when": _condition(body, draw)}
        if kind == "resize":
            rule["resize"] = [{"part": part, "scale": _scale(1.0, draw)}]
        elif kind == "enter":
            rule["enter"] = draw.count(1, min(_highest_stage(rules) + 1, _MOST_STAGES))
        else:
            rule[kind] = [part]
    if draw.chance(0.2):
        rule["stage"] = draw.count(1, _highest_stage(rules))
    rules.insert(draw.count(0, len(rules)), rule)


def _condition(body: Body, draw: Draw) -> str:
    """Draws when a rule applies: at an age mostly, else where a sensor reads more or less than a number."""
    if not body.sensors or draw.chance(0.6):
        return f"age > {_written(_drawn_age(draw))}"
    sensor, sign = draw.one_of(body.sensors).id, draw.one_of("<>")
    return f'sense("{sensor}") {sign} {_written(draw.normal(0.5))}'


def _highest_stage(rules: Sequence[JsonObject]) -> int:
    return max((int(rule["enter"]) for rule in rules if "enter" in rule), default=1)


def _remove_rule(document: JsonObject, body: Body, draw: Draw) -> None:
    document["development"].remove(draw.one_of(document["development"]))


def _change_rule(document: JsonObject, body: Body, draw: Draw) -> None:
    """Changes a number of a rule's condition, what it does, in which stage, or how often."""
    rules = document["development"]
    rule = draw.one_of(rules)
    numbers = [found for found in _NUMBER.finditer(rule["when"]) if found["number"] is not None]
    ways: dict[str, float] = {"every": 0.3, "times": 0.3}
    if numbers:
        ways["when"] = 1.5
    if any(kind in rule for kind in _LISTS):
        ways["parts"] = 0.6
    if "resize" in rule:
        ways["scale"] = 1.0
    if _highest_stage(rules) > 1:
        ways["stage"] = 0.4
    match draw.one_of(tuple(ways), tuple(ways.values())):
        case "when":
            found = draw.one_of(numbers)
            before = float(found["number"])
            after = _written(before * draw.factor(0.3) if before else abs(draw.normal(0.3)))
            text = rule["when"][: found.start()] + after + rule["when"][found.end() :]
            if len(text) <= _LONGEST:
                rule["when"] = text
        case "parts":
            _change_parts(rule, list(hanging(body)), draw)
        case "scale":
            entry = draw.one_of(rule["resize"])
            entry["scale"] = _scale(entry["scale"], draw)
        case "stage":
            if "stage" in rule and draw.chance(0.4):
                del rule["stage"]
            else:
                rule["stage"] = draw.count(1, _highest_stage(rules))
        case "every":
            rule["every"] = round(_within(rule.get("every", 1.0) * draw.factor(0.5), _EVERY), 3)
        case _:
            rule["times"] = min(max(rule.get("times", 1) + draw.one_of((-1, 1, 1, 2)), 1), _MOST_TIMES)


def _change_parts(rule: JsonObject, parts: Sequence[str], draw: Draw) -> None:
    """Has a rule name one part more, one less, or another one."""
    names = rule[draw.one_of([kind for kind in _LISTS if kind in rule])]
    what = draw.one_of(("more", "less", "another"))
    if what == "less" and len(names) > 1:
        names.remove(draw.one_of(names))
    elif what == "more" and len(names) < _MOST_PARTS:
        names.append(draw.one_of(parts))
    else:
        names[draw.count(0, len(names) - 1)] = draw.one_of(parts)
    names[:] = dict.fromkeys(names)


def _drawn_age(draw: Draw) -> float:
    return _within(2.0 * draw.factor(0.8), _AGE)


def _drawn_every(draw: Draw) -> float:
    return round(_within(draw.factor(0.6), _EVERY), 3)


def _scale(before: float, draw: Draw) -> float:
    return round(_within(before * draw.factor(0.3), _SCALE), 6)


def _within(value: float, bounds: tuple[float, float]) -> float:
    return min(max(value, bounds[0]), bounds[1])


def _written(value: float) -> str:
    """Returns a number as an expression has it, with six digits at most behind the point."""
    return f"{value:.6f}".rstrip("0").rstrip(".")


# -- with a body that changes -----------------------------------------------------------------------------------------


def carry_over_development(document: JsonObject, body: Body) -> None:
    """Fits the `later` and the `development` of a document to a body that has changed.

    Parts that are gone are later no more, and named by no rule. What is new and hangs on a part that is later is later
    too, and grows with it. A rule that is of no use then goes, and so does one whose condition asks for what is gone.

    Args:
        document: Is changed.
        body: The new one, whole, with its sensors.
    """
    if not document.get("later") and not document.get("development"):
        return
    hangs = hanging(body)
    later = [name for name in document.get("later", ()) if name in hangs]
    rules = [_pruned(rule, hangs) for rule in document.get("development", ())]
    for name in _unborn(body, later):
        if name not in later:
            joint = hangs[name]
            base = joint.cube2 if joint.cube1 == name else joint.cube1
            later.append(name)
            for rule in rules:
                if base in rule.get("grow", ()) and len(rule["grow"]) < _MOST_PARTS and name not in rule["grow"]:
                    rule["grow"] = [*rule["grow"], name]
    for kind, left in (("later", later), ("development", [rule for rule in rules if not read_rules([rule], body)[0]])):
        document.pop(kind, None)
        if left:
            document[kind] = left


def _pruned(rule: JsonObject, parts: Collection[str]) -> JsonObject:
    """Returns a rule without the parts that are not there."""
    left = dict(rule)
    for name in _LISTS:
        if name in rule:
            left[name] = [part for part in rule[name] if part in parts]
    if "resize" in rule:
        left["resize"] = [each for each in rule["resize"] if each["part"] in parts]
    return {name: value for name, value in left.items() if value != []}
