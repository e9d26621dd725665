"""Creatures: spawned whole or not at all, sensed and driven by lists of numbers; parts of them can be lost."""

from __future__ import annotations

import copy
from typing import Any

from nmes.conformance.case import Category, Row, Scope
from nmes.conformance.trial import Trial
from nmes.conformance.wire import Message, Wire

CREATURES = Category(18, "creatures")
case, table = CREATURES.case, CREATURES.table

NEEDS = ("spawn_creature", "joint.hinge")
SENSORS = ("shoulder.position", "shoulder.velocity", "tilt", "arm.height", "torso.height")
# A heavy torso on the ground and an arm above it, in the plane too.
GENOME: dict[str, Any] = {
    "format": "nmes-genome/1",
    "name": "rocker",
    "body": {
        "cubes": [
            {"id": "torso", "size": [0.8, 0.4, 0.8], "mass": 20, "position": [0, 0.2, 0]},
            {"id": "arm", "size": [0.6, 0.1, 0.1], "mass": 0.5, "position": [0.4, 0.6, 0]},
        ],
        "joints": [
            {
                "id": "shoulder",
                "cube1": "torso",
                "cube2": "arm",
                "type": "hinge",
                "anchor": [0.15, 0.6, 0],
                "axis": [0, 0, 1],
                "motor": {"mode": "position", "range": [-0.6, 1.0], "max_effort": 60},
            }
        ],
    },
    "sensors": [
        {"type": "position", "joint": "shoulder"},
        {"type": "velocity", "joint": "*"},
        {"id": "tilt", "type": "up", "cube": "torso", "axis": "y"},
        {"type": "height", "cube": "arm"},
        {"type": "height", "cube": "torso"},
    ],
}


_WAYS: dict[str, list[int]] = {"up": [0, 1, 0], "down": [0, -1, 0]}


def edited(**parts: Any) -> dict[str, Any]:
    """Returns the genome with some members of its joint, or of its arm, replaced."""
    genome = copy.deepcopy(GENOME)
    for name, value in parts.items():
        (genome["body"]["cubes"][1] if name in genome["body"]["cubes"][1] else genome["body"]["joints"][0])[name] = (
            value
        )
    return genome


def spawned(t: Trial, wire: Wire, genome: dict[str, Any] = GENOME) -> Message:
    """Spawns the creature on the case's plot, to be taken away in the end."""
    command = {"type": "spawn_creature", "genome": genome, "name": t.name("creature"), "position": t.at(y=0)}
    reply = t.ask(wire, command, "creature_spawned")
    for cube in reply["cubes"].values():
        t.adopt(cube)
    return reply


def senses(t: Trial, wire: Wire, creature: str) -> dict[str, float]:
    """Reads the sensors of a creature of the genome above; returns their values by id."""
    values = t.ask(wire, {"type": "sense", "creature": creature}, "senses")["values"]
    t.equal(len(values), len(SENSORS), "the number of values")
    return dict(zip(SENSORS, values, strict=True))


def drive(t: Trial, wire: Wire, creature: str, *controls: float) -> None:
    """Drives a creature."""
    reply = t.ask(wire, {"type": "drive", "creature": creature, "controls": [*controls]}, "driven")
    t.equal(reply["creature"], creature, "creature")


@case(1, "3.7.1", needs=NEEDS)
def a_creature_is_its_cubes_and_joints(t: Trial) -> None:
    """A creature's cubes and joints are called NAME.id, and are as its genome says, about its position."""
    wire = t.join()
    reply = spawned(t, wire)
    name = reply["creature"]
    t.equal(reply["cubes"], {"torso": f"{name}.torso", "arm": f"{name}.arm"}, "cubes")
    t.equal(reply["joints"], {"shoulder": f"{name}.shoulder"}, "joints")
    parts = [cube for cube in t.cubes(wire) if cube.startswith(f"{name}.")]
    t.equal(parts, [f"{name}.torso", f"{name}.arm"], "its cubes in the list")
    origin = t.at(y=0)
    for cube in GENOME["body"]["cubes"]:
        info = t.info(wire, f"{name}.{cube['id']}")
        t.close(info["position"], [a + b for a, b in zip(origin, cube["position"], strict=True)], 0.05, "position")
        t.close(info["mass"], cube["mass"], 1e-6, "mass")
        t.close(info["size"], cube["size"], 1e-6, "size")
    joint = t.ask(wire, {"type": "get_joint_info", "joint_name": f"{name}.shoulder"}, "joint_info")
    t.equal([joint["cube1"], joint["cube2"]], [f"{name}.torso", f"{name}.arm"], "the joint's cubes")
    t.equal(joint["joint_type"], "hinge", "joint_type")


@case(2, "3.7.2", needs=NEEDS)
def motors_and_sensors_are_in_order(t: Trial) -> None:
    """The ids of motors are those of their joints, those of sensors as the genome has them, in order."""
    reply = spawned(t, t.join())
    t.equal(reply["motors"], ["shoulder"], "motors")
    t.equal(reply["sensors"], list(SENSORS), "sensors")


@case(3, "4.spawn_creature", needs=NEEDS)
def a_creature_without_a_name(t: Trial) -> None:
    """A creature without a name is given one that nobody has."""
    wire = t.join()
    names = []
    for x in (-2.0, 2.0):
        reply = t.ask(wire, {"type": "spawn_creature", "genome": GENOME, "position": t.at(x, 0)}, "creature_spawned")
        names.append(reply["creature"])
        for cube in reply["cubes"].values():
            t.adopt(cube)
    t.true(len(set(names)) == 2, "two names", names)


@table(
    4,
    "3.7.1",
    [
        Row("overlapping-cubes", edited(position=[0.1, 0.2, 0], cube1="arm", cube2="arm")),
        Row("an-unknown-cube", edited(cube1="leg")),
        Row("a-joint-of-one-cube", edited(cube2="torso")),
        Row("an-id-twice", edited(id="torso")),
        Row("a-sensor-of-nothing", {**GENOME, "sensors": [{"type": "touch", "cube": "leg"}]}),
        Row("below-the-ground", edited(position=[0.4, -1, 0])),
        Row("no-body", {"format": "nmes-genome/1", "name": "ghost"}),
    ],
    needs=NEEDS,
)
def an_ill_genome_makes_nothing(t: Trial, genome: dict[str, Any]) -> None:
    """A genome that is ill gets invalid with its place, and no part of it is made."""
    wire = t.join()
    name = t.name("ill")
    reply = t.refused(
        wire, {"type": "spawn_creature", "genome": genome, "name": name, "position": t.at(y=0)}, "invalid"
    )
    field = reply.get("field")
    t.should(isinstance(field, str) and field.startswith("genome"), "a field in genome", reply)
    t.true(not any(cube.startswith(f"{name}.") for cube in t.cubes(wire)), "no cube of it", name)
    spawned(t, wire)


@case(5, "3.7.1", needs=NEEDS)
def a_taken_name_makes_nothing(t: Trial) -> None:
    """Where a cube has the name that a part would get, nothing is made of the creature."""
    wire = t.join()
    name = t.name("taken")
    t.spawn(wire, cube_name=f"{name}.arm")
    command = {"type": "spawn_creature", "genome": GENOME, "name": name, "position": t.at(4, 0)}
    t.refused(wire, command, "cube_exists")
    t.equal([cube for cube in t.cubes(wire) if cube.startswith(f"{name}.")], [f"{name}.arm"], "cubes of that name")


@case(6, "4.error.creature_exists", needs=NEEDS)
def a_name_is_had_once(t: Trial) -> None:
    """A second creature of the same name gets creature_exists, and the first is as it was."""
    wire = t.join()
    name = spawned(t, wire)["creature"]
    command = {"type": "spawn_creature", "genome": GENOME, "name": name, "position": t.at(4, 0)}
    t.refused(wire, command, "creature_exists", "name")
    mine = [cube for cube in t.cubes(wire) if cube.startswith(f"{name}.")]
    t.equal(mine, [f"{name}.torso", f"{name}.arm"], "cubes of that name")


@case(7, "3.7.2", needs=(*NEEDS, "sense", "time"), scope=Scope.TIME)
def senses_are_what_is_seen(t: Trial) -> None:
    """The values of sensors, in their order, are what cubes and joints tell."""
    wire = t.join()
    reply = spawned(t, wire)
    t.advance(wire, 2.0)
    read = senses(t, wire, reply["creature"])
    joint = t.ask(wire, {"type": "get_joint_info", "joint_name": reply["joints"]["shoulder"]}, "joint_info")
    t.close(read["shoulder.position"], joint["position"], 0.02, "shoulder.position")
    t.close(read["shoulder.velocity"], joint["velocity"] / 10, 0.02, "shoulder.velocity, in 10 rad/s")
    for part in ("arm", "torso"):
        height = t.info(wire, reply["cubes"][part])["position"][1]
        t.close(read[f"{part}.height"], height, 0.02, f"{part}.height")
    t.close(read["tilt"], 1.0, 0.02, "tilt: where up is in the torso's own directions, along its y")


@table(
    8,
    "4.drive",
    [Row("low", (-1.0, -0.6)), Row("middle", (0.0, 0.2)), Row("high", (1.0, 1.0))],
    needs=(*NEEDS, "drive", "sense", "time"),
    scope=Scope.TIME,
)
def driving_turns_a_motor(t: Trial, row: tuple[float, float]) -> None:
    """A control from -1 to 1 turns a servo to that place in its range, where it stays until it is driven again."""
    wire = t.join()
    reply = spawned(t, wire)
    control, place = row
    drive(t, wire, reply["creature"], control)
    t.advance(wire, 2.0)
    t.close(senses(t, wire, reply["creature"])["shoulder.position"], place, 0.1, "shoulder.position")
    t.advance(wire, 1.0)
    t.close(senses(t, wire, reply["creature"])["shoulder.position"], place, 0.1, "shoulder.position, 1 s later")


@case(9, "4.drive", needs=(*NEEDS, "drive"))
def driving_sets_targets(t: Trial) -> None:
    """To drive is to set the target of each motor, as set_joint_param does, whoever does it."""
    one, two = t.join(), t.join()
    reply = spawned(t, one)
    drive(t, two, reply["creature"], 0.5)
    joint = t.ask(one, {"type": "get_joint_info", "joint_name": reply["joints"]["shoulder"]}, "joint_info")
    t.close(joint["params"]["target_position"], 0.6, 1e-6, "target_position")


@table(
    10,
    "4.drive",
    [
        Row("too-few", []),
        Row("too-many", [0, 0]),
        Row("beyond-the-range", [1.5]),
        Row("no-number", ["x"]),
        Row("null", [None]),
        Row("no-list", 0.5),
    ],
    needs=(*NEEDS, "drive"),
)
def wrong_controls_move_nothing(t: Trial, controls: Any) -> None:
    """Controls that are not one number from -1 to 1 a motor get invalid, and the motors aim where they did."""
    wire = t.join()
    reply = spawned(t, wire)
    drive(t, wire, reply["creature"], 0.5)
    command = {"type": "drive", "creature": reply["creature"], "controls": controls}
    error = t.refused(wire, command, "invalid")
    t.should(str(error.get("field")).startswith("controls"), "field controls", error)
    joint = t.ask(wire, {"type": "get_joint_info", "joint_name": reply["joints"]["shoulder"]}, "joint_info")
    t.close(joint["params"]["target_position"], 0.6, 1e-6, "target_position")


@table(
    11,
    "3.7.4",
    [
        Row("cube", {"type": "despawn_cube", "cube_name": "torso"}),
        Row("part", {"type": "shed", "part": "torso"}),
    ],
    needs=(*NEEDS, "sense", "drive", "shed"),
)
def a_creature_that_lost_its_root(t: Trial, command: dict[str, Any]) -> None:
    """Without its root a creature is one no more, and what is left stays; the root cannot be shed."""
    wire = t.join()
    name = spawned(t, wire)["creature"]
    sense, drive = {"type": "sense", "creature": name}, {"type": "drive", "creature": name, "controls": [0]}
    if command["type"] == "shed":
        t.refused(wire, {**command, "creature": name}, "invalid", "part")
        t.ask(wire, sense, "senses")
        return
    t.ask(wire, {**command, "cube_name": f"{name}.torso"}, "cube_despawned")
    t.refused(wire, sense, "creature_not_found", "creature")
    t.refused(wire, drive, "creature_not_found", "creature")
    t.info(wire, f"{name}.arm")


@table(
    19,
    "3.7.5",
    [
        Row("cube", ({"type": "despawn_cube", "cube_name": "arm"}, "cube_despawned")),
        Row("joint", ({"type": "remove_joint", "joint_name": "shoulder"}, "joint_removed")),
        Row("shed", ({"type": "shed", "part": "arm", "remove": False}, "part_shed")),
        Row("removed", ({"type": "shed", "part": "arm", "remove": True}, "part_shed")),
    ],
    needs=(*NEEDS, "sense", "drive", "shed"),
)
def a_creature_that_lost_a_part(t: Trial, way: tuple[dict[str, Any], str]) -> None:
    """What a creature has lost reads 0 and does nothing; the rest of it goes on."""
    wire, (command, answer) = t.join(), way
    name = spawned(t, wire)["creature"]
    whole = senses(t, wire, name)
    named = {key: f"{name}.{value}" for key, value in command.items() if key.endswith("_name")}
    about = {"creature": name} if command["type"] == "shed" else {}
    reply = t.ask(wire, {**command, **named, **about}, answer)
    if command["type"] == "shed":
        t.equal((reply["layout"], reply["cubes"]), (3, [f"{name}.arm"]), "layout and cubes of the answer")
    lessened = senses(t, wire, name)
    lost = {key: value for key, value in lessened.items() if key.startswith(("shoulder", "arm"))}
    t.equal(set(lost.values()), {0.0}, "what is lost reads")
    t.true(abs(lessened["torso.height"] - whole["torso.height"]) < 0.05, "the torso's height as before", lessened)
    drive = {"type": "drive", "creature": name, "controls": [1]}
    layout = t.ask(wire, drive, "driven")["layout"]
    t.ask(wire, {**drive, "layout": layout}, "driven")
    t.refused(wire, {**drive, "layout": layout - 1}, "layout_changed", "layout")
    if command["type"] == "remove_joint" or command.get("remove") is False:
        t.info(wire, f"{name}.arm")
    elif command["type"] == "despawn_cube" or command.get("remove"):
        t.refused(wire, {"type": "get_cube_info", "cube_name": f"{name}.arm"}, "cube_not_found", "cube_name")


@case(31, "4.grow", needs=(*NEEDS, "shed", "grow"))
def a_part_grows_again(t: Trial) -> None:
    """A part that is lost grows where the genome has it, with its joint and motor, if there is room."""
    wire = t.join()
    name = spawned(t, wire)["creature"]
    grow = {"type": "grow", "creature": name, "part": "arm"}
    t.refused(wire, grow, "invalid", "part")
    place = t.info(wire, f"{name}.arm")["position"]
    t.ask(wire, {"type": "shed", "creature": name, "part": "arm"}, "part_shed")
    t.ask(wire, {"type": "despawn_cube", "cube_name": f"{name}.arm"}, "cube_despawned")
    block = t.base(wire, position=place, size=[0.2] * 3)  # what was shed may have fallen out of the way by now
    t.refused(wire, grow, "no_room", "part")
    t.ask(wire, {"type": "despawn_cube", "cube_name": block}, "cube_despawned")
    reply = t.ask(wire, grow, "part_grown")
    t.equal((reply["cube"], reply["layout"]), (f"{name}.arm", 5), "the cube and the layout")
    t.close(t.info(wire, f"{name}.arm")["position"], place, 0.05, "where it grew")
    joint = t.ask(wire, {"type": "get_joint_info", "joint_name": f"{name}.shoulder"}, "joint_info")
    t.true(joint["params"]["motor_enabled"], "a joint with its motor", joint)


@case(32, "4.adopt", needs=(*NEEDS, "shed", "adopt", "sense", "drive"))
def a_part_is_adopted(t: Trial) -> None:
    """A cube becomes a part that is missing, where it is; one that is a part already does not."""
    wire = t.join()
    name = spawned(t, wire)["creature"]
    adopt = {"type": "adopt", "creature": name, "part": "arm", "cube_name": f"{name}.arm"}
    t.refused(wire, adopt, "invalid")
    t.ask(wire, {"type": "shed", "creature": name, "part": "arm"}, "part_shed")
    t.ask(wire, adopt, "part_grown")
    t.true(senses(t, wire, name)["arm.height"] > 0.1, "the height of the arm above 0.1", None)
    t.ask(wire, {"type": "drive", "creature": name, "controls": [1], "layout": 5}, "driven")


@case(33, "3.7.6", needs=(*NEEDS, "shed", "grow", "drive", "sense", "time"), scope=Scope.TIME)
def a_creature_develops(t: Trial) -> None:
    """A rule of a creature's genome sheds a part at its age, which begins with the first drive, and not before."""
    wire = t.join()
    name = spawned(t, wire, {**GENOME, "development": [{"when": "age > 0.5", "shed": ["arm"]}]})["creature"]
    t.advance(wire, 1.0)
    t.true(senses(t, wire, name)["arm.height"] > 0.1, "the arm's height above 0.1 while nobody has driven it", None)
    drive(t, wire, name, 0.0)
    t.advance(wire, 1.0)
    reply = t.ask(wire, {"type": "sense", "creature": name}, "senses")
    t.equal((reply.get("layout"), reply["values"][3]), (3, 0.0), "layout and height of the arm once it is shed")


@case(12, "4.error.creature_not_found", needs=("sense", "drive"))
def an_unknown_creature(t: Trial) -> None:
    """What is about a creature that there is not gets creature_not_found."""
    wire = t.join()
    name = t.name("nobody")
    t.refused(wire, {"type": "sense", "creature": name}, "creature_not_found", "creature")
    t.refused(wire, {"type": "drive", "creature": name, "controls": []}, "creature_not_found", "creature")


@case(15, "3.7.3", needs=(*NEEDS, "sense", "time"), scope=Scope.TIME)
def a_target_may_come_later(t: Trial) -> None:
    """A sensor of a target that is not there yet reads 0, and then where the target is."""
    wire = t.join()
    genome = {**GENOME, "sensors": [{"type": "target_direction", "cube": "torso", "axis": "x"}]}
    aim, name = t.name("aim"), t.name("creature")
    command = {"type": "spawn_creature", "genome": genome, "name": name, "position": t.at(y=0), "target": aim}
    for cube in t.ask(wire, command, "creature_spawned")["cubes"].values():
        t.adopt(cube)
    sense = {"type": "sense", "creature": name}
    t.equal(t.ask(wire, sense, "senses")["values"], [0.0], "values before the target is there")
    t.spawn(wire, cube_name=aim, position=t.at(4, 0.5))
    t.advance(wire, 0.5)
    (ahead,) = t.ask(wire, sense, "senses")["values"]
    t.true(ahead > 0.5, "a value above 0.5: the target is ahead, along +x", ahead)


@case(19, "4.spawn_creature", needs=(*NEEDS, "sense", "time", "sensors.range"), scope=Scope.TIME)
def a_range_finder_measures(t: Trial) -> None:
    """A creature's range finder reads what get_cube_info tells of such a ray, and its range beyond that."""
    wire = t.join()
    up, down = ({"id": name, "type": "range", "cube": "arm", "direction": way} for name, way in _WAYS.items())
    reply = spawned(t, wire, {**GENOME, "sensors": [{**up, "range": 3}, down]})
    t.advance(wire, 1.0)
    above, below = t.ask(wire, {"type": "sense", "creature": reply["creature"]}, "senses")["values"]
    asked = {"type": "get_cube_info", "cube_name": reply["cubes"]["arm"], "rays": [_WAYS["down"]]}
    (told,) = t.ask(wire, asked, "cube_info")["ranges"]
    t.close([above, below], [3.0, told], 0.02, "the ranges above and below")


@case(20, "4.spawn_creature", needs=(*NEEDS, "drive", "sense", "time"), scope=Scope.TIME)
def flaws_keep_motors_and_sensors(t: Trial) -> None:
    """With flaws, motors and sensors that always drop out do as if nobody drove, and read 0."""
    wire, name = t.join(), t.name("creature")
    command = {"type": "spawn_creature", "genome": GENOME, "name": name, "position": t.at(y=0)}
    flaws = {"sensors": {"drop_out": 1}, "motors": {"drop_out": 1}}
    reply = t.ask(wire, {**command, "flaws": flaws}, "creature_spawned")
    for cube in reply["cubes"].values():
        t.adopt(cube)
    drive(t, wire, name, 1.0)
    t.advance(wire, 1.0)
    joint = t.ask(wire, {"type": "get_joint_info", "joint_name": reply["joints"]["shoulder"]}, "joint_info")
    t.close(joint["position"], 0.0, 0.05, "position of a joint whose motor does not hear")
    t.equal(t.ask(wire, {"type": "sense", "creature": name}, "senses")["values"], [0.0] * len(SENSORS), "values")


@case(13, "4.reset", needs=(*NEEDS, "sense", "lockstep", "reset"), scope=Scope.WORLD)
def a_reset_takes_creatures(t: Trial) -> None:
    """After a reset there is no creature, and its name is free."""
    wire = t.join()
    name = spawned(t, wire)["creature"]
    t.ask(wire, {"type": "reset"}, "world_reset")
    t.refused(wire, {"type": "sense", "creature": name}, "creature_not_found")
    t.ask(wire, {"type": "spawn_creature", "genome": GENOME, "name": name}, "creature_spawned")


@case(14, "4.spawn_creature", needs=(*NEEDS, "3d"))
def a_graph_grows(t: Trial) -> None:
    """A graph of parts grows as often as its limit says, and its parts hang together."""
    wire = t.join()
    part = {"id": "link", "size": [0.4, 0.2, 0.2], "recursive_limit": 3}
    part["joint"] = {"type": "hinge", "axis": [0, 1, 0]}
    graph = {"root": "link", "parts": [part], "connections": [{"from": "link", "to": "link", "face": "+x"}]}
    reply = spawned(t, wire, {"format": "nmes-genome/1", "name": "chain", "body": {"graph": graph}})
    t.equal([len(reply["cubes"]), len(reply["joints"])], [3, 2], "the numbers of cubes and joints")
    places = [t.info(wire, cube)["position"][0] for cube in reply["cubes"].values()]
    t.close([places[1] - places[0], places[2] - places[1]], [0.4, 0.4], 0.02, "the way from part to part")


@case(16, "3.9.1", needs=("time", "say", "hear", "config.channels"), scope=Scope.TIME)
def voices(t: Trial) -> None:
    """What a cube says others hear from the next tick on, the nearest voice first, until it falls silent."""
    wire = t.join()
    for channel, entry in t.probe.info["config"]["channels"].items():
        size, reach = entry.get("size", 1), entry.get("range", 10.0)
        ear, near, far = (t.base(wire, position=t.at(x=x * min(reach, 10.0), y=5)) for x in (-0.4, -0.2, 0.3))
        for name in (far, near):
            say = {"type": "say", "channel": channel, "value": [0.5] * size, "cube_name": name}
            t.equal(t.ask(wire, say, "said")["cube_name"], name, "cube_name")
        t.advance(wire, 2.0 / t.probe.tick_rate)
        heard = _heard(t, wire, channel, ear)
        t.equal([voice["cube_name"] for voice in heard], [near, far], f"who is heard on {channel}")
        for voice in heard:
            part = 1.0 - voice["distance"] / reach if entry.get("fades") else 1.0
            t.close(voice["value"], [0.5 * part] * size, 1e-6, "what is heard")
        t.equal(
            [voice["cube_name"] for voice in _heard(t, wire, channel, near)], [far], "who is heard by one that speaks"
        )
        t.ask(wire, {"type": "say", "channel": channel, "cube_name": near}, "said")
        t.advance(wire, 2.0 / t.probe.tick_rate)
        t.equal(
            [voice["cube_name"] for voice in _heard(t, wire, channel, ear)], [far], "who is heard of two, one silent"
        )


@case(17, "3.9.1", needs=("say", "hear", "step", "config.channels", "lockstep"), scope=Scope.TIME)
def nothing_is_heard_before_the_next_tick(t: Trial) -> None:
    """What is said is not heard before the next tick."""
    wire = t.join()
    channel, entry = next(iter(t.probe.info["config"]["channels"].items()))
    ear, voice = (t.base(wire, position=t.at(x=x * min(entry.get("range", 10.0), 10.0))) for x in (-0.4, 0.4))
    value = [1.0] * entry.get("size", 1)
    t.ask(wire, {"type": "say", "channel": channel, "value": value, "cube_name": voice}, "said")
    t.equal(_heard(t, wire, channel, ear), [], "what is heard at once")
    t.ask(wire, {"type": "step"}, "stepped")
    t.equal([one["cube_name"] for one in _heard(t, wire, channel, ear)], [voice], "who is heard after the tick")


@case(18, "3.9.2", needs=("say", "hear"))
def no_such_channel(t: Trial) -> None:
    """A channel that the config has not is refused, and so is a voice of more numbers than it has."""
    wire = t.join()
    name = t.spawn(wire)
    for kind in ("say", "hear"):
        reply = t.refused(wire, {"type": kind, "channel": "no-such-channel", "cube_name": name}, "invalid")
        t.equal(reply.get("field"), "channel", "field")
    for channel, entry in t.probe.info.get("config", {}).get("channels", {}).items():
        value = [0.0] * (entry.get("size", 1) % 8 + 1)
        reply = t.refused(wire, {"type": "say", "channel": channel, "value": value, "cube_name": name}, "invalid")
        t.equal(reply.get("field"), "value", "field")


def _heard(t: Trial, wire: Wire, channel: str, cube: str) -> list[dict[str, Any]]:
    return list(t.ask(wire, {"type": "hear", "channel": channel, "cube_name": cube}, "heard")["voices"])
