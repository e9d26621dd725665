"""Arrays out of files that torch and pickle write, read without either running anything that is in them.

Hides the format of those files. A pickle is a program that calls whatever it names; here nothing that it names is ever
looked up: each name becomes a `Thing`, which keeps what it was called with. So a stranger's file can give wrong
numbers, and nothing else.

Source: the zip files of `torch.save` (a pickle `data.pkl`, and each storage as raw bytes); the protocols of pickle up
to 5, as Python's own reader in Python has them.
"""

from __future__ import annotations

import io
import math
import pickle
import struct
import zipfile
from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar, Final
from zlib import error as ZlibError

import numpy as np

from nmes.backend import Array
from nmes.errors import DocumentError

__all__ = ["Archive", "Thing", "array_of", "read_pickle", "read_tensors"]

_MOST_PICKLE: Final = 1 << 20  # bytes: a few hundred names and shapes, and statistics of 4,096 sensors
_MOST_STORAGE: Final = 1 << 26  # bytes of all arrays that are read, and numbers of one
_MOST_NAMES: Final = 1000  # different classes and functions of a pickle
_LONGEST_NAME: Final = 200  # of a tensor
_SHOWN: Final = 200  # characters of what a reader says of bytes that are wrong
_MOST_ENTRIES: Final = 5000  # of a zip file
_ENTRY: Final = b"PK\x01\x02"  # with which each begins in its table
_STORAGES: Final = {"FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2"}
_NUMPY_TYPES: Final = {"f2", "f4", "f8", "i4", "i8"}
_DAMAGE: Final = (
    *(pickle.UnpicklingError, ValueError, TypeError, KeyError, IndexError, AttributeError, EOFError, OverflowError),
    *(struct.error, ImportError, NotImplementedError, AssertionError, MemoryError, RecursionError),
)
"""What reading bytes that are no sound pickle may raise, as the documentation of pickle says, and what memory does."""


# -- zip files --------------------------------------------------------------------------------------------------------


class Archive:
    """A zip file that is read with bounds.

    Args:
        data: The file's bytes.
        what: What to call it where something is wrong.
    """

    def __init__(self, data: bytes, what: str) -> None:
        """Reads the table of its entries.

        Raises:
            DocumentError: It is no zip file, or has thousands of entries.
        """
        self._what = what
        # Its table is read as a whole, and kept: a file of a few megabytes may have a hundred thousand of them.
        if data.count(_ENTRY) > _MOST_ENTRIES:
            raise _wrong(what, f"has more than {_MOST_ENTRIES:,} entries")
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(data))
        except (zipfile.BadZipFile, *_DAMAGE) as error:
            raise _wrong(what, "is no zip file") from error
        self.names = self._zip.namelist()

    def read(self, name: str, most: int) -> bytes:
        """Returns an entry.

        Raises:
            DocumentError: There is none of that name, it has more than `most` bytes, or it is damaged.
        """
        if name not in self.names:
            raise _wrong(self._what, f"has no {name}")
        entry = self._zip.getinfo(name)
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or entry.flag_bits & 1:
            raise _wrong(self._what, f"has {name} packed in a way that such files are not")
        try:
            with self._zip.open(name) as file:
                data = file.read(most + 1)
        except (zipfile.BadZipFile, ZlibError, *_DAMAGE) as error:
            raise _wrong(self._what, f"is damaged in {name}: {str(error)[:_SHOWN]}") from error
        if len(data) > most:
            raise _wrong(self._what, f"has more than {most:,} bytes in {name}")
        return data


def _wrong(what: str, words: str) -> DocumentError:
    return DocumentError([("", f"{what} {words}")])


# -- pickles ----------------------------------------------------------------------------------------------------------


class Thing:
    """What a pickle calls by a name: which name, with what, and the state that it gave it. It can do nothing.

    Attributes:
        name: The module and the name, such as `torch._utils._rebuild_tensor_v2`.
        args: What it was called with.
        state: What it was to be made of.
    """

    name = ""
    args: tuple[Any, ...]
    state: Any

    # Some are made without being called: so it stands here, and `__init__` does nothing.
    def __new__(cls, *args: Any, **_: Any) -> Thing:
        """Keeps what it is called with."""
        thing = super().__new__(cls)
        thing.args, thing.state = args, None
        return thing

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def __setstate__(self, state: Any) -> None:
        self.state = state

    # Lists, sets and dictionaries of others' making are filled so; nothing of them is asked for.

    def append(self, _: Any) -> None:
        """Takes an item."""

    def extend(self, _: Any) -> None:
        """Takes items."""

    def add(self, _: Any) -> None:
        """Takes an item."""

    def __setitem__(self, _: Any, __: Any) -> None:
        pass


class _Table(dict[Any, Any]):
    """In the place of `collections.OrderedDict`, empty whatever it is made of."""

    def __init__(self, *_: Any) -> None:
        super().__init__()

    def __setstate__(self, _: Any) -> None:
        """Takes nothing."""


# The reader in Python: that in C makes room for as many remembered values as a pickle says there are.
class _Reader(pickle._Unpickler):
    dispatch: ClassVar[dict[int, Callable[[Any], None]]] = {**pickle._Unpickler.dispatch}
    stack: list[Any]
    append: Callable[[Any], None]
    pop_mark: Callable[[], list[Any]]

    def __init__(self, data: bytes, persistent: Callable[[Any], Any]) -> None:
        super().__init__(io.BytesIO(data))
        self._persistent = persistent
        self._types: dict[str, type[Thing]] = {}

    def find_class(self, module: str, name: str) -> Any:
        """Returns the stand-in for a name; nothing is imported."""
        full = f"{module}.{name}"
        if full == "collections.OrderedDict":
            return _Table
        if full not in self._types:
            if len(self._types) == _MOST_NAMES:
                raise pickle.UnpicklingError(f"it names more than {_MOST_NAMES:,} things")
            self._types[full] = type("Thing", (Thing,), {"name": full})
        return self._types[full]

    def get_extension(self, code: int) -> None:
        """Refuses names by number: which they are, the program that reads decides."""
        raise pickle.UnpicklingError(f"it names a thing by the number {code}")

    # A key of tuples within tuples, thousands deep, would end the process where it is hashed.

    def _set_items(self) -> None:
        items = self.pop_mark()
        _check_keys(items[::2])
        for key, value in zip(items[::2], items[1::2], strict=True):
            self.stack[-1][key] = value

    def _set_item(self) -> None:
        value, key = self.stack.pop(), self.stack.pop()
        _check_keys([key])
        self.stack[-1][key] = value

    def _make_dict(self) -> None:
        items = self.pop_mark()
        _check_keys(items[::2])
        self.append(dict(zip(items[::2], items[1::2], strict=True)))

    def _refuse_set(self) -> None:
        raise pickle.UnpicklingError("it has a set, which no such file has")

    dispatch |= {pickle.SETITEMS[0]: _set_items, pickle.SETITEM[0]: _set_item, pickle.DICT[0]: _make_dict}
    dispatch |= dict.fromkeys([pickle.ADDITEMS[0], pickle.FROZENSET[0]], _refuse_set)

    def persistent_load(self, pid: Any) -> Any:
        """Returns the storage that a pickle refers to."""
        return self._persistent(pid)


def _check_keys(keys: Iterable[Any]) -> None:
    for key in keys:
        if type(key) not in (str, int):
            raise pickle.UnpicklingError(f"it has a key that is neither text nor number, but {type(key).__name__}")


def read_pickle(data: bytes, what: str, persistent: Callable[[Any], Any] = lambda pid: None) -> Any:
    """Reads a pickle; what it names becomes a `Thing`, but for `collections.OrderedDict`, which becomes a dict.

    Args:
        data: Its bytes.
        what: What to call it where something is wrong.
        persistent: Returns what the pickle says stands elsewhere.

    Raises:
        DocumentError: It is no sound pickle, or has more than a megabyte.
    """
    if len(data) > _MOST_PICKLE:
        raise _wrong(what, f"is a pickle of {len(data):,} bytes, and at most {_MOST_PICKLE:,} are read")
    try:
        return _Reader(data, persistent).load()
    except _DAMAGE as error:
        raise _wrong(what, f"is no sound pickle: {str(error)[:_SHOWN]}") from error


def array_of(value: Any, what: str) -> Array:
    """Returns an array of numpy's out of a pickle, float64.

    Raises:
        DocumentError: It is none of plain numbers.
    """
    shape, dtype, raw = None, None, None
    if isinstance(value, Thing) and value.name.endswith(".multiarray._reconstruct"):
        if isinstance(value.state, tuple) and len(value.state) == 5:
            _, shape, dtype, in_columns, raw = value.state
            raw = None if in_columns and isinstance(shape, tuple) and len(shape) > 1 else raw
    elif isinstance(value, Thing) and value.name.endswith(".numeric._frombuffer") and len(value.args) == 4:
        raw, dtype, shape, _ = value.args
    kind = _kind(dtype)
    if kind in _NUMPY_TYPES and isinstance(raw, bytes | bytearray) and _is_shape(shape):
        assert isinstance(shape, tuple) and kind is not None
        if math.prod(shape) * np.dtype(kind).itemsize == len(raw):
            return np.frombuffer(raw, f"<{kind}").reshape(shape).astype(np.float64)
    raise _wrong(what, "is no array of plain numbers")


def _kind(dtype: Any) -> str | None:
    """Returns numpy's short name of a type of numbers that lie with the lowest byte first; else None."""
    told = isinstance(dtype, Thing) and dtype.name == "numpy.dtype" and isinstance(dtype.state, tuple)
    kind = dtype.args[0] if told and dtype.args and dtype.state[1:2] == ("<",) else None
    return kind if isinstance(kind, str) else None


def _is_shape(value: Any) -> bool:
    """Whether it is a shape of not more numbers than anybody has."""
    if not isinstance(value, tuple) or len(value) > 4:
        return False
    sizes = all(type(size) is int and 0 <= size <= _MOST_STORAGE for size in value)
    return sizes and math.prod(value) <= _MOST_STORAGE


# -- tensors ----------------------------------------------------------------------------------------------------------


def read_tensors(data: bytes, what: str, wanted: Callable[[str], bool]) -> dict[str, Array]:
    """Reads a dictionary of tensors that `torch.save` wrote, such as a model's `state_dict()`.

    Args:
        data: The file's bytes.
        what: What to call it where something is wrong.
        wanted: Which of its names are read.

    Returns:
        Arrays by name, float64.

    Raises:
        DocumentError: It is no such file, or holds something else under such a name.
    """
    archive = Archive(data, what)
    (folder,) = [name.removesuffix("data.pkl") for name in archive.names if name.endswith("/data.pkl")][:1] or ("",)
    table = read_pickle(archive.read(f"{folder}data.pkl", _MOST_PICKLE), what, lambda pid: pid)
    if f"{folder}byteorder" in archive.names and archive.read(f"{folder}byteorder", 16) != b"little":
        raise _wrong(what, "was written on a machine of the other order of bytes")
    if not isinstance(table, Mapping) or not all(isinstance(name, str) for name in table):
        raise _wrong(what, "holds no dictionary of tensors")
    found: dict[str, Array] = {}
    left = _MOST_STORAGE
    for name, value in table.items():
        if wanted(name):
            if len(name) > _LONGEST_NAME:
                raise _wrong(what, f"has a name of {len(name):,} characters")
            found[name], size = _tensor(archive, folder, value, f"{what}: {name}", left)
            left -= size
    return found


def _tensor(archive: Archive, folder: str, value: Any, what: str, most: int) -> tuple[Array, int]:
    """Returns a tensor as an array, and how many bytes were read for it: at most so many.

    What the pickle says of it is `value`. Tensors may be parts of one storage, which is read for each of them.
    """
    if not isinstance(value, Thing) or value.name != "torch._utils._rebuild_tensor_v2" or len(value.args) < 4:
        raise _wrong(what, "is no plain tensor")
    storage, offset, shape, strides = value.args[:4]
    if (
        not isinstance(storage, tuple)
        or len(storage) != 5
        or storage[0] != "storage"
        or not isinstance(storage[2], str)
    ):
        raise _wrong(what, "is no plain tensor")
    kind = _STORAGES.get(getattr(storage[1], "name", "").removeprefix("torch."))
    if kind is None or not _is_shape(shape) or type(offset) is not int or not 0 <= offset <= _MOST_STORAGE:
        raise _wrong(what, "is no tensor of floats of 16, 32 or 64 bits")
    count = math.prod(shape)
    in_rows = tuple(math.prod(shape[axis + 1 :]) for axis in range(len(shape)))
    if count and strides != in_rows:
        raise _wrong(what, "does not lie row by row: save a contiguous copy of it")
    size = np.dtype(kind).itemsize
    raw = archive.read(f"{folder}data/{storage[2]}", most)
    if len(raw) < (offset + count) * size:
        raise _wrong(what, f"has {len(raw):,} bytes, and its shape needs {(offset + count) * size:,}")
    return np.frombuffer(raw, kind, count, offset * size).reshape(shape).astype(np.float64), len(raw)
