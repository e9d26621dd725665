"""Random histories of a world, drawn by Hypothesis: clients join, leave and send commands, and ticks pass."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st

from nmes.protocol import parse
from nmes.world import World

# One world does what random programs do not: owned cubes, subscribers, a barrier, pauses, bones.
FRAMES = [
    b'{"type":"spawn_cube","position":[0,6,0]}',
    b'{"type":"spawn_cube","cube_name":"named","position":[1.5,6,0],"linear_velocity":[0,1,0]}',
    b'{"type":"create_bone","cube1":"named","cube2":"other","snake_id":3}',
    b'{"type":"despawn_cube","cube_name":"named"}',
    b'{"type":"apply_physics","force":[1.1,2.2,3.3],"impulse":[0.1,0,0]}',
    b'{"type":"get_cube_state"}',
    b'{"type":"set_objective","expression":"mean.height + max.speed - time_upright + start.position.x * time"}',
    b'{"type":"set_objective","expression":"energy + cube(\\"named\\").height","name":"other","target":[1,2,3]}',
    b'{"type":"compute_reward"}',
    b'{"type":"compute_reward","objective":"other"}',
    b'{"type":"compute_reward","metric":"distance"}',
    b'{"type":"subscribe","every":2,"position_threshold":0.05}',
    b'{"type":"subscribe","events":["tick"]}',
    b'{"type":"unsubscribe"}',
    b'{"type":"pause"}',
    b'{"type":"resume"}',
    b'{"type":"set_mode","mode":"fast","rate":2}',
    b'{"type":"set_mode","mode":"lockstep","barrier":true,"agents":2,"timeout":3}',
    b'{"type":"set_mode","mode":"lockstep"}',
    b'{"type":"step","ticks":3}',
    b'{"type":"reset","seed":9}',
    b'{"type":"batch","commands":[{"type":"spawn_cube"},{"type":"step","ticks":2},{"type":"get_world_state"}]}',
    b'{"type":"get_world_info"}',
    b'{"type":"nonsense"}',
]
histories = st.lists(
    st.one_of(
        st.tuples(st.just("say"), st.integers(0, 2), st.sampled_from(FRAMES)),
        st.tuples(st.just("tick"), st.integers(1, 5), st.none()),
        st.tuples(st.sampled_from(["join", "leave"]), st.integers(0, 2), st.none()),
    ),
    min_size=1,
    max_size=40,
)


def play_history(world: World, history: list[Any]) -> None:
    for kind, number, frame in history:
        clients = world.clients()
        match kind:
            case "tick":
                for _ in range(number):
                    world.tick()
            case "join":
                world.join()
            case "leave" if clients:
                world.leave(clients[number % len(clients)])
            case "say" if clients:
                world.handle(clients[number % len(clients)], parse(frame))
