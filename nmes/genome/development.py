"""Development: the rules of a genome by which its body grows, loses, takes up and resizes parts while it lives.

Hides how rules are read and judged, and the geometry of a body some of whose parts have another size. A rule decides
nothing here: `nmes.world.development` follows them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

from nmes.backend import Vector
from nmes.errors import DocumentError, WorldError
from nmes.objective import Condition
from nmes.schemas.documents import did_you_mean

if TYPE_CHECKING:
    from nmes.genome.body import Body, BodyJoint

__all__ = [
    "NAMES",
    "PARTS",
    "Resize",
    "Rule",
    "deeds",
    "hanging",
    "lightest",
    "outgrown",
    "read_rules",
    "resized",
    "scales",
]

JsonObject = Mapping[str, Any]

NAMES: Final[Mapping[str, tuple[str, str]]] = {
    "age": ("since it was first driven, by a client or by its own brain", "s"),
    "energy": ("what it has, in an ecosystem; else 0", "J"),
    "cubes": ("how many cubes it has now", ""),
    "mass": ("of all its cubes now", "kg"),
    "stage": ("which of its stages it is in; the first is 1", ""),
}
"""What the condition of a rule may name: each name with its meaning and unit."""
PARTS: Final[Mapping[str, tuple[str, str]]] = {
    "sense": ("what one of its sensors reads", "the sensor's"),
    "has": ("1 if it has that cube now, else 0", ""),
}
"""What it may ask of one sensor or one cube, `sense("foot.touch")`: each with its meaning and unit."""


@dataclass(frozen=True, slots=True)
class Resize:
    """What a rule makes of one part: its edges so many times as long as the document has them."""

    part: str
    scale: float


@dataclass(frozen=True, slots=True)
class Rule:
    """One rule of a body's development.

    Attributes:
        when: When it applies, in CEL; `condition` is the same, read.
        stage: In which stage only; None: in every stage.
        shed: The parts that are cut off, with all that hangs on them alone.
        adopt: The parts that are joined again, where they lie beside what they hung on.
        grow: The parts that grow.
        resize: The parts that come to be of another size.
        enter: The stage that begins then; None: none.
        every: How long it takes after a use, or a try, until the next, s.
        times: How often it may be of use in a life.
    """

    when: str
    stage: int | None
    shed: tuple[str, ...]
    adopt: tuple[str, ...]
    grow: tuple[str, ...]
    resize: tuple[Resize, ...]
    enter: int | None
    every: float
    times: int
    condition: Condition = field(compare=False)

    @property
    def parts(self) -> tuple[str, ...]:
        """The ids of the cubes that it names."""
        return (*self.shed, *self.adopt, *self.grow, *(each.part for each in self.resize))


def read_rules(entries: Sequence[JsonObject], body: Body) -> tuple[list[tuple[str, str]], tuple[Rule, ...]]:
    """Reads the `development` of a document that its schema has accepted.

    Args:
        entries: The rules.
        body: What they are for, whole.

    Returns:
        What is wrong, each with its place, up to one more than are told; and the rules that could be read.
    """
    problems: list[tuple[str, str]] = []
    rules: list[Rule] = []
    parts = {"sense": [sensor.id for sensor in body.sensors], "has": [cube.id for cube in body.cubes]}
    for i, entry in enumerate(entries):
        if len(problems) > DocumentError.MOST:
            break
        path = f"development/{i}"
        found = list(_problems(entry, path, body))
        problems += found
        try:
            condition = Condition(entry["when"], f"{path}/when", names=NAMES, parts=parts)
        except WorldError as error:
            problems.append((f"{path}/when", error.message.removeprefix(f"{path}/when: ")))
            continue
        if not found:
            rules.append(_rule(entry, condition))
    return problems, tuple(rules)


def _rule(entry: JsonObject, condition: Condition) -> Rule:
    lists = {name: tuple(entry.get(name, ())) for name in ("shed", "adopt", "grow")}
    return Rule(
        when=entry["when"],
        stage=None if "stage" not in entry else int(entry["stage"]),
        resize=tuple(Resize(each["part"], float(each["scale"])) for each in entry.get("resize", ())),
        enter=None if "enter" not in entry else int(entry["enter"]),
        every=float(entry.get("every", 1.0)),
        times=int(entry.get("times", 1)),
        condition=condition,
        **lists,
    )


def _problems(entry: JsonObject, path: str, body: Body) -> Iterator[tuple[str, str]]:
    known, root = [cube.id for cube in body.cubes], body.cubes[0].id
    places = [(f"{path}/{kind}/{i}", name) for kind in ("shed", "adopt", "grow") for i, name in _listed(entry, kind)]
    places += [(f"{path}/resize/{i}/part", each["part"]) for i, each in _listed(entry, "resize")]
    if not places and "enter" not in entry:
        yield path, "it does nothing; expected shed, adopt, grow, resize or enter"
    for place, name in places:
        if name not in known:
            yield place, f"there is no cube {name!r}{did_you_mean(name, known)}"
        elif name == root:
            yield place, f"{name!r} is the root, on which all others hang"
    if "resize" in entry and len(body.joints) >= len(body.cubes):
        yield f"{path}/resize", "only in a body without loops a part can come to be of another size"


def _listed(entry: JsonObject, name: str) -> list[tuple[int, Any]]:
    return list(enumerate(entry.get(name, ())))


def deeds(rule: JsonObject) -> str:
    """Returns the actions of a rule of a document in words: `shed tail; grow leg, leg.2; enter stage 2`."""
    done = [f"{kind} {', '.join(rule[kind])}" for kind in ("shed", "adopt", "grow") if kind in rule]
    if "resize" in rule:
        sizes = [f"{each['part']} to {each['scale']:g} times its size" for each in rule["resize"]]
        done.append(f"resize {', '.join(sizes)}")
    if "enter" in rule:
        done.append(f"enter stage {rule['enter']:g}")
    return "; ".join(done)


# -- geometry ---------------------------------------------------------------------------------------------------------


def hanging(body: Body) -> dict[str, BodyJoint]:
    """Returns by which joint each cube but the root hangs on one that is nearer to the root, the nearer ones first."""
    root = body.cubes[0].id
    found: dict[str, BodyJoint] = {}
    fresh = [root]
    for at in fresh:  # grows meanwhile
        for joint in body.joints:
            if at in (joint.cube1, joint.cube2):
                other = joint.cube2 if joint.cube1 == at else joint.cube1
                if other != root and other not in found:
                    found[other] = joint
                    fresh.append(other)
    return found


def resized(body: Body, scales: Mapping[str, float]) -> Body:
    """Returns a body some of whose parts are of another size, of the same density.

    A part grows away from the joint by which it hangs; what hangs on it is moved along, and stays as large as it is.

    Args:
        body: Without loops.
        scales: By the ids of cubes, how many times as long their edges are as in the body.
    """
    if all(scale == 1.0 for scale in scales.values()):
        return body
    cubes, joints = {cube.id: cube for cube in body.cubes}, {joint.id: joint for joint in body.joints}
    # What was done to a cube: all that was at `about` is moved by `shift`, and what is beyond by `scale` as far.
    done: dict[str, tuple[Vector, float, Vector]] = {body.cubes[0].id: ((0.0, 0.0, 0.0), 1.0, (0.0, 0.0, 0.0))}
    for name, joint in hanging(body).items():
        base = joint.cube2 if joint.cube1 == name else joint.cube1
        anchor = _placed(joint.anchor, *done[base])
        scale = scales.get(name, 1.0)
        shift = (anchor[0] - joint.anchor[0], anchor[1] - joint.anchor[1], anchor[2] - joint.anchor[2])
        done[name] = joint.anchor, scale, shift
        cube = cubes[name]
        x, y, z = cube.size
        size, mass = (x * scale, y * scale, z * scale), cube.mass * scale * scale * scale
        cubes[name] = replace(cube, size=size, mass=mass, position=_placed(cube.position, *done[name]))
        joints[joint.id] = replace(joint, anchor=anchor)
    return replace(body, cubes=tuple(cubes.values()), joints=tuple(joints.values()))


def _placed(point: Vector, about: Vector, scale: float, shift: Vector) -> Vector:
    """Returns where a point of a part is once that is `scale` times as large about a point, and moved."""
    x, y, z = (at + (each - at) * scale + by for each, at, by in zip(point, about, shift, strict=True))
    return x, y, z


def outgrown(body: Body) -> Iterator[Body]:
    """Yields the bodies that are to be judged besides the whole one: with each part as large as it may come to be."""
    _, largest = scales(body)
    if any(scale > 1.0 for scale in largest.values()):
        yield replace(resized(body, largest), development=())


def scales(body: Body) -> tuple[dict[str, float], dict[str, float]]:
    """Returns how small and how large its rules may make the parts of a body that they resize, by the ids of these."""
    smallest: dict[str, float] = {}
    largest: dict[str, float] = {}
    for each in [each for rule in body.development for each in rule.resize]:
        smallest[each.part] = min(smallest.get(each.part, 1.0), each.scale)
        largest[each.part] = max(largest.get(each.part, 1.0), each.scale)
    return smallest, largest


def lightest(body: Body) -> Iterator[tuple[BodyJoint, Body]]:
    """Yields each joint of a body with the least that rules can leave of it while that joint is there.

    That is what they never take away, and what the joint hangs by; each part as small as it may come to be.
    """
    lost = {*body.later, *(part for rule in body.development for part in rule.shed)}
    small = resized(body, scales(body)[0])
    if not lost:
        yield from ((joint, small) for joint in body.joints)
        return
    holds = hanging(body)
    bases = {part: joint.cube2 if joint.cube1 == part else joint.cube1 for part, joint in holds.items()}
    stays = {body.cubes[0].id}
    for part, base in bases.items():  # the nearer ones first
        if base in stays and part not in lost:
            stays.add(part)
    looped = len(body.joints) >= len(body.cubes)  # then there is another way, and what is on one may be gone
    for joint in body.joints:
        kept, at = {*stays, joint.cube1, joint.cube2}, [joint.cube1, joint.cube2]
        while at and not looped:
            next_up = bases.get(at.pop())
            if next_up is not None and next_up not in kept:
                kept.add(next_up)
                at.append(next_up)
        yield joint, replace(small, cubes=tuple(cube for cube in small.cubes if cube.id in kept))


def named(rules: Sequence[Rule]) -> Collection[str]:
    """Returns the ids of the cubes that rules name."""
    return dict.fromkeys(name for rule in rules for name in rule.parts)
