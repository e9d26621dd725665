"""Names and ownership."""

from __future__ import annotations

import re

from nmes.conformance.case import Category, Row
from nmes.conformance.trial import Trial

NAMES = Category(8, "names")
case, table = NAMES.case, NAMES.table

MADE_UP = re.compile(r"cube_\d+_[0-9a-f]{8}")


@case(1, "3.6.1")
def made_up_names(t: Trial) -> None:
    """A cube spawned without a name is called cube_<n>_<8 hex digits>."""
    wire = t.join()
    for base in (False, True):
        reply = t.ask(wire, {"type": "spawn_cube", "position": t.at(), "is_base": base, "list": False}, "cube_list")
        t.adopt(reply["spawned"])
        name = reply["spawned"].removesuffix("_BASE") if base else reply["spawned"]
        t.true(MADE_UP.fullmatch(name) is not None, "cube_<n>_<8 hex digits>", reply)


@case(2, "3.6.1")
def made_up_names_are_new(t: Trial) -> None:
    """A made-up name is never used twice, not even when its cube is gone."""
    wire = t.join()
    names = []
    for n in range(30):
        name = t.ask(wire, {"type": "spawn_cube", "position": t.at(y=3 + 2 * n), "list": False}, "cube_list")["spawned"]
        t.adopt(name)
        names.append(name)
        if n % 2:
            t.ask(wire, {"type": "despawn_cube", "cube_name": name}, "cube_despawned")
    t.equal(len(set(names)), 30, "different names")


@case(3, "3.6.1")
def two_connections_make_up_different_names(t: Trial) -> None:
    """Names made up for two connections are different."""
    wires = [t.join(), t.join()]
    names = []
    for n in range(10):
        for x, wire in enumerate(wires):
            command = {"type": "spawn_cube", "position": t.at(2 * x, 3 + 2 * n), "list": False}
            name = t.ask(wire, command, "cube_list")["spawned"]
            t.adopt(name)
            names.append(name)
    t.equal(len(set(names)), 20, "different names")


@case(4, "3.6.2")
def bases_are_named(t: Trial) -> None:
    """With is_base, _BASE is appended to the name, and only the whole is the cube's name."""
    wire = t.join()
    name = t.name()
    reply = t.ask(wire, {"type": "spawn_cube", "cube_name": name, "is_base": True, "position": t.at()}, "cube_list")
    t.adopt(name + "_BASE")
    t.equal(reply["spawned"], name + "_BASE", "the name")
    t.true(name + "_BASE" in reply["cubes"] and name not in reply["cubes"], f"{name}_BASE in the list", reply)
    t.refused(wire, {"type": "get_cube_info", "cube_name": name}, "cube_not_found", "cube_name")


@case(5, "3.6.2")
def bases_are_frozen(t: Trial) -> None:
    """With is_base the cube is frozen; without, it is not."""
    wire = t.join()
    t.equal(t.info(wire, t.base(wire))["frozen"], True, "frozen of a base")
    t.equal(t.info(wire, t.spawn(wire, position=t.at(2)))["frozen"], False, "frozen of a cube")
    t.equal(t.info(wire, t.spawn(wire, is_base=False, position=t.at(4)))["frozen"], False, "frozen with is_base false")


@case(6, "3.6.2")
def a_base_and_a_cube_of_one_name(t: Trial) -> None:
    """A base and a cube may be given the same name, for the base's is longer."""
    wire = t.join()
    name = t.name()
    for base in (True, False):
        t.ask(wire, {"type": "spawn_cube", "cube_name": name, "is_base": base, "position": t.at()}, "cube_list")
    t.adopt(name + "_BASE")
    cubes = t.cubes(wire)
    t.true({name, name + "_BASE"} <= set(cubes), f"{name} and {name}_BASE", cubes)


@case(7, "3.6.3")
def the_last_cube_is_owned(t: Trial) -> None:
    """A connection owns the cube that it spawned last."""
    wire = t.join()
    for n in range(3):
        name = t.spawn(wire, position=t.at(n * 1.5))
        t.equal(
            t.ask(wire, {"type": "apply_physics", "force": [0, 0, 0]}, "physics_applied")["cube_name"],
            name,
            "the cube that is owned",
        )


@case(8, "3.6.3")
def others_own_others(t: Trial) -> None:
    """Each connection owns its own cube, whoever spawned last."""
    one, two = t.join(), t.join()
    first, second = t.spawn(one), t.spawn(two, position=t.at(2))
    t.equal(
        t.ask(one, {"type": "apply_physics", "force": [0, 0, 0]}, "physics_applied")["cube_name"],
        first,
        "the first's cube",
    )
    t.equal(
        t.ask(two, {"type": "apply_physics", "force": [0, 0, 0]}, "physics_applied")["cube_name"],
        second,
        "the second's cube",
    )


@case(9, "3.6.3")
def an_owned_cube_that_is_gone(t: Trial) -> None:
    """Who owned a cube that is gone owns nothing: an older cube is not owned again."""
    wire, other = t.join(), t.join()
    t.spawn(wire)
    last = t.spawn(wire, position=t.at(2))
    t.ask(other, {"type": "despawn_cube", "cube_name": last}, "cube_despawned")
    t.refused(wire, {"type": "apply_physics", "force": [0, 1, 0]}, "nothing_owned")


@case(10, "3.6.3", needs=("get_cube_state",))
def reading_the_owned_cube(t: Trial) -> None:
    """The command get_cube_state without a name reads the cube that is owned."""
    wire = t.join()
    t.refused(wire, {"type": "get_cube_state"}, "nothing_owned")
    name = t.base(wire)
    t.equal(t.ask(wire, {"type": "get_cube_state"}, "cube_state")["cube_name"], name, "the cube")


@case(11, "3.6.3")
def naming_another_does_not_change_ownership(t: Trial) -> None:
    """A command that names another's cube acts on that one, and changes no ownership."""
    one, two = t.join(), t.join()
    first, second = t.spawn(one), t.spawn(two, position=t.at(2))
    t.equal(
        t.ask(one, {"type": "apply_physics", "cube_name": second, "force": [0, 0, 0]}, "physics_applied")["cube_name"],
        second,
        "cube",
    )
    t.equal(
        t.ask(one, {"type": "apply_physics", "force": [0, 0, 0]}, "physics_applied")["cube_name"],
        first,
        "the cube that is owned",
    )


@case(12, "3.6.4")
def cubes_outlive_their_connection(t: Trial) -> None:
    """A cube stays when the connection that spawned it is gone, politely or not."""
    polite, rude, witness = t.join(), t.join(), t.join()
    names = [t.base(polite), t.base(rude, position=t.at(2))]
    polite.hang_up()
    polite.rest()
    rude.reset()
    cubes = t.cubes(witness)
    t.true(set(names) <= set(cubes), f"{names} among the cubes", cubes)


@case(13, "3.6.4")
def a_new_connection_owns_nothing(t: Trial) -> None:
    """Who comes back owns nothing."""
    wire = t.join()
    t.spawn(wire)
    wire.hang_up()
    wire.rest()
    t.refused(t.join(), {"type": "apply_physics", "force": [0, 1, 0]}, "nothing_owned")


@case(14, "3.6.5")
def the_order_of_creation(t: Trial) -> None:
    """The list of cubes is in order of creation, whoever creates them and whatever they are called."""
    wires = [t.join(), t.join()]
    requests = sorted((t.name(hint) for hint in "zayb"), reverse=True)  # neither names nor clients are in that order
    names = [t.base(wires[n % 2], cube_name=name, position=t.at(n)) for n, name in enumerate(requests)]
    t.ask(wires[0], {"type": "despawn_cube", "cube_name": names.pop(1)}, "cube_despawned")
    names.append(t.base(wires[1], position=t.at(4)))
    mine = [name for name in t.cubes(wires[0]) if name in names]
    t.equal(mine, names, "the case's cubes in the list")


@case(15, "4.spawn_cube")
def a_name_can_be_had_again_or_not_at_all(t: Trial) -> None:
    """The name of a despawned cube is given to a new one, or refused with cube_exists."""
    wire = t.join()
    name = t.spawn(wire, mass=2.0)
    t.ask(wire, {"type": "despawn_cube", "cube_name": name}, "cube_despawned")
    command = {"type": "spawn_cube", "cube_name": name, "mass": 3.0, "position": t.at(), "list": False}
    reply = wire.ask(command)
    if reply["type"] == "error":
        t.error(reply, "cube_exists")
    else:
        t.equal(t.info(wire, name)["mass"], 3.0, "mass of the new cube")


@table(
    16,
    "3.2.3",
    [
        Row("punctuation", "!#$%&'()*+,-./:;=?@[]^_`{|}~"),
        Row("less-than", "<<>>"),
        Row("quotes", 'a"b\\c'),
        Row("greek", "Ωμέγα"),
        Row("chinese", "漢字"),
        Row("lizard", "🦎"),
        Row("digits", "0123"),
        Row("like-a-path", "../../etc/passwd"),
        Row("like-html", "<b>x</b>"),
        Row("percent", "%s%d%n"),
        Row("delimiter", "<???DONE???---"),
    ],
)
def all_kinds_of_names(t: Trial, text: str) -> None:
    """Any printable characters make a name, and it comes back as it was."""
    wire = t.join()
    name = t.base(wire, text)
    t.true(text in name, f"a name with {text}", name)
    t.equal(t.info(wire, name)["cube_name"], name, "the name")
    t.true(name in t.cubes(wire), "the name in the list", name)


@table(
    17,
    "3.2.3",
    [
        Row("empty", ""),
        Row("space", "a b"),
        Row("only-space", " "),
        Row("tab", "a\tb"),
        Row("newline", "a\n"),
        Row("nul", "a\0b"),
        Row("delete", "a\x7f"),
        Row("no-break-space", "a\u00a0b"),
        Row("ideographic-space", "a\u3000b"),
        Row("zero-width-space", "a\u200bb"),
        Row("line-separator", "a\u2028b"),
        Row("129-characters", "a" * 129),
        Row("10000-characters", "a" * 10_000),
    ],
)
def what_is_no_name(t: Trial, text: str) -> None:
    """White space, characters that do not print and more than 128 characters make no name."""
    wire = t.join()
    t.refused(wire, {"type": "spawn_cube", "cube_name": text, "position": t.at()}, "invalid", "cube_name")
    t.true(text not in t.cubes(wire), "no such cube", text)


@case(18, "3.2.3")
def a_name_of_128_characters(t: Trial) -> None:
    """A name may have 128 characters, of any length in bytes."""
    wire = t.join()
    for filler in ("x", "é", "漢", "🦎"):
        name = t.name()
        name += filler * (128 - len(name))
        t.spawn(wire, cube_name=name, is_base=False)
        t.equal(t.info(wire, name)["cube_name"], name, "the name")


@case(19, "3.2.3")
def names_differ_by_case(t: Trial) -> None:
    """Names that differ only by case are different names."""
    wire = t.join()
    stem = t.name()
    names = [stem + "Abc", stem + "aBC"]
    for n, name in enumerate(names):
        t.spawn(wire, cube_name=name, position=t.at(n * 2))
    t.true(set(names) <= set(t.cubes(wire)), "both names", names)


@case(20, "3.6.1", needs=("joint.fixed",))
def names_of_joints_are_new(t: Trial) -> None:
    """Joints have names of their own, different from each other."""
    wire = t.join()
    cubes = [t.base(wire, position=t.at(n - 2)) for n in range(5)]
    pairs = [(0, 1), (0, 2), (3, 2), (4, 2)]  # the same first cube twice, the same second one too
    joints = [t.join_cubes(wire, cubes[one], cubes[two]) for one, two in pairs]
    t.equal(len(set(joints)), 4, "different names")
