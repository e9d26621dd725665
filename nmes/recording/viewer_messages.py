"""A world as viewers see it: poses and shapes in the Protobuf messages of Foxglove.

Each cube is a coordinate frame that moves in the frame `ROOT` and carries one box, or what its shape is made of. Poses
are rounded to float32: viewers draw no finer, and it halves what they take up. For what is exact there are digests.

Rerun knows no scene updates. For it each box is written once more, as a grid of one voxel in its cube's frame; what is
round is seen there as the box that it fills (`nmes view` draws it as it is).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.VoxelGrid_pb2 import VoxelGrid
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from nmes.backend import Array, Quaternion, Vector
from nmes.backend.rotation import rotate
from nmes.backend.shapes import ROUND, axis, lying, misfit
from nmes.backend.shapes import Shape as Form

if TYPE_CHECKING:
    from nmes.world import World

__all__ = [
    "BOX_SCHEMA",
    "POSES_SCHEMA",
    "POSE_FIELDS",
    "ROOT",
    "SCENE_SCHEMA",
    "Painter",
    "Shape",
    "Snapshot",
    "View",
    "decode_poses",
    "decode_shapes",
    "descriptors",
]

ROOT = "world origin"  # no cube can have a name with white space in it
POSES_SCHEMA = FrameTransforms.DESCRIPTOR.full_name
SCENE_SCHEMA = SceneUpdate.DESCRIPTOR.full_name
_KIND, _SIZE = "shape", "size"  # keys of an entity's metadata
BOX_SCHEMA = VoxelGrid.DESCRIPTOR.full_name
_MESSAGES = {message.DESCRIPTOR.full_name: message for message in (FrameTransforms, SceneUpdate, VoxelGrid)}

POSE_FIELDS = (*(f"position/{i}" for i in range(3)), *(f"quaternion/{i}" for i in range(4)))
Pose = tuple[float, float, float, float, float, float, float]  # position, quaternion (x, y, z, w)


Color = tuple[float, float, float, float]
Shape = tuple[Vector, Color, Form]  # edge lengths, colour, one of nmes.backend.shapes


class Snapshot(NamedTuple):
    """The cubes of a world at one frame, not made into messages yet.

    Attributes:
        frame: The frame.
        states: The states of all cubes, an array (n, 13) as of `World.poses`.
        shapes: The shapes of all cubes where they may have changed, else None.
    """

    frame: int
    states: Array
    shapes: dict[str, Shape] | None


class View(NamedTuple):
    """A snapshot as messages: the shapes where they changed since the last view, and all poses.

    Attributes:
        scene: The boxes that are new, changed or gone, or None.
        poses: All poses.
        boxes: The boxes of `scene` once more, a message each, by cube; that of a cube that is gone is an empty grid.
    """

    scene: bytes | None
    poses: bytes
    boxes: dict[str, bytes]


class Painter:
    """Turns one world's states into messages, one view after the other.

    Looking at the world (`look`) is quick and drawing what was seen (`draw`) can wait; both go in the same order.
    """

    def __init__(self, world: World) -> None:
        """Begins with no cubes drawn."""
        self._world = world
        self._rate: int = world.config["tick_rate"]
        self._version = -1
        self._shapes: dict[str, Shape] = {}
        self._transforms = FrameTransforms()
        # Setting the fields of messages that are there takes a third of the time of making new ones.
        self._handles: list[tuple[Any, Any, Any]] = []

    def look(self) -> Snapshot:
        """Takes a snapshot of the world as it is now."""
        world = self._world
        names, states = world.poses()
        if world.structure_version == self._version:
            return Snapshot(world.frame, states, None)
        self._version = world.structure_version
        return Snapshot(world.frame, states, {name: world.cube_shape(name) for name in names})

    def draw(self, snapshot: Snapshot) -> View:
        """Makes the messages of a snapshot, for viewers that have those of all snapshots before."""
        seconds, ticks = divmod(snapshot.frame, self._rate)
        nanos = ticks * 1_000_000_000 // self._rate
        scene: bytes | None = None
        boxes: dict[str, bytes] = {}
        if snapshot.shapes is not None:
            scene, boxes = self._changed(snapshot.shapes, seconds, nanos)
        poses: list[Pose] = snapshot.states[:, :7].astype(np.float32).tolist()
        for (timestamp, position, rotation), pose in zip(self._handles, poses, strict=True):
            timestamp.seconds, timestamp.nanos = seconds, nanos
            position.x, position.y, position.z, rotation.x, rotation.y, rotation.z, rotation.w = pose
        return View(scene, bytes(self._transforms.SerializeToString()), boxes)

    def _changed(self, shapes: dict[str, Shape], seconds: int, nanos: int) -> tuple[bytes | None, dict[str, bytes]]:
        if list(shapes.items()) == list(self._shapes.items()):
            return None, {}
        update = SceneUpdate()
        boxes: dict[str, bytes] = {}
        for name in self._shapes:
            if name not in shapes:
                gone = update.deletions.add(type=SceneEntityDeletion.MATCHING_ID, id=name)
                gone.timestamp.seconds, gone.timestamp.nanos = seconds, nanos
                boxes[name] = _box(name, self._shapes[name][0], None, seconds, nanos)
        for name, shape in shapes.items():
            if self._shapes.get(name) != shape:
                entity = update.entities.add(id=name, frame_id=name, frame_locked=True)
                entity.timestamp.seconds, entity.timestamp.nanos = seconds, nanos
                _add_solid(entity, shape)
                boxes[name] = _box(name, shape[0], shape[1], seconds, nanos)
        self._shapes = shapes
        self._transforms.Clear()
        self._handles = []
        for name in shapes:
            transform = self._transforms.transforms.add(parent_frame_id=ROOT, child_frame_id=name)
            self._handles.append((transform.timestamp, transform.translation, transform.rotation))
        return bytes(update.SerializeToString()), boxes


def _add_solid(entity: SceneEntity, shape: Shape) -> None:
    """Adds what a shape looks like to its entity: a box, a ball, a cylinder, or one between two balls.

    An entity of what is no box says in its metadata what it is.
    """
    size, color, kind = shape
    if kind == "box":
        _paint(entity.cubes.add(), size, color)
        return
    entity.metadata.add(key=_KIND, value=kind)
    entity.metadata.add(key=_SIZE, value=" ".join(map(repr, size)))
    along, across = size[axis(size)], size[axis(size) - 1]
    turn = lying(size)
    if kind != "sphere":
        length = along if kind == "cylinder" else along - across
        cylinder = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0)
        _paint(cylinder, (across, across, length), color, turn=turn)
    if kind != "cylinder":
        for end in (0.0,) if kind == "sphere" else (-0.5, 0.5):
            _paint(entity.spheres.add(), (across,) * 3, color, rotate(turn, (0.0, 0.0, end * (along - across))))


def _paint(
    thing: Any,
    size: Vector,
    color: Color,
    place: Vector = (0.0, 0.0, 0.0),
    turn: Quaternion = (0.0, 0.0, 0.0, 1.0),
) -> None:
    """Gives a thing of an entity its size, colour and pose."""
    thing.size.x, thing.size.y, thing.size.z = size
    thing.color.r, thing.color.g, thing.color.b, thing.color.a = color
    if any(place):  # else the message would have a position of zeros, which old recordings have not
        thing.pose.position.x, thing.pose.position.y, thing.pose.position.z = place
    turned = thing.pose.orientation
    turned.x, turned.y, turned.z, turned.w = turn


def _box(name: str, size: Vector, color: Color | None, seconds: int, nanos: int) -> bytes:
    """Makes a cube's box as a grid of one voxel; an empty grid where it has no colour."""
    # A field that is zero is not written, and Rerun goes on with what it had; so of nothing only the data are empty.
    grid = VoxelGrid(frame_id=name, row_count=1, column_count=1, cell_stride=4, row_stride=4, slice_stride=4)
    grid.timestamp.seconds, grid.timestamp.nanos = seconds, nanos
    grid.pose.orientation.w = 1.0
    for offset, field in enumerate(("red", "green", "blue", "alpha")):
        grid.fields.add(name=field, offset=offset, type=PackedElementField.UINT8)
    grid.cell_size.x, grid.cell_size.y, grid.cell_size.z = size
    # A grid lies with its corner at its origin, a cube with its middle.
    grid.pose.position.x, grid.pose.position.y, grid.pose.position.z = (-edge / 2 for edge in size)
    if color is not None:
        grid.data = bytes(round(255 * part) for part in color)
    return bytes(grid.SerializeToString())


def decode_poses(data: bytes) -> dict[str, Pose]:
    """Returns the poses in a transforms message by cube.

    Raises:
        ValueError: The bytes are no such message.
    """
    try:
        message = FrameTransforms.FromString(data)
    except Exception as error:  # the class of the decoder's errors depends on its build
        raise ValueError("not a transforms message") from error
    return {
        transform.child_frame_id: (
            *(transform.translation.x, transform.translation.y, transform.translation.z),
            *(transform.rotation.x, transform.rotation.y, transform.rotation.z, transform.rotation.w),
        )
        for transform in message.transforms
    }


def decode_shapes(data: bytes, known: Mapping[str, Shape]) -> dict[str, Shape]:
    """Returns the shapes of all cubes after a scene message, given those before it.

    Raises:
        ValueError: The bytes are no such message.
    """
    try:
        update = SceneUpdate.FromString(data)
    except Exception as error:  # as above
        raise ValueError("not a scene message") from error
    gone = {deletion.id for deletion in update.deletions}
    shapes = {name: shape for name, shape in known.items() if name not in gone}
    for entity in update.entities:
        for thing in (*entity.cubes, *entity.cylinders, *entity.spheres):
            size, color = thing.size, thing.color
            rgba = color.r, color.g, color.b, color.a
            shapes[entity.id] = _kind(entity, (size.x, size.y, size.z), rgba)
    return shapes


def _kind(entity: SceneEntity, size: Vector, color: Color) -> Shape:
    """Returns the shape of an entity that holds a thing of some size and colour.

    Raises:
        ValueError: It is something else than it says.
    """
    said = {pair.key: pair.value for pair in entity.metadata}
    if _KIND not in said:
        return size, color, "box"
    edges = [float(edge) for edge in said.get(_SIZE, "").split()[:4]]
    kind = next((form for form in ROUND if form == said[_KIND]), None)
    if kind is None or len(edges) != 3 or not min(edges) > 0.0 or misfit(kind, edges) is not None:
        raise ValueError("not a scene message")
    return (edges[0], edges[1], edges[2]), color, kind


@cache
def descriptors(name: str) -> bytes:
    """Makes the schema that an MCAP file carries for one of the messages: its descriptor and all that it needs."""
    files, names = FileDescriptorSet(), set()

    def add(file: FileDescriptor) -> None:
        if file.name not in names:
            names.add(file.name)
            for dependency in file.dependencies:
                add(dependency)
            file.CopyToProto(files.file.add())

    add(_MESSAGES[name].DESCRIPTOR.file)
    return bytes(files.SerializeToString())
