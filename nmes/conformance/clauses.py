"""The sentences of the protocol that cases refer to, by address: section, paragraph (or table), sentence (or row).

The words are those of docs/protocol.md, which a test compares. Section 4 is made of messages, so its addresses are
`4.spawn_cube`, and their sentences come from the schemas.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from nmes.protocol import COMMANDS, ERROR_CODES, EVENTS

__all__ = ["CLAUSES", "UNTESTED", "sentence"]

_PROSE: Final[Mapping[str, str]] = {
    "1.1.1": "TCP, or TLS over it, as the host is set up.",
    "1.1.2": "UTF-8 JSON objects, each followed by the 14 bytes `<???DONE???---`.",
    "1.1.3": "White space around a message (a newline typed in netcat) is ignored, and so is an empty frame.",
    "1.2.1": "Frames are split on raw bytes, before decoding.",
    "1.2.2": "The delimiter is legal inside a JSON string, so an encoder writes `<` as `\\u003c` inside "
    "strings; a peer that does not gets a parse error, not a hang.",
    "1.3.1": "JSON is strict (RFC 8259 as narrowed by I-JSON, RFC 7493)",
    "1.3.2": "no NaN or Infinity, nor a number like `1e400` that becomes one",
    "1.3.3": "no duplicate keys",
    "1.3.4": "no lone surrogates",
    "1.3.5": "valid UTF-8",
    "1.3.6": "nesting at most 200 deep",
    "1.4.1": "a client's frame before auth | 16 KiB | `frame_too_large`, closed",
    "1.4.2": "a client's frame after auth | 1 MiB | `frame_too_large`, closed",
    "1.4.3": "time until auth | 5 s | `auth_timeout`, closed",
    "1.4.4": "time without a frame in either direction | 5 min; a `ping` keeps the connection open | closed",
    "1.4.5": "bytes that a peer leaves unread | 8 MiB, or 10 s | `slow_consumer`, closed",
    "1.4.6": "connections to a host, or to each worker of one | 1,024 | `too_many_connections`, closed",
    "1.4.7": "cubes and joints in a world | 10,000 and 20,000 | `limit_reached`",
    "2.1.1": "The first frame decides: one that begins with `{` is JSON, anything else is a bare password",
    "2.2.1": "accepted | [`auth_success`](messages.md#auth_success) | the bare text `auth_success`",
    "2.2.2": "refused | `error` `auth_failed`, closed | the bare text `auth_failed`, closed",
    "2.2.3": "every command gets exactly one reply, in order, with its `id` if it had one",
    "2.2.4": "silent, on success **and** on failure, after `spawn_cube`, `despawn_cube`, `apply_force`, "
    "`apply_physics`, `freeze_cube` and `set_color`; everything else replies as in the json dialect, but in the "
    "words of the original, see below",
    "2.2.5": "frames not asked for | only after `subscribe` | only after `subscribe`",
    "2.3.1": 'An `auth` with `"list": true` enters no world: it is answered by '
    "[`world_list`](messages.md#world_list), and the connection is closed.",
    "2.4.1": "A silent command that fails is still recorded, with its error.",
    "2.4.2": "Passwords are compared in constant time and never logged or recorded.",
    "2.4.3": "One failed auth costs the peer 1 s before the answer.",
    "2.4.4": "A frame that is no JSON object has no type by which to tell that silence is due: it gets an "
    "`error` in both dialects.",
    "2.5.1": "`apply_force` with a `force` | `apply_physics` with that `impulse`: the velocity changes at once by "
    "force / mass",
    "2.5.2": "`apply_physics` with a `central_impulse` | `impulse`",
    "2.5.3": "`create_joint` without `joint_name` | the name `joint_<type>_<cube1>_<cube2>`, the type and the cubes as "
    "the client calls them",
    "2.5.4": "`create_joint`, `create_bone` with a name that is taken | another joint, whose name has a number behind "
    "it: `hip_2`, `hip_3`.",
    "2.5.5": "`set_joint_param`, `set_joint_params` | likewise; both are answered by `joint_param_set`, which repeats "
    "`param_name` and `value`, or `params`",
    "2.5.6": "`get_joint_info` | `params` in the original's words, numbers all: 1.0 for true, 0.0 for false",
    "2.5.7": '`set_color` with `hex`: `"#FFFF00"`, with opacity `"#FFFF00FF"` | `color`',
    "2.5.8": "without effect: kept as the joint's `notes`, and told back by `get_joint_info`",
    "3.1.1": "SI units: metres, kilograms, seconds, newtons, radians.",
    "3.1.2": "Right-handed, **Y up**, gravity (0, -9.81, 0) on the flat ground `y = 0`.",
    "3.1.3": "Vectors are arrays of 3 numbers, also in a planar world (where z, and rotation about x and y, "
    "are 0 in every answer and ignored in every command).",
    "3.1.4": "A rotation in a command is 3 numbers (Euler angles in radians, applied in the order Y, X, Z) or "
    "4 (a quaternion `[x, y, z, w]`).",
    "3.1.5": "Answers carry both: `rotation` (3) and `quaternion` (4).",
    "3.2.1": "Fields that are not known are ignored; a type that is not known gets `unknown_type`.",
    "3.2.2": "Any JSON value is allowed as `id`.",
    "3.2.3": "Names are 1 to 128 printable characters without white space.",
    "3.3.1": "Anything that is not a valid command gets an [`error`](messages.md#error) and changes nothing.",
    "3.3.2": "Its `field` is the JSON Pointer of the value that is to blame, without the leading slash",
    "3.3.3": "A batch that holds an invalid command is refused as a whole; one whose commands are valid but "
    "cannot all be done is done as far as it can.",
    "3.4.1": "A world advances in ticks of `1 / tick_rate` s (60 a second by default), each of `substeps` "
    "engine steps (4 by default).",
    "3.4.2": "`frame` counts ticks, `t = frame / tick_rate`.",
    "3.4.3": "Modes: `realtime` (the default: ticks by the clock), `lockstep` (only when told to `step`), "
    "`fast` (as fast as it can).",
    "3.4.4": "Commands act in the order in which the host received them, before the next tick; a force acts "
    "during the next tick only.",
    "3.4.5": "A `realtime` world whose ticks take longer than they should makes up for a quarter of a second, and lets "
    "go what it is behind beyond that.",
    "3.4.6": "Where that was more than half a second, it lags: those who subscribed, to whatever events, are told by "
    "[`lagging`](messages.md#lagging) once a second how fast it runs and how much it let go, and once more, with "
    "`over`, when it keeps up again or no longer ticks by the clock.",
    "3.5.1": "After `set_mode` with `lockstep` and `barrier`, a `step` waits: the world ticks when every "
    "connection that controls it has said `step`, and then all get their answers, with the same "
    "`frame`.",
    "3.5.2": "`agents` says how many have to be there before the first tick, so that nobody starts alone.",
    "3.5.3": "Who keeps the others waiting for longer than `timeout` is told of by `barrier_timeout` to those "
    "who subscribed, and counts again when it says `step` again.",
    "3.5.4": "A fault, or another `set_mode`, ends the waiting.",
    "3.5.5": "With a barrier, a batch holds no `step`.",
    "3.6.1": "A cube spawned without `cube_name` is called `cube_<n>_<8 hex digits>`, the digits drawn from "
    "the world's seed, so that a name is never used twice in a world and a replay gives the same "
    "names.",
    "3.6.2": "With `is_base` the cube starts frozen and `_BASE` is appended to its name.",
    "3.6.3": "A connection owns the cube that it spawned last; commands that may omit `cube_name` mean that one.",
    "3.6.4": "Cubes outlive their connection.",
    "3.6.5": "`cube_list` is in order of creation.",
    "3.7.1": "`spawn_creature` makes the body of a [genome](genomes.md) live, all of it or nothing: cubes and joints "
    "that are called `NAME.id`.",
    "3.7.2": "`sense` reads all its sensors and `drive` aims all its motors, each by one list of numbers in the order "
    "that `creature_spawned` tells.",
    "3.7.3": "`target` is what its sensors of a target are about: a point or a cube, which need not be there yet.",
    "3.7.4": "A creature is nothing but its cubes and joints: what is taken away, or cut off from its root, is no part "
    "of it any more; without its root it is a creature no more, and what is left stays.",
    "3.7.5": "Sensors of parts that it has lost read 0, and motors there do nothing: its values and controls stay as "
    "many as they were.",
    "3.7.6": "A creature whose genome has rules of `development` follows them by itself from its first drive on, ten "
    "times a second.",
    "3.8.1": "A world's config may name `collision_groups`: cubes of groups that pass through each other do not "
    "collide, all others do.",
    "3.8.2": "A cube of a group that the config has not is refused.",
    "3.9.1": "A world's config may name `channels`: what a cube says on one is heard by others in range from the next "
    "tick on, the nearest first, until it says something else there, falls silent or is gone.",
    "3.9.2": "What is said or heard on a channel that the config has not, or with other numbers than it has, is "
    "refused.",
    "3.10.1": "Each connection then has a role, and is a player's.",
    "3.10.2": "Cubes belong to the player who spawned them; a joint or a creature is his to whom all its cubes belong.",
    "3.10.3": "A command that the role may not do, or not to what is another's, gets `not_allowed` and changes nothing",
    "3.10.4": "of a batch, each part is judged by itself.",
    "3.10.5": "The `token` of `auth_success`, said in `auth`, makes a connection the same player's.",
    "3.10.6": "`give` makes a cube or a creature, with all that joints connect to it, another player's.",
    "5.1.1": "Required of every conforming server: sections 1 to 3, and the commands that messages.md says "
    "every server must have (of the joints `fixed`, `hinge` and `slide`).",
    "5.1.2": "The rest is optional and named in the `capabilities` of `world_info`; a server answers a command"
    " that it does not have with `unsupported` or `unknown_type`.",
}

CLAUSES: Final[Mapping[str, str]] = {
    **_PROSE,
    **{
        f"4.{kind}": f"{kind}: {command.schema['description']} Answered by {command.reply}."
        for kind, command in COMMANDS.items()
    },
    **{f"4.{kind}": f"{kind}: {event.schema['description']}" for kind, event in EVENTS.items()},
    **{f"4.error.{code}": f"{code}: {meaning}" for code, meaning in ERROR_CODES.items()},
}
"""Every sentence by its address."""

UNTESTED: Final[Mapping[str, str]] = {
    "1.1.1": "cases speak plain TCP",
    "2.4.1": "what a server records is not on the wire",
    "3.4.5": "a server is not slowed down from outside",
    "3.4.6": "a server is not slowed down from outside",
    "4.barrier_timeout": "see 3.5.3",
    "4.census": "only a world that lives tells it",
    "4.creature_changed": "see 3.7.5",
    "4.error.no_room": "see 4.grow",
    "4.creature_born": "only a world that lives tells it",
    "4.creature_died": "only a world that lives tells it",
    "4.food_eaten": "only a world that lives tells it",
    "4.host_draining": "a server is not ended from outside",
    "4.lagging": "see 3.4.6",
    "4.world_closed": "a server is not closed from outside",
    "4.world_fault": "an engine is not made to fail from outside",
    "4.error.auth_failed": "see 2.2.2",
    "4.error.auth_timeout": "see 1.4.3",
    "4.error.bad_json": "see 1.3.1 to 1.3.6",
    "4.error.frame_too_large": "see 1.4.1 and 1.4.2",
    "4.error.unsupported": "see 5.1.1 and 5.1.2",
    "4.error.limit_reached": "see 1.4.7",
    "4.error.slow_consumer": "see 1.4.5",
    "4.error.too_many_connections": "see 1.4.6",
    "4.error.host_draining": "a server is not ended from outside",
    "4.error.world_faulted": "an engine is not made to fail from outside",
    "4.error.world_exists": "only a server that creates worlds tells it",
    "4.error.template_not_found": "only a server that creates worlds tells it",
    "4.error.world_unavailable": "it depends on how the server is set up",
    "4.error.world_moved": "only a server of several processes tells it",
    "4.error.internal": "a server is not made to fail from outside",
}
"""Sentences without a case of their own, and why."""


def sentence(address: str) -> str:
    """Returns the words at an address."""
    return CLAUSES[address]
