"""Several clients in one world."""

from __future__ import annotations

import threading

from nmes.conformance.case import Category, Scope
from nmes.conformance.trial import Trial

CLIENTS = Category(9, "clients")
case, table = CLIENTS.case, CLIENTS.table

LOOKS = 200  # at a number of clients until it stays the same: ten seconds of them


@case(1, "4.spawn_cube")
def one_world(t: Trial) -> None:
    """What one client spawns, changes and despawns, the others see."""
    one, two = t.join(), t.join()
    name = t.base(one, mass=2.0)
    t.true(name in t.cubes(two), f"{name} in the other's list", name)
    t.close(t.info(two, name)["mass"], 2.0, 1e-9, "mass as the other sees it")
    t.ask(two, {"type": "despawn_cube", "cube_name": name}, "cube_despawned")
    t.refused(one, {"type": "get_cube_info", "cube_name": name}, "cube_not_found", "cube_name")


@case(2, "2.2.3")
def replies_go_to_who_asked(t: Trial) -> None:
    """Replies go to the connection that asked, in its order, however much all of them ask."""
    wires = [t.join() for _ in range(8)]
    for number, wire in enumerate(wires):
        wire.say(*({"type": "ping", "id": [number, n]} for n in range(100)))
    for number, wire in enumerate(wires):
        for n in range(100):
            t.equal(wire.reply("pong").get("id"), [number, n], "the id")
    for wire in wires:
        t.fence(wire)


@case(3, "2.2.5")
def errors_go_to_who_erred(t: Trial) -> None:
    """Another's error is not heard of."""
    one, two = t.join(), t.join()
    t.refused(one, {"type": "fly"}, "unknown_type")
    one.send(b"rubbish<???DONE???---")
    t.error(one.reply("an error"), {"bad_json", "bad_frame"})
    t.fence(two)


@case(4, "2.2.5")
def others_commands_are_not_heard_of(t: Trial) -> None:
    """What others do makes no frame for who did not subscribe."""
    one, two = t.join(), t.join()
    name = t.spawn(one)
    t.ask(one, {"type": "apply_physics", "cube_name": name, "force": [0, 1, 0]}, "physics_applied")
    t.ask(one, {"type": "despawn_cube", "cube_name": name}, "cube_despawned")
    t.fence(two)


@case(5, "3.6.1")
def a_race_for_a_name(t: Trial) -> None:
    """Of clients that spawn a cube of one name at the same time, one succeeds and the others get cube_exists."""
    wires = [t.join() for _ in range(6)]
    name = t.name()
    for wire in wires:
        wire.say({"type": "spawn_cube", "cube_name": name, "position": t.at(), "list": False})
    replies = [wire.reply("a reply") for wire in wires]
    outcomes = sorted(reply["code"] if reply["type"] == "error" else reply["type"] for reply in replies)
    t.equal(outcomes, ["cube_exists"] * 5 + ["cube_list"], "the replies")


@case(6, "4.create_joint", needs=("joint.fixed",))
def joining_others_cubes(t: Trial) -> None:
    """A client joins cubes that others spawned."""
    one, two, three = t.join(), t.join(), t.join()
    first, second = t.base(one), t.base(two, position=t.at(1.5))
    joint = t.join_cubes(three, first, second)
    t.equal(t.info(one, second)["joints"], [joint], "joints as another sees them")


@case(7, "1.2.1")
def half_a_message_keeps_nobody_waiting(t: Trial) -> None:
    """A client that stops in the middle of a message keeps no other waiting."""
    stuck, wire = t.join(), t.join()
    stuck.send(b'{"type":"spawn_cube","cube_name":"')
    for _ in range(10):
        t.fence(wire)


@case(8, "1.2.1")
def at_the_same_time(t: Trial) -> None:
    """Eight clients that talk at the same time get all their replies."""
    wires = [t.join() for _ in range(8)]
    names = [[t.name() for _ in range(20)] for _ in wires]
    wrong: list[BaseException] = []

    def talk(number: int) -> None:
        try:
            for name in names[number]:
                t.spawn(wires[number], cube_name=name, is_base=False)
                t.info(wires[number], name)
                t.ask(wires[number], {"type": "despawn_cube", "cube_name": name}, "cube_despawned")
        except BaseException as error:  # told in the case's own thread
            wrong.append(error)

    threads = [threading.Thread(target=talk, args=(number,)) for number in range(len(wires))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if wrong:
        raise wrong[0]
    for wire in wires:
        t.fence(wire)


@case(9, "2.2.1")
def a_hundred_clients(t: Trial) -> None:
    """A hundred connections are served at once."""
    wires = [t.join() for _ in range(100)]
    for n, wire in enumerate(wires):
        wire.say({"type": "ping", "id": n})
    for n, wire in enumerate(wires):
        t.equal(wire.reply("pong").get("id"), n, "the id")


@case(10, "4.get_world_info", needs=("get_world_info",), scope=Scope.HOST)
def clients_are_counted(t: Trial) -> None:
    """The world counts the clients that are in it, until they leave."""
    wire = t.join()

    def now() -> int:
        return int(t.ask(wire, {"type": "get_world_info"}, "world_info")["counts"]["clients"])

    def count() -> int:
        """Waits until those that have left are gone: a server hears of it in its own time."""
        counts = [now()]
        while len(counts) < 5 or len(set(counts[-5:])) > 1:
            t.true(len(counts) < LOOKS, "a number that stays the same when nobody comes or goes", counts[-5:])
            t.sleep(0.05)
            counts.append(now())
        return counts[-1]

    before = count()
    others = [t.join() for _ in range(3)]
    t.equal(count(), before + 3, "clients with three more")
    for other in others:
        other.hang_up()
        other.rest()
    t.equal(count(), before, "clients when they have left")


@case(11, "2.1.1")
def both_dialects_in_one_world(t: Trial) -> None:
    """Clients of both dialects are in the same world."""
    one, two = t.join(), t.raw()
    name = t.name()
    two.say({"type": "spawn_cube", "cube_name": name, "position": t.at()}, {"type": "ping", "id": 1})
    t.equal(two.reply("pong").get("id"), 1, "the id")
    t.true(name in t.cubes(one), f"{name} in the list of the json dialect", name)
