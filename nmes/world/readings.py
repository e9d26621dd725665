"""Readings of cubes and joints, as replies have them: states, contacts by face, inertial sensors, distances, pictures.

Hides how a face is told from a contact's normal, what frame a reading is in, and the PNG format.

Invariant: reading changes nothing.
"""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Iterable, Mapping

import numpy as np

from nmes import protocol
from nmes.backend import CameraSpec, Contact, Image, Quaternion, Vector
from nmes.backend.rotation import conjugate, euler_from_quaternion, multiply, normalize, plus, rotate
from nmes.errors import WorldError
from nmes.schemas.documents import JsonObject
from nmes.world.entities import Cube, Entities, Joint, identity
from nmes.world.fields import unit_vector
from nmes.world.subscription import moving_part

__all__ = [
    "camera",
    "contact_list",
    "cube_info",
    "cube_state",
    "cube_states",
    "face_of",
    "inertial",
    "joint_info",
    "own_axes",
    "png",
    "ranges",
]


def cube_state(entities: Entities, cube: Cube) -> JsonObject:
    """Returns the pose and velocities of a cube, as `cube_state` has them."""
    state = entities.simulation.body_state(cube.body)
    return {
        "cube_name": cube.name,
        "position": state.position,
        "rotation": euler_from_quaternion(state.quaternion),
        "quaternion": state.quaternion,
        "linear_velocity": state.linear_velocity,
        "angular_velocity": state.angular_velocity,
    }


def cube_info(entities: Entities, cube: Cube) -> JsonObject:
    """Returns all that is known of a cube, as `cube_info` has it."""
    simulation = entities.simulation
    reply = cube_state(entities, cube)
    reply["size"] = cube.size
    if cube.shape != "box":
        reply["shape"] = cube.shape
    reply["mass"] = cube.mass
    reply["friction"] = cube.friction
    reply["restitution"] = cube.restitution
    reply["color"] = cube.color
    if cube.group is not None:
        reply["group"] = cube.group
    reply["frozen"] = cube.frozen
    reply["sleeping"] = simulation.sleeping(cube.body)
    reply["joints"] = list(cube.joints)
    reply["contacts"] = contact_list(simulation.contacts(cube.body), reply["quaternion"], entities.body_names)
    return reply


def joint_info(entities: Entities, joint: Joint) -> JsonObject:
    """Returns a joint's state and parameters, as `joint_info` has them."""
    reading = entities.simulation.joint_state(joint.number)
    reply: JsonObject = {
        **identity(joint),
        "anchor": reading.anchor,
        "axis": reading.axis,
        "position": reading.position,
        "velocity": reading.velocity,
        "effort": reading.effort,
        "params": joint.params,
    }
    if joint.notes:
        reply["notes"] = joint.notes
    return reply


def cube_states(entities: Entities, cubes: list[Cube], sensors: bool = False) -> list[JsonObject]:
    """Returns the poses and velocities of cubes, as `world_state` has them, with the readings of their `sensors`."""
    simulation = entities.simulation
    states = simulation.states([cube.body for cube in cubes]).tolist()
    parts = [moving_part(cube.name, state) for cube, state in zip(cubes, states, strict=True)]
    if sensors:
        for cube, part, reading in zip(cubes, parts, inertial(entities, cubes), strict=True):
            contacts = simulation.contacts(cube.body)
            part["contacts"] = contact_list(contacts, part["quaternion"], entities.body_names)
            part.update(reading)
    return parts


def inertial(entities: Entities, cubes: list[Cube]) -> list[JsonObject]:
    """Returns the readings of the cubes' accelerometers (m/s²) and gyros (rad/s), each along the cube's own axes.

    Raises:
        WorldError: `unsupported`.
    """
    entities.require("sensors.inertial", "accelerometers and gyros", "sensors")
    bodies, simulation = [cube.body for cube in cubes], entities.simulation
    states, accelerations = simulation.states(bodies).tolist(), simulation.proper_accelerations(bodies).tolist()
    return [
        {"accelerometer": own_axes(state[3:7], acceleration), "gyro": own_axes(state[3:7], state[10:13])}
        for state, acceleration in zip(states, accelerations, strict=True)
    ]


def ranges(entities: Entities, cube: Cube, rays: list[list[float]], limit: float) -> list[float | None]:
    """Returns the distances (m, up to `limit`) from a cube's centre along rays in its own frame; None: nothing there.

    Raises:
        WorldError: `unsupported`, or `invalid` for a ray without a direction.
    """
    entities.require("sensors.range", "range finder", "rays")
    quaternion = entities.simulation.body_state(cube.body).quaternion
    directions = []
    for i, ray in enumerate(rays):
        unit = unit_vector(entities.fields.position(ray))
        if unit is None:
            path = f"rays/{i}"
            raise WorldError("invalid", f"{path}: must have a direction, and in a planar world one in it", path)
        directions.append(rotate(quaternion, unit))
    if not directions:
        return []
    hits = entities.simulation.hits(cube.body, np.array(directions).reshape(-1, 3), limit)
    return [None if hit is None else hit.distance for hit in hits]


def camera(entities: Entities, cube: Cube, command: JsonObject) -> JsonObject:
    """Returns the picture of the camera that a `get_camera` command describes, as `camera_image` has it.

    Raises:
        WorldError: `unsupported`, or `invalid` for a rotation that is none.
    """
    entities.require("camera", "cameras")
    fields = {**protocol.COMMANDS["get_camera"].defaults, **command}
    state = entities.simulation.body_state(cube.body)
    position, rotation = entities.fields.position(fields["position"]), entities.fields.rotation(fields["rotation"])
    image = entities.simulation.draw(
        CameraSpec(
            width=fields["width"],
            height=fields["height"],
            fov=float(fields["fov"]),
            position=plus(state.position, rotate(state.quaternion, position)),
            quaternion=normalize(multiply(state.quaternion, rotation)),
        ),
        {other.body: other.color for other in entities.cubes.values()},
    )
    return {"cube_name": cube.name, "width": fields["width"], "height": fields["height"], "image": png(image)}


def own_axes(quaternion: Quaternion, vector: Vector) -> Vector:
    """Turns a world vector into the frame of a cube."""
    return rotate(conjugate(quaternion), vector)


def contact_list(contacts: Iterable[Contact], quaternion: Quaternion, names: Mapping[int, str]) -> list[JsonObject]:
    """Returns a cube's contacts as `cube_info` has them; `names` are those of the engine's bodies."""
    faces: dict[Vector, str] = {}  # most contacts of a cube share their normal with others
    contact_objects = []
    for other, position, normal, force in contacts:
        face = faces.get(normal)
        if face is None:
            face = faces[normal] = face_of(own_axes(quaternion, normal))
        contact_objects.append(
            {
                "cube_name": None if other is None else names[other],
                "face": face,
                "position": position,
                "normal": normal,
                "force": force,
            }
        )
    return contact_objects


def face_of(normal: Vector) -> str:
    """Names the face that is pushed, in the cube's own axes: the normal points from outside through it."""
    x, y, z = (abs(part) for part in normal)
    axis = 0 if x >= y and x >= z else 1 if y >= z else 2
    return ("-" if normal[axis] > 0.0 else "+") + "xyz"[axis]


def png(image: Image) -> str:
    """Encodes a picture as a PNG file, in base64."""
    height, width, _ = image.shape
    # Each row begins with the number of its filter: none.
    rows = np.hstack([np.zeros((height, 1), np.uint8), image.reshape(height, -1)]).tobytes()
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)  # 8 bits each of red, green and blue
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    chunks = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )
    return base64.b64encode(b"\x89PNG\r\n\x1a\n" + b"".join(chunks)).decode()
