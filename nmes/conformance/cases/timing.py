"""Time: ticks, modes, pause, and the barrier at which several clients meet."""

from __future__ import annotations

import time
from typing import Any

from nmes.conformance.case import Category, Level, Row, Scope
from nmes.conformance.trial import Trial
from nmes.conformance.wire import Wire

TIME = Category(10, "time")
case, table = TIME.case, TIME.table

STEPS = ("stepping", "step")
MODES = ("set_mode", "step", "get_world_info")
PAUSE = ("pause", "resume", "get_world_info")
A_WHILE = 0.3  # s by the clock in which a world that ticks by itself does so


def frame(t: Trial, wire: Wire) -> int:
    """Returns the world's frame."""
    return int(t.ask(wire, {"type": "get_world_info"}, "world_info")["frame"])


def mode(t: Trial, wire: Wire, name: str, **fields: Any) -> None:
    """Sets the world's mode."""
    reply = t.ask(wire, {"type": "set_mode", "mode": name, **fields}, "mode_set")
    t.equal(reply["mode"], name, "mode")


@table(1, "4.step", [Row(str(ticks), ticks) for ticks in (1, 2, 7, 60)], needs=STEPS, scope=Scope.TIME)
def stepping(t: Trial, ticks: int) -> None:
    """So many ticks as step says, and the reply tells frame and time after the last."""
    wire = t.join()
    before = t.ask(wire, {"type": "step", "ticks": ticks}, "stepped")
    after = t.ask(wire, {"type": "step", "ticks": ticks}, "stepped")
    t.equal(after["frame"], before["frame"] + ticks, "frame")
    t.close(after["t"], after["frame"] / t.probe.tick_rate, 1e-6, "t, frame / tick_rate")


@case(2, "4.step", needs=STEPS, scope=Scope.TIME)
def one_tick_by_default(t: Trial) -> None:
    """A step that does not say how many ticks is one tick."""
    wire = t.join()
    before = t.ask(wire, {"type": "step"}, "stepped")["frame"]
    t.equal(t.ask(wire, {"type": "step"}, "stepped")["frame"], before + 1, "frame")


@case(3, "3.4.3", needs=(*STEPS, "get_world_info"), scope=Scope.TIME)
def no_ticks_without_a_step(t: Trial) -> None:
    """A world that waits for step does not tick by itself."""
    wire = t.join()
    before = frame(t, wire)
    t.sleep(A_WHILE)
    t.equal(frame(t, wire), before, "frame a while later")


@case(4, "3.4.2", needs=(*STEPS, "get_world_info", "get_world_state"), scope=Scope.TIME)
def one_clock(t: Trial) -> None:
    """All that tells the time tells the same time."""
    wire = t.join()
    stepped = t.ask(wire, {"type": "step", "ticks": 3}, "stepped")
    for kind in ("get_world_info", "get_world_state"):
        reply = t.ask(t.join(), {"type": kind}, kind.removeprefix("get_"))
        t.equal([reply["frame"], reply["t"]], [stepped["frame"], stepped["t"]], f"frame and t of {reply['type']}")


@case(5, "3.4.4", needs=(*STEPS, "get_cube_state"), scope=Scope.TIME)
def commands_act_in_order(t: Trial) -> None:
    """Of commands and steps in one write, each acts in its turn."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=50))
    read = {"type": "get_cube_state", "cube_name": name}
    push = {"type": "apply_physics", "cube_name": name, "impulse": [1, 0, 0]}
    wire.say(read, {"type": "step"}, push, read, {"type": "step"}, read, push, push, {"type": "step"}, read)
    replies = [wire.reply(f"reply {n}") for n in range(10)]
    speeds = [reply["linear_velocity"][0] for reply in replies if reply["type"] == "cube_state"]
    t.close(speeds, [0.0, 0.0, 1.0, 3.0], 0.02, "velocity along x, read before and after each tick")


@case(6, "3.4.4", needs=(*STEPS, "batch"), scope=Scope.TIME)
def steps_in_a_batch(t: Trial) -> None:
    """A batch may hold steps, which happen in their turn."""
    wire = t.join()
    step = {"type": "step", "ticks": 2}
    results = t.ask(wire, {"type": "batch", "commands": [step, step, {"type": "ping"}]}, "batch_result")["results"]
    t.equal([result["type"] for result in results], ["stepped", "stepped", "pong"], "results")
    t.equal(results[1]["frame"], results[0]["frame"] + 2, "frame of the second step")


@case(7, "4.error.wrong_mode", needs=MODES, scope=Scope.WORLD)
def step_in_realtime(t: Trial) -> None:
    """A world that ticks by itself does not step: wrong_mode."""
    wire = t.join()
    for name in ("realtime", "fast"):
        mode(t, wire, name)
        t.refused(wire, {"type": "step"}, "wrong_mode")


@case(8, "3.4.3", needs=MODES, scope=Scope.WORLD)
def lockstep(t: Trial) -> None:
    """In lockstep the world ticks when told to, and not otherwise."""
    wire = t.join()
    mode(t, wire, "lockstep")
    t.equal(t.ask(wire, {"type": "get_world_info"}, "world_info")["mode"], "lockstep", "mode")
    before = frame(t, wire)
    t.sleep(A_WHILE)
    t.equal(frame(t, wire), before, "frame a while later")
    t.equal(t.ask(wire, {"type": "step", "ticks": 5}, "stepped")["frame"], before + 5, "frame after 5 steps")


@case(9, "3.4.1", needs=MODES, scope=Scope.WORLD)
def realtime(t: Trial) -> None:
    """In realtime the world ticks by the clock."""
    wire = t.join()
    mode(t, wire, "realtime", rate=1)
    began, before = time.monotonic(), frame(t, wire)
    t.sleep(1.0)
    ticks, took = frame(t, wire) - before, time.monotonic() - began
    t.true(ticks > 0, "a world that ticks", f"{ticks} ticks in {took:.2f} s")
    t.true(ticks < 1.3 * took * t.probe.tick_rate + 3, f"{t.probe.tick_rate:g} ticks/s", f"{ticks} in {took:.2f} s")
    t.should(ticks > 0.5 * took * t.probe.tick_rate, f"{t.probe.tick_rate:g} ticks/s", f"{ticks} in {took:.2f} s")


@case(10, "4.set_mode", needs=MODES, scope=Scope.WORLD)
def rate(t: Trial) -> None:
    """The rate makes realtime faster and slower, and is told."""
    wire = t.join()
    ticks = []
    for factor in (0.25, 4.0):
        reply = t.ask(wire, {"type": "set_mode", "mode": "realtime", "rate": factor}, "mode_set")
        t.close(reply["rate"], factor, 1e-9, "rate")
        before = frame(t, wire)
        t.sleep(0.5)
        ticks.append(frame(t, wire) - before)
    t.true(ticks[1] > 4 * ticks[0], "many more ticks at rate 4 than at rate 0.25", f"{ticks[1]} and {ticks[0]}")


@case(11, "3.4.3", needs=MODES, scope=Scope.WORLD)
def fast(t: Trial) -> None:
    """In mode fast the world ticks, faster than the clock."""
    wire = t.join()
    mode(t, wire, "fast")
    began, before = time.monotonic(), frame(t, wire)
    t.sleep(A_WHILE)
    ticks = frame(t, wire) - before
    by_clock = (time.monotonic() - began) * t.probe.tick_rate
    t.true(ticks > 0, "a world that ticks", ticks)
    t.should(ticks > by_clock, f"more than the clock's {by_clock:.0f} ticks", ticks)


@case(12, "4.pause", needs=PAUSE, scope=Scope.WORLD)
def pausing(t: Trial) -> None:
    """A paused world does not tick by itself, and one that is resumed does."""
    wire = t.join()
    if t.probe.claims("set_mode"):
        mode(t, wire, "realtime", rate=1)
    paused = t.ask(wire, {"type": "pause"}, "paused")["frame"]
    t.equal(t.ask(wire, {"type": "get_world_info"}, "world_info")["paused"], True, "paused")
    t.sleep(A_WHILE)
    t.equal(frame(t, wire), paused, "frame a while later")
    t.ask(wire, {"type": "pause"}, "paused")
    resumed = t.ask(wire, {"type": "resume"}, "resumed")["frame"]
    t.equal(resumed, paused, "frame of the reply to resume")
    t.equal(t.ask(wire, {"type": "get_world_info"}, "world_info")["paused"], False, "paused after resume")
    if t.probe.claims("set_mode") or t.probe.mode != "lockstep":
        t.sleep(A_WHILE)
        t.true(frame(t, wire) > resumed, "a world that ticks again", f"frame {resumed} still")


@case(24, "4.resume", needs=PAUSE, scope=Scope.WORLD)
def resuming_what_goes_on(t: Trial) -> None:
    """A world that is not paused can be resumed, which changes nothing."""
    wire = t.join()
    t.ask(wire, {"type": "resume"}, "resumed")
    info = t.ask(wire, {"type": "get_world_info"}, "world_info")
    t.equal([info["paused"], info["mode"]], [False, t.probe.mode], "paused and mode")


@case(13, "4.step", needs=(*PAUSE, "step"), scope=Scope.WORLD)
def stepping_a_paused_world(t: Trial) -> None:
    """A paused world steps, whatever its mode."""
    wire = t.join()
    if t.probe.claims("set_mode"):
        mode(t, wire, "realtime", rate=1)
    before = t.ask(wire, {"type": "pause"}, "paused")["frame"]
    t.equal(t.ask(wire, {"type": "step", "ticks": 4}, "stepped")["frame"], before + 4, "frame")


@case(14, "4.pause", needs=(*PAUSE, "step"), scope=Scope.WORLD)
def what_is_done_in_a_pause(t: Trial) -> None:
    """Commands are obeyed in a pause; a cube hangs in the air until time goes on."""
    wire = t.join()
    t.ask(wire, {"type": "pause"}, "paused")
    name = t.spawn(wire, position=t.at(y=10))
    t.sleep(A_WHILE)
    t.close(t.info(wire, name)["position"], t.at(y=10), 1e-9, "position")
    t.ask(wire, {"type": "step", "ticks": 10}, "stepped")
    t.true(t.info(wire, name)["position"][1] < 9.99, "a cube that falls", "it hangs")


@case(15, "4.step", needs=STEPS, scope=Scope.TIME)
def many_ticks(t: Trial) -> None:
    """A step may be a thousand ticks, and what is sent after it waits its turn."""
    wire = t.join()
    before = t.ask(wire, {"type": "step"}, "stepped")["frame"]
    wire.say({"type": "step", "ticks": 1000, "id": "long"}, {"type": "ping", "id": "after"})
    reply = wire.reply("stepped", t.target.timeout * 4)
    t.equal([reply.get("id"), reply["frame"]], ["long", before + 1000], "id and frame")
    t.equal(wire.reply("pong").get("id"), "after", "the next id")


# -- the barrier ------------------------------------------------------------------------------------------------------


@case(16, "3.5.1", needs=MODES, level=Level.MAY, scope=Scope.WORLD)
def a_barrier_for_two(t: Trial) -> None:
    """With a barrier the world ticks when all have said step, and all get the same frame."""
    one, two, witness = t.join(), t.join(), t.join()
    reply = t.ask(one, {"type": "set_mode", "mode": "lockstep", "barrier": True, "agents": 2}, "mode_set")
    t.equal(reply["barrier"], True, "barrier")
    before = frame(t, witness)
    one.say({"type": "step"})
    one.quiet(0.1)
    t.equal(frame(t, witness), before, "frame while one waits")
    two.say({"type": "step"})
    frames = [wire.reply("stepped")["frame"] for wire in (one, two)]
    t.equal(frames, [before + 1] * 2, "the frames of both")
    for _ in range(3):
        two.say({"type": "step"})
        two.quiet(0.02)
        one.say({"type": "step"})
        frames = [wire.reply("stepped")["frame"] for wire in (one, two)]
        t.equal(frames[0], frames[1], "the frames of both")


@case(17, "3.5.1", needs=MODES, level=Level.MAY, scope=Scope.WORLD)
def what_waits_at_a_barrier(t: Trial) -> None:
    """What a connection sends behind a step that waits, waits too; commands of others act."""
    one, two = t.join(), t.join()
    mode(t, one, "lockstep", barrier=True, agents=2)
    one.say({"type": "step", "id": 1}, {"type": "ping", "id": 2})
    one.quiet(0.1)
    t.fence(two)
    two.say({"type": "step"})
    t.equal([one.reply("stepped").get("id"), one.reply("pong").get("id")], [1, 2], "the ids in order")
    t.equal(two.reply("stepped")["type"], "stepped", "the other's reply")


@case(18, "3.5.3", needs=(*MODES, "subscribe"), level=Level.MAY, scope=Scope.WORLD)
def who_is_late_at_a_barrier(t: Trial) -> None:
    """Who keeps the others waiting too long is told of, and no longer waited for."""
    one, two, witness = t.join(), t.join(), t.join()
    t.ask(witness, {"type": "subscribe", "events": ["tick"], "every": 1_000_000}, "subscribed")
    mode(t, one, "lockstep", barrier=True, agents=2, timeout=0.2)
    for wire in (one, two):
        wire.say({"type": "step"})
    for wire in (one, two):
        wire.reply("stepped")
    one.say({"type": "step"})
    t.equal(one.reply("stepped", t.target.timeout + 1)["type"], "stepped", "the reply after the time-out")
    event = witness.hear(what="barrier_timeout")
    t.equal([event["type"], len(event["clients"])], ["barrier_timeout", 1], "the event")
    one.say({"type": "step"})
    t.equal(one.reply("stepped")["type"], "stepped", "the reply to the next step, at once")


@case(19, "3.5.4", needs=MODES, level=Level.MAY, scope=Scope.WORLD)
def another_mode_ends_the_waiting(t: Trial) -> None:
    """Another set_mode ends the waiting at a barrier."""
    one, two = t.join(), t.join()
    mode(t, one, "lockstep", barrier=True, agents=2)
    one.say({"type": "step"})
    one.quiet(0.05)
    mode(t, two, "lockstep")
    t.equal(one.reply("stepped")["type"], "stepped", "the reply to who waited")


@case(20, "3.5.1", needs=MODES, level=Level.MAY, scope=Scope.WORLD)
def who_leaves_a_barrier(t: Trial) -> None:
    """Who leaves is no longer waited for."""
    one, two = t.join(), t.join()
    mode(t, one, "lockstep", barrier=True, agents=2)
    for wire in (one, two):
        wire.say({"type": "step"})
    for wire in (one, two):
        wire.reply("stepped")
    one.say({"type": "step"})
    two.close()
    t.equal(one.reply("stepped")["type"], "stepped", "the reply once the other has left")


@case(21, "3.5.5", needs=(*MODES, "batch"), level=Level.MAY, scope=Scope.WORLD)
def no_step_in_a_batch_at_a_barrier(t: Trial) -> None:
    """With a barrier, a batch holds no step."""
    wire = t.join()
    mode(t, wire, "lockstep", barrier=True)
    results = t.ask(wire, {"type": "batch", "commands": [{"type": "step"}]}, "batch_result")["results"]
    t.equal([results[0]["type"], results[0].get("code")], ["error", "wrong_mode"], "the result")


@case(22, "3.5.2", needs=MODES, level=Level.MAY, scope=Scope.WORLD)
def nobody_starts_alone(t: Trial) -> None:
    """The first tick waits for as many as agents says."""
    wires = [t.join() for _ in range(3)]
    mode(t, wires[0], "lockstep", barrier=True, agents=3)
    for wire in wires[:2]:
        wire.say({"type": "step"})
    wires[0].quiet(0.1)
    wires[2].say({"type": "step"})
    frames = [wire.reply("stepped")["frame"] for wire in wires]
    t.equal(len(set(frames)), 1, "one frame for all")


@case(23, "4.error.wrong_mode", needs=MODES, level=Level.MAY, scope=Scope.WORLD)
def a_barrier_only_in_lockstep(t: Trial) -> None:
    """A barrier in another mode than lockstep is wrong_mode, and the mode stays."""
    wire = t.join()
    mode(t, wire, "lockstep")
    t.refused(wire, {"type": "set_mode", "mode": "fast", "barrier": True}, "wrong_mode")
    t.equal(t.ask(wire, {"type": "get_world_info"}, "world_info")["mode"], "lockstep", "mode")
