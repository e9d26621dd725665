"""Servers with a defect in roles: commands that are not judged, things that belong to the wrong player, weak tokens."""

from __future__ import annotations

from typing import Any

from pytest import MonkeyPatch

from defects import around, defect
from nmes.errors import RejectedMessage
from nmes.protocol import Auth
from nmes.server.keys import Keys, Seat
from nmes.world import World
from nmes.world.clients import Client, Clients
from nmes.world.commands import RIGHTS
from nmes.world.rights import Right, nothing
from nmes.world.roles import Role

CONFIG: dict[str, Any] = {"roles": {"player": {}, "viewer": {}}}


@defect("20.1", config=CONFIG)
def everybody_is_one_player(patch: MonkeyPatch) -> None:
    """It takes everybody for the first player."""
    join = Clients.join
    patch.setattr(Clients, "join", lambda clients, name, player: join(clients, name, 1))


@defect("20.2", config=CONFIG)
def any_role_will_do(patch: MonkeyPatch) -> None:
    """It lets somebody in who asks for a role that there is not."""
    seat = Keys.seat

    def lenient(keys: Keys, world: str, auth: Auth) -> Seat:
        try:
            return seat(keys, world, auth)
        except RejectedMessage as error:
            if error.code != "role_not_found":
                raise
            return Seat("player", None)

    patch.setattr(Keys, "seat", lenient)


def unjudged(patch: MonkeyPatch, kind: str) -> None:
    """Has a command not look at whose things are."""
    patch.setitem(RIGHTS, kind, Right("act", nothing))


@defect("20.3:despawn_cube", "20.7", config=CONFIG)
def anybodys_cubes_are_despawned(patch: MonkeyPatch) -> None:
    """It despawns another's cube."""
    unjudged(patch, "despawn_cube")


@defect("20.3:set_color", config=CONFIG)
def anybodys_cubes_are_painted(patch: MonkeyPatch) -> None:
    """It paints another's cube."""
    unjudged(patch, "set_color")


@defect("20.3:give", config=CONFIG)
def anybodys_cubes_are_given(patch: MonkeyPatch) -> None:
    """It gives away what is not the giver's."""
    unjudged(patch, "give")


@defect("20.4", config=CONFIG)
def one_own_cube_is_enough_for_a_joint(patch: MonkeyPatch) -> None:
    """It joins a player's cube to another's."""
    unjudged(patch, "create_joint")


@defect("20.5:step", config=CONFIG)
def a_player_moves_time_on(patch: MonkeyPatch) -> None:
    """It lets a player step."""
    unjudged(patch, "step")


@defect("20.5:reset", config=CONFIG)
def a_player_resets(patch: MonkeyPatch) -> None:
    """It lets a player reset the world."""
    unjudged(patch, "reset")


@defect("20.6", config=CONFIG)
def a_viewer_builds(patch: MonkeyPatch) -> None:
    """It lets a viewer spawn cubes."""
    unjudged(patch, "spawn_cube")
    require = Role.require

    def lenient(role: Role, world: World, client: Client, command: dict[str, Any]) -> None:
        if command["type"] != "spawn_cube":
            require(role, world, client, command)

    patch.setattr(Role, "require", lenient)


@defect("20.7", config=CONFIG)
def a_batch_is_judged_as_a_whole(patch: MonkeyPatch) -> None:
    """It judges a batch, and none of its parts."""
    require = Role.require

    def lenient(role: Role, world: World, client: Client, command: dict[str, Any]) -> None:
        if not world.in_batch:
            require(role, world, client, command)

    patch.setattr(Role, "require", lenient)


@defect("20.8", "20.9", config=CONFIG)
def tokens_are_not_looked_at(patch: MonkeyPatch) -> None:
    """It takes who says a token for somebody new."""
    seat = Keys.seat

    def forgetful(keys: Keys, world: str, auth: Auth) -> Seat:
        return seat(keys, world, Auth(auth.dialect, auth.password, auth.world, role=auth.role))

    patch.setattr(Keys, "seat", forgetful)


@defect("20.9", config=CONFIG)
def a_players_number_is_enough(patch: MonkeyPatch) -> None:
    """It takes who says the number of a player for that player, whatever else the token is."""
    patch.setattr("nmes.server.keys._player", lambda key, role, token: int(token.partition("-")[0] or "1", 36))


@defect("20.10", config=CONFIG)
def a_gift_leaves_its_joints_behind(patch: MonkeyPatch) -> None:
    """It gives the one cube that is named, without what is joined to it."""
    patch.setattr(
        "nmes.world.commands.ownership.connected_cubes",
        lambda cube, joints: [cube],
    )


@defect("20.11", config=CONFIG)
def gifts_to_nobody(patch: MonkeyPatch) -> None:
    """It gives to players who have never come."""
    patch.setattr(World, "require_player", lambda world, player: None)


@defect("20.12", config=CONFIG)
def the_owner_is_a_player_too(patch: MonkeyPatch) -> None:
    """It lets the owner do no more than a player."""
    around(patch, "despawn_cube", lambda answer, world, client, command: _as_player(answer, world, client, command))


def _as_player(answer: Any, world: World, client: Client, command: dict[str, Any]) -> dict[str, Any]:
    world.roles["player"].require(world, client, command)
    return dict(answer(world, client, command))
