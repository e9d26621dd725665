"""What a server may leave out: it claims what it has, and says no to the rest."""

from __future__ import annotations

from typing import Any

from nmes.conformance.case import Category, Finding, Row, Unimplemented
from nmes.conformance.cases.fields import valid
from nmes.conformance.trial import ABSENT, Trial
from nmes.conformance.wire import clip
from nmes.protocol import COMMANDS

CAPABILITIES = Category(16, "capabilities")
case, table = CAPABILITIES.case, CAPABILITIES.table

OPTIONAL = [kind for kind, command in COMMANDS.items() if not command.required]
# Sent so that nothing is done where they are there: a command that is not valid, where there is one.
HARMLESS: dict[str, dict[str, Any]] = {
    "reset": {"seed": -1},
    "set_mode": {"mode": "none"},
    "step": {"ticks": -1},
    "batch": {"commands": []},
}
LEFT_ALONE = frozenset({"pause", "resume"})


@table(1, "5.1.2", [Row(kind, kind, clause=f"4.{kind}") for kind in OPTIONAL if kind not in LEFT_ALONE])
def there_or_not(t: Trial, kind: str) -> None:
    """A command that may be left out is claimed and there, or gets unsupported or unknown_type."""
    wire = t.join()
    joint = "joint_name" in COMMANDS[kind].schema["properties"] and not t.probe.claims("joint.fixed")
    command = COMMANDS[kind].schema["examples"][0] if joint else valid(t, wire, kind)
    reply = wire.ask({**command, **HARMLESS.get(kind, {})})
    # With a field it is that value which the engine lacks, such as a genome with hinges, and not the command.
    absent = reply["type"] == "error" and reply["code"] in ABSENT and reply.get("field", "type") == "type"
    if reply["type"] == "creature_spawned":
        for name in reply["cubes"].values():
            t.adopt(name)
    if t.probe.claims(kind):
        t.true(not absent, f"{kind}, which is claimed", reply)
    elif reply["type"] == "error" and reply["code"] == "invalid" and kind in HARMLESS:
        raise Unimplemented(f"{kind} is not claimed; its fields are looked at all the same")
    elif absent:
        raise Unimplemented(f"{kind}: {reply['message']}")
    else:
        t.should(False, f"{kind} among the capabilities, or unsupported or unknown_type", reply)


@table(2, "5.1.1", [Row(kind, kind) for kind, command in COMMANDS.items() if command.required])
def what_must_be_there(t: Trial, kind: str) -> None:
    """A command that every server must have is there."""
    wire = t.join()
    reply = wire.ask({"type": kind})
    absent = reply["type"] == "error" and reply["code"] in ABSENT
    t.true(not absent, f"{kind}", reply)
    if "spawned" in reply:
        t.adopt(reply["spawned"])
    t.ask(wire, {"type": "spawn_cube", "cube_name": t.name(), "position": t.at(), "list": False}, "cube_list")


@table(3, "5.1.1", [Row(kind, kind) for kind in ("fixed", "hinge", "slide", "pin", "conetwist")])
def kinds_of_joints(t: Trial, kind: str) -> None:
    """A kind of joint that is not claimed gets unsupported, and joins nothing."""
    wire = t.join()
    one, two = t.base(wire), t.base(wire, position=t.at(1.5))
    reply = wire.ask({"type": "create_joint", "cube1": one, "cube2": two, "joint_type": kind})
    if t.probe.claims(f"joint.{kind}"):
        t.equal(reply["type"], "joint_created", "the reply")
        return
    if reply["type"] != "error":
        t.should(not t.probe.info, f"joint.{kind} among the capabilities, or unsupported", reply)
        return
    t.error(reply, "unsupported")
    t.equal(t.info(wire, one)["joints"], [], "joints")
    raise Unimplemented(f"{kind} joints: {reply['message']}")


@case(4, "5.1.2", needs=("get_world_info",))
def claims_are_names(t: Trial) -> None:
    """The capabilities that are claimed are commands that may be left out, or abilities of the engine."""
    claimed = t.ask(t.join(), {"type": "get_world_info"}, "world_info")["capabilities"]
    for name in claimed:
        if name in COMMANDS and COMMANDS[name].required:
            t.should(False, "no command among the capabilities that every server must have", name)


@table(
    5,
    "5.1.2",
    [Row(param, (param, value)) for param, value in (("motor_target_velocity", 1), ("stiffness", 1))],
    needs=("joint.fixed",),
)
def parameters_that_a_joint_lacks(t: Trial, row: tuple[str, Any]) -> None:
    """A fixed joint has no motor and no spring: unsupported."""
    wire = t.join()
    joint = t.join_cubes(wire, t.base(wire), t.base(wire, position=t.at(1.5)))
    reply = wire.ask({"type": "set_joint_param", "joint_name": joint, "param_name": row[0], "value": row[1]})
    if reply["type"] != "error":
        raise Finding("error unsupported", clip(reply))
    t.error(reply, {"unsupported", "invalid"})
    t.should(reply["code"] == "unsupported", "code unsupported", reply)
