"""The results of a study: a row for each run, in the order of the plan, as a table of Parquet.

Hides the file. Invariants: rows are what was told of runs and nothing else, numbers as doubles; the digest is of all
rows in canonical form, so that it is the same after the file was written and read.
"""

from __future__ import annotations

import secrets
import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import orjson

from nmes.backend import load_backend
from nmes.backend.fingerprint import differences, fingerprint
from nmes.errors import MissingPackage, StudyError
from nmes.schemas.documents import JsonObject, canonical_hash
from nmes.schemas.files import read_regular
from nmes.study.document import Plan, PlannedRun

__all__ = ["FILE", "GREATEST", "Results", "is_row", "row_of", "write_file"]

FILE: Final = "results.parquet"
_KEY: Final = b"nmes.study"
_LARGEST: Final = 64 << 20  # bytes of a file
_PACKED: Final = 32  # times: as much as it may be larger unpacked; snappy, by which it is packed, makes no more of it
_TEXTS: Final = 64 << 20  # characters in all rows
GREATEST: Final = 1e100
"""The greatest number in a column, so that sums and squares of many are finite."""


@dataclass(frozen=True, slots=True)
class Results:
    """All rows of a study with a budget.

    Attributes:
        asked: The hash of what was asked.
        fingerprint: Of what computed them.
        rows: The rows, each with arm, factors, seed, whether it is measured, and the columns.
    """

    asked: str
    fingerprint: Mapping[str, str]
    rows: Sequence[JsonObject]

    @property
    def digest(self) -> str:
        """Of all rows and what was asked, 32 hexadecimal digits."""
        return canonical_hash({"asked": self.asked, "rows": list(self.rows)})[:32]

    @classmethod
    def here(cls, plan: Plan, rows: Sequence[JsonObject]) -> Results:
        """Makes results of rows that were computed here."""
        return cls(plan.asked, fingerprint(load_backend("mujoco")), rows)

    def differences(self) -> dict[str, tuple[str, str]]:
        """Returns the decisive items of the fingerprint that are otherwise here than there, with both values."""
        return differences(self.fingerprint, fingerprint(load_backend("mujoco")))

    def write(self, plan: Plan) -> None:
        """Writes them to the folder of the plan; where the same are there already, the file is left alone.

        Raises:
            MissingPackage: pyarrow is not installed.
            StudyError: They cannot be written (`cannot_write`).
        """
        arrow, parquet = _arrow()
        with suppress(StudyError):
            if Results.read(plan).digest == self.digest:
                return
        about = {"asked": self.asked, "digest": self.digest, "fingerprint": dict(self.fingerprint)}
        columns = {name: [row[name] for row in self.rows] for name in self.rows[0]}
        fields = [(name, _kind(arrow, values)) for name, values in columns.items()]
        schema = arrow.schema(fields, metadata={_KEY: orjson.dumps(about)})
        sink = arrow.BufferOutputStream()
        parquet.write_table(arrow.table(columns, schema=schema), sink)
        write_file(plan.folder / FILE, sink.getvalue().to_pybytes())

    @classmethod
    def read(cls, plan: Plan) -> Results:
        """Reads those of a plan.

        Raises:
            MissingPackage: pyarrow is not installed.
            StudyError: There are none (`no_results`), or they are not what they say (`bad_results`).
        """
        arrow, parquet = _arrow()
        path = plan.folder / FILE
        try:
            content = read_regular(path, _LARGEST)
            about = orjson.loads((parquet.read_schema(arrow.BufferReader(content)).metadata or {})[_KEY])
            asked, computed, digest = _text(about["asked"]), _texts(about["fingerprint"]), _text(about["digest"])
            if asked != plan.asked:
                changed = "study.toml, or a document beside it, is not what these results answer: it was changed since"
                raise StudyError("bad_results", f"{path}: {changed}")
            results = cls(asked, computed, _rows(content, len(plan.runs), arrow, parquet))
        except FileNotFoundError:
            hint = f"nmes study run {shlex.quote(str(plan.study.folder))} --budget {plan.budget}"
            raise StudyError("no_results", f"there are no results in {plan.folder}: {hint}") from None
        except (OSError, KeyError, TypeError, ValueError, arrow.ArrowException) as error:
            raise StudyError("bad_results", f"{path} are no results of a study: {error}") from error
        if not all(map(partial(is_row, plan), plan.runs, results.rows)):
            raise StudyError("bad_results", f"{path}: the rows are not those that the study plans")
        if results.digest != digest:
            raise StudyError("bad_results", f"{path}: the rows do not have the digest that the file names")
        return results


def is_row(plan: Plan, run: PlannedRun, row: object) -> bool:
    """Returns whether something is a row of a run: its columns, each with text, a number, a truth or null."""
    about = _about(run)
    if not isinstance(row, dict) or row.keys() != {*about, *plan.study.document["columns"]}:
        return False
    return {name: row[name] for name in about} == about and all(map(_is_value, row.values()))


def row_of(run: PlannedRun, columns: JsonObject) -> JsonObject:
    """Returns the row of a run that has told these columns."""
    return {**_about(run), **columns}


def write_file(path: Path, content: bytes) -> None:
    """Writes a file whole, or not at all.

    Raises:
        StudyError: It cannot be written (`cannot_write`).
    """
    part = path.with_name(f".{secrets.token_hex(8)}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(content)
        part.replace(path)
    except OSError as error:
        raise StudyError("cannot_write", f"cannot write {path}: {error.strerror}") from error
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _rows(content: bytes, rows: int, arrow: Any, parquet: Any) -> list[JsonObject]:
    """Returns the rows in a file, which may be of anybody: little may stand for much in it.

    Raises:
        ValueError: It has other columns, or takes more memory, than results of so many rows.
        ArrowException: It cannot be read.
    """
    file = parquet.ParquetFile(arrow.BufferReader(content))
    about, schema = file.metadata, file.schema_arrow
    texts = [field.name for field in schema if field.type == arrow.string()]
    if not all(field.type in (arrow.string(), arrow.float64(), arrow.int64(), arrow.bool_()) for field in schema):
        raise ValueError("a column has neither numbers nor texts nor truths")
    groups = [about.row_group(number) for number in range(about.num_row_groups)]
    chunks = [group.column(number) for group in groups for number in range(group.num_columns)]
    if about.num_rows != rows or sum(group.num_rows for group in groups) != rows:
        raise ValueError(f"it has {about.num_rows:,} rows, and the study plans {rows:,}")
    if not {chunk.compression for chunk in chunks} <= {"SNAPPY", "UNCOMPRESSED"} or (
        sum(chunk.total_uncompressed_size for chunk in chunks) > _PACKED * len(content)
    ):
        raise ValueError("it is packed in another way than results are")
    table = parquet.ParquetFile(arrow.BufferReader(content), read_dictionary=texts).read()
    # What many rows have in common stands once in the file, and so far in memory.
    lengths = (
        len(chunk.dictionary[index.as_py()].as_py())
        for name in texts
        for chunk in table[name].chunks
        for index in chunk.indices
        if index.is_valid
    )
    if sum(lengths) > _TEXTS:
        raise ValueError(f"its texts have over {_TEXTS:,} characters")
    found: list[JsonObject] = table.to_pylist()
    return found


def _about(run: PlannedRun) -> JsonObject:
    """Returns the columns of a row that say which run it is of."""
    cell = {name: float(value) if isinstance(value, int) else value for name, value in run.cell.items()}
    return {"arm": run.arm["name"], **cell, "seed": run.seed, "measured": run.arm["measured"]}


def _is_value(value: object) -> bool:
    if isinstance(value, int | float):
        return abs(value) <= GREATEST  # which NaN is not
    return value is None or isinstance(value, str)


def _text(value: object) -> str:
    """Returns a value that must be text.

    Raises:
        TypeError: It is none.
    """
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is no text")
    return value


def _texts(value: object) -> Mapping[str, str]:
    """Returns an object of texts.

    Raises:
        TypeError: It is none.
    """
    if not isinstance(value, dict):
        raise TypeError(f"{value!r} is no fingerprint")
    return {name: _text(each) for name, each in value.items()}


def _kind(arrow: ModuleType, values: Sequence[Any]) -> Any:
    """Returns the type of a column: truths, whole numbers (seeds), numbers, or text.

    Raises:
        StudyError: It has values of several kinds (`command_failed`).
    """
    kinds = {type(value) for value in values if value is not None} or {str}
    if len(kinds) > 1:
        names = ", ".join(sorted(kind.__name__ for kind in kinds))
        raise StudyError("command_failed", f"a column has values of several kinds: {names}")
    types = {bool: arrow.bool_(), int: arrow.int64(), float: arrow.float64(), str: arrow.string()}
    return types[kinds.pop()]


def _arrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise MissingPackage("results of studies need pyarrow: pip install 'nmes[arrow]'") from error
    return pyarrow, pyarrow.parquet
