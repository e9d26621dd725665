"""Objectives and conditions: expressions over a trajectory's quantities, in Google's Common Expression Language (CEL).

Hides the grammar, and how names become numbers. An expression is read once: its syntax, the names in it and the kinds
of its values are judged before anything is run, and what is wrong is refused with its place. It can add, compare and
choose, and nothing else: there are no lists, no macros over them, no text, so its cost is bounded by its length.

Invariants: an expression is a pure and total function of the quantities that it `needs`: whatever they are, nothing in
it raises. It may be used by several threads. Every number is a double of IEEE 754: `2` means `2.0` (CEL's own readers
refuse `2 * height`), there is no whole-number division, and what is no number (NaN) is neither less than, nor equal to,
nor greater than anything.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, Final, Literal, NoReturn

import numpy as np
import numpy.typing as npt

from nmes.errors import WorldError
from nmes.objective.quantities import CUBE_QUANTITIES, FOLDS, QUANTITIES, Cast, Quantity
from nmes.schemas.documents import did_you_mean

__all__ = ["FUNCTIONS", "Condition", "Objective"]

Array = npt.NDArray[np.float64]


def _total(function: Callable[[float], float], beyond: float) -> Callable[[float], float]:
    """Makes a function of the standard library total: outside its domain nan, at its pole or beyond doubles inf."""

    def call(x: float) -> float:
        try:
            return function(x)
        except OverflowError:
            return math.inf
        except ValueError:
            return beyond if x == 0.0 else math.nan

    return call


def _least(*values: float) -> float:
    return math.nan if any(map(math.isnan, values)) else min(values)


def _greatest(*values: float) -> float:
    return math.nan if any(map(math.isnan, values)) else max(values)


def _quotient(a: float, b: float) -> float:
    if b:
        return a / b
    return math.nan if not a or math.isnan(a) else math.copysign(math.inf, a) * math.copysign(1.0, b)


def _choose(truth: bool, this: Any, that: Any) -> Any:
    return this if truth else that


_FUNCTIONS: Final[dict[str, Callable[..., float]]] = {
    "abs": abs,
    "exp": _total(math.exp, math.nan),
    "log": _total(math.log, -math.inf),
    "max": _greatest,
    "min": _least,
    "sqrt": _total(math.sqrt, math.nan),
}

FUNCTIONS: Final[Mapping[str, str]] = {
    "abs": "abs(x): its size",
    "exp": "exp(x): e to the power of x",
    "log": "log(x): natural logarithm",
    "max": "max(x, y, ...): the greatest",
    "min": "min(x, y, ...): the least",
    "sqrt": "sqrt(x): square root",
}
"""The functions of an expression, and what each gives."""


# The same functions of arrays, to the same bits in each row; whatever is not here is what it is of numbers.
def _choose_rows(truth: Any, this: Any, that: Any) -> Any:
    return np.where(truth, this, that)


def _extreme(before: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    def call(*values: Any) -> Any:
        result, known = values[0], values[0] == values[0]
        for value in values[1:]:
            result, known = np.where(before(value, result), value, result), known & (value == value)
        return np.where(known, result, np.nan)

    return call


def _one_by_one(function: Callable[[float], float]) -> Callable[..., Any]:
    return lambda values: np.array([function(value) for value in np.ravel(values).tolist()]).reshape(np.shape(values))


_OF_ROWS: Final[dict[Callable[..., Any], Callable[..., Any]]] = {
    _choose: _choose_rows,
    _quotient: np.divide,
    operator.not_: np.logical_not,
    **{_FUNCTIONS[name]: _one_by_one(_FUNCTIONS[name]) for name in ("exp", "log")},  # numpy's have other bits
    _FUNCTIONS["sqrt"]: np.sqrt,
    _greatest: _extreme(operator.gt),
    _least: _extreme(operator.lt),
}

_OPERATORS: Final[dict[str, Callable[..., Any]]] = {
    **{"+": operator.add, "-": operator.sub, "*": operator.mul, "/": _quotient},
    **{"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge},
    **{"==": operator.eq, "!=": operator.ne, "&&": operator.and_, "||": operator.or_},
}

# Of an expression: the reader calls itself for what is nested.
LENGTH: Final = 2000  # characters
WORDS: Final = 500
_NESTING: Final = 30
_LISTED: Final = 60  # names that a message lists

_Kind = Literal["number", "truth"]
_KIND = {"number": "a number", "truth": "true or false"}

_TOKEN = re.compile(
    r"""(?P<space>[ \t\r\n]+)
    |(?P<number>(?:[0-9]+(?:\.[0-9]+)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)
    |(?P<name>[A-Za-z_][A-Za-z0-9_]*)
    |(?P<string>"[^"\\\r\n]*"|'[^'\\\r\n]*')
    |(?P<mark><=|>=|==|!=|&&|\|\||[-+*/<>!?:().,])""",
    re.VERBOSE,
)


@dataclass(frozen=True, slots=True)
class _Token:
    kind: str  # a group of _TOKEN, or "end"
    text: str
    at: int


@dataclass(frozen=True, slots=True)
class _Value:
    """What a part of an expression comes to: its kind, and the number of its slot."""

    kind: _Kind
    slot: int


class _Expression:
    """An expression that was read and compiled."""

    _kind: _Kind

    def __init__(
        self,
        text: str,
        path: str = "expression",
        *,
        names: Mapping[str, tuple[str, str]] | None = None,
        parts: Mapping[str, Collection[str]] | None = None,
        cast: Cast | None = None,
    ) -> None:
        """Reads an expression.

        Args:
            text: In CEL, at most 2,000 characters, and 500 words and signs.
            path: The field to blame.
            names: What it may name instead of the quantities of a trajectory: each with its meaning and unit. These
                are what they are once and for all: nothing stands before them, and they are of no cube.
            parts: Besides `names`, what it may ask of things that have ids, each with those ids: `sense("foot.touch")`.
                Such a quantity has the id as its `cube`.
            cast: Of a task with roles, one of which stands before each quantity; None elsewhere.

        Raises:
            WorldError: `bad_expression`, with line and column of the mistake.
        """
        self.text = text
        self._path = path
        reader = _Reader(text, path, names, parts or {}, cast)
        self._result = reader.read(self._kind)
        self.needs: tuple[Quantity, ...] = tuple(reader.needs)
        """What it needs to know, in order of first use."""
        self._inputs = tuple(reader.needs.items())
        self._slots, self._steps = tuple(reader.slots), tuple(reader.steps)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.text!r})"

    def _run(self, values: Mapping[Quantity, float]) -> Any:
        slots = list(self._slots)
        for quantity, slot in self._inputs:
            slots[slot] = float(values[quantity])
        for slot, function, operands in self._steps:
            slots[slot] = function(*[slots[operand] for operand in operands])
        return slots[self._result]

    def _run_rows(self, columns: Mapping[Quantity, Array], count: int) -> Any:
        slots: list[Any] = list(self._slots)
        for quantity, slot in self._inputs:
            slots[slot] = columns[quantity]
        with np.errstate(all="ignore"):
            for slot, function, operands in self._steps:
                slots[slot] = _OF_ROWS.get(function, function)(*[slots[operand] for operand in operands])
        return np.broadcast_to(slots[self._result], count)


class Objective(_Expression):
    """An expression that gives a number: a score, a fitness, a reward."""

    _kind = "number"

    def value(self, values: Mapping[Quantity, float]) -> float:
        """Returns its value.

        Args:
            values: The value of each quantity that it `needs`.

        Raises:
            WorldError: `bad_expression`: the value is no finite number, as after a division by zero.
        """
        value = float(self._run(values))
        if not math.isfinite(value):
            known = ", ".join(f"{quantity} = {values[quantity]:g}" for quantity in self.needs)
            where = f", where {known}" if known else ""
            raise WorldError(
                "bad_expression", f"{self._path}: its value is {value}, no finite number{where}", self._path
            )
        return value

    def values(self, columns: Mapping[Quantity, Array], count: int) -> Array:
        """Returns its value in each of so many rows, array (count,), to the bits of `value`.

        Args:
            columns: Of each quantity that it `needs`, array (count,).
            count: The number of rows.

        Returns:
            What is not finite too, as after a division by zero.
        """
        return np.asarray(self._run_rows(columns, count), np.float64)


class Condition(_Expression):
    """An expression that is true or false."""

    _kind = "truth"

    def holds(self, values: Mapping[Quantity, float]) -> bool:
        """Tells whether it is true; `values` has the value of each quantity that it `needs`."""
        return bool(self._run(values))

    def flags(self, columns: Mapping[Quantity, Array], count: int) -> npt.NDArray[np.bool_]:
        """Tells of each of so many rows whether it is true, array (count,); `columns` as in `Objective.values`."""
        return np.asarray(self._run_rows(columns, count), np.bool_)


class _Reader:
    """Reads an expression by CEL's grammar, as far as objectives have it, into steps that each fill a slot.

    One reader reads one expression. Each method of the grammar returns the value that it has read.

    Attributes:
        needs: The slots of the quantities that the expression names, in order of first use.
        slots: What is in each slot at first: a number or truth of the expression, else 0.
        steps: In order: the slot to fill, the function, and the slots of what it takes. As all of them are total, both
            sides of a choice are computed, and nothing but this order is left of how deep the expression was nested.
    """

    def __init__(
        self,
        text: str,
        path: str,
        names: Mapping[str, object] | None,
        parts: Mapping[str, Collection[str]],
        cast: Cast | None,
    ) -> None:
        self._text, self._path, self._names, self._parts, self._cast = text, path, names, parts, cast
        self.needs: dict[Quantity, int] = {}
        self.slots: list[float | bool] = []
        self.steps: list[tuple[int, Callable[..., Any], tuple[int, ...]]] = []
        self._depth = 0
        if len(text) > LENGTH:
            self._refuse(LENGTH, f"it is longer than {LENGTH:,} characters")
        self._tokens = self._split()
        self._next = 0

    def read(self, expected: _Kind) -> int:
        """Reads all of it; returns the slot that has its value in the end."""
        start = self._token
        value = self._choice()
        if self._token.kind != "end":
            self._refuse(self._token.at, f"expected an operator or the end, found {self._here()}")
        if value.kind != expected:
            self._refuse(start.at, f"it must give {_KIND[expected]}, but gives {_KIND[value.kind]}")
        return value.slot

    # -- words ---------------------------------------------------------------------------------------------------

    def _refuse(self, at: int, message: str) -> NoReturn:
        before = self._text[:at]
        line = before.count("\n") + 1
        column = at - (before.rfind("\n") + 1) + 1
        raise WorldError(
            "bad_expression", f"{self._path}: line {line}, column {column}: {message}", self._path
        ) from None

    def _split(self) -> list[_Token]:
        tokens: list[_Token] = []
        at = 0
        while at < len(self._text):
            match = _TOKEN.match(self._text, at)
            if match is None:
                character = self._text[at]
                what = (
                    "this text has no end, or a backslash in it"
                    if character in "\"'"
                    else f"{character!r} means nothing"
                )
                self._refuse(at, f"{what} here")
            if match.lastgroup != "space":
                if len(tokens) == WORDS:
                    self._refuse(at, f"it has more than {WORDS} words and signs")
                tokens.append(_Token(str(match.lastgroup), match[0], at))
            at = match.end()
        return [*tokens, _Token("end", "", len(self._text))]

    @property
    def _token(self) -> _Token:
        return self._tokens[self._next]

    def _here(self) -> str:
        return "the end" if self._token.kind == "end" else repr(self._token.text)

    def _take(self) -> _Token:
        self._next += 1
        return self._tokens[self._next - 1]

    def _is(self, *marks: str) -> bool:
        return self._token.kind == "mark" and self._token.text in marks

    def _expect(self, mark: str, why: str) -> None:
        if not self._is(mark):
            self._refuse(self._token.at, f"expected {mark!r} {why}, found {self._here()}")
        self._take()

    # -- slots ---------------------------------------------------------------------------------------------------

    def _slot(self, content: float | bool) -> int:
        self.slots.append(content)
        return len(self.slots) - 1

    def _apply(self, kind: _Kind, function: Callable[..., Any], *operands: _Value) -> _Value:
        slot = self._slot(0.0)
        self.steps.append((slot, function, tuple(operand.slot for operand in operands)))
        return _Value(kind, slot)

    # -- grammar -------------------------------------------------------------------------------------------------

    def _want(self, expected: _Kind, value: _Value, at: int, what: str) -> None:
        if value.kind != expected:
            self._refuse(at, f"{what} takes {_KIND[expected]}, but this is {_KIND[value.kind]}")

    def _chain(self, below: Callable[[], _Value], marks: Sequence[str], kind: _Kind) -> _Value:
        """Reads operands of one precedence, and of one kind if there are several."""
        at = self._token.at
        value = below()
        while self._is(*marks):
            mark = self._take().text
            self._want(kind, value, at, mark)
            at = self._token.at
            other = below()
            self._want(kind, other, at, mark)
            value = self._apply(kind, _OPERATORS[mark], value, other)
        return value

    def _choice(self) -> _Value:
        self._depth += 1
        if self._depth > _NESTING:
            self._refuse(self._token.at, f"it is nested more than {_NESTING} deep")
        at = self._token.at
        value = self._either()
        if self._is("?"):
            self._want("truth", value, at, "?")
            self._take()
            this = self._either()
            self._expect(":", "between the two choices")
            at = self._token.at
            that = self._choice()
            if that.kind != this.kind:
                self._refuse(at, f"the choice before ':' is {_KIND[this.kind]}, but this is {_KIND[that.kind]}")
            value = self._apply(this.kind, _choose, value, this, that)
        self._depth -= 1
        return value

    def _either(self) -> _Value:
        return self._chain(self._both, ("||",), "truth")

    def _both(self) -> _Value:
        return self._chain(self._relation, ("&&",), "truth")

    def _relation(self) -> _Value:
        at = self._token.at
        value = self._sum()
        while self._is("<", "<=", ">", ">=", "==", "!="):
            mark = self._take().text
            if mark not in ("==", "!="):
                self._want("number", value, at, mark)
            at = self._token.at
            other = self._sum()
            self._want(value.kind, other, at, f"{mark} after {_KIND[value.kind]}")
            value = self._apply("truth", _OPERATORS[mark], value, other)
        return value

    def _sum(self) -> _Value:
        return self._chain(self._product, ("+", "-"), "number")

    def _product(self) -> _Value:
        return self._chain(self._signed, ("*", "/"), "number")

    def _signed(self) -> _Value:
        if not self._is("-", "!"):
            return self._member()
        mark = self._token.text
        kind: _Kind = "number" if mark == "-" else "truth"
        count = 0
        while self._is(mark):
            self._take()
            count += 1
        at = self._token.at
        value = self._member()
        self._want(kind, value, at, mark)
        return self._apply(kind, operator.neg if mark == "-" else operator.not_, value) if count % 2 else value

    def _member(self) -> _Value:
        token = self._token
        if token.kind == "number":
            self._take()
            number = float(token.text)
            if math.isinf(number):
                self._refuse(token.at, "this number is too large")
            return _Value("number", self._slot(number))
        if token.kind == "name":
            return self._name()
        if self._is("("):
            self._take()
            value = self._choice()
            self._expect(")", "after what is in parentheses")
            return value
        if token.kind == "string":
            self._refuse(token.at, 'there is no text in an objective but the id in cube("id")')
        self._refuse(token.at, f"expected a value, found {self._here()}")

    def _name(self) -> _Value:
        token = self._token
        if token.text in ("true", "false"):
            return _Value("truth", self._slot(self._take().text == "true"))
        following = self._tokens[self._next + 1]
        plain = token.text != "cube" if self._names is None else token.text not in self._parts
        if plain and following.kind == "mark" and following.text == "(":
            return self._call()
        quantity = self._quantity() if self._names is None else self._other(self._names)
        if quantity not in self.needs:
            self.needs[quantity] = self._slot(0.0)
        return _Value("number", self.needs[quantity])

    def _call(self) -> _Value:
        name = self._take()
        if name.text not in FUNCTIONS:
            self._refuse(name.at, f"there is no function {_clip(name.text)!r}{_near(name.text, FUNCTIONS)}")
        arguments: list[_Value] = []
        while not arguments or self._is(","):
            self._take()
            at = self._token.at
            arguments.append(self._choice())
            self._want("number", arguments[-1], at, f"{name.text}()")
        self._expect(")", f"after the arguments of {name.text}")
        count, many = len(arguments), name.text in ("min", "max")
        if (count < 2) if many else (count > 1):
            self._refuse(name.at, f"{name.text} takes {'two numbers or more' if many else 'one number'}, not {count}")
        return self._apply("number", _FUNCTIONS[name.text], *arguments)

    def _quantity(self) -> Quantity:
        """Reads `height`, `displacement.x`, `max.speed`, `min.cube("id").position.y`, `max.prey.height`."""
        fold, role, cube = "final", None, None
        first = self._token
        if first.text in FOLDS:
            fold = self._take().text
            if not self._is("."):
                self._refuse(first.at, f"{fold} of what? It goes before a quantity: {fold}.height")
            self._take()
        if self._cast is not None:
            role = self._role(self._cast)
        if self._token.text == "cube" and self._tokens[self._next + 1].text == "(":
            cube = self._cube()
        elif self._cast is not None and role is None:
            return Quantity(self._time(self._cast), fold=fold)
        whole = QUANTITIES if self._cast is None or role is None else self._cast.quantities(role)
        return Quantity(self._quantity_name(whole if cube is None else CUBE_QUANTITIES, cube, whole), cube, fold, role)

    def _quantity_name(self, known: Mapping[str, object], cube: str | None, whole: Mapping[str, object]) -> str:
        words = list[_Token]()
        while True:
            if self._token.kind != "name":
                self._refuse(self._token.at, f"expected the name of a quantity, found {self._here()}")
            words.append(self._take())
            if not self._is("."):
                break
            self._take()
        name = ".".join(word.text for word in words)
        if name not in known:
            parts = [other for other in known if other.startswith(f"{name}.")]
            if parts:
                what = "a vector" if name in _VECTORS else "of several"
                message = f"{name} is {what}; take {' or '.join(filter(None, [', '.join(parts[:-1]), parts[-1]]))}"
            elif cube is not None and name in whole:
                message = f"there is {name} of the whole only, not of one cube"
            else:
                message = f"there is no quantity {_clip(name)!r}{_near(name, known)}"
            self._refuse(words[0].at, message)
        return name

    def _role(self, cast: Cast) -> str | None:
        """Reads the role that a quantity is of, and the point after it, if one is named."""
        if self._token.kind != "name" or self._token.text not in cast.roles or self._tokens[self._next + 1].text != ".":
            return None
        role = self._take().text
        self._take()
        return role

    def _time(self, cast: Cast) -> str:
        """Reads `time`, the one quantity that is of no role and no prop."""
        word = self._token
        if word.text != "time":
            example = f"one of {', '.join(cast.roles)} goes before a quantity, as in {cast.roles[0]}.height"
            self._refuse(word.at, f"expected a role, found {self._here()}: {example}")
        return self._take().text

    def _other(self, names: Mapping[str, object]) -> Quantity:
        """Reads one of the names that are given instead of a trajectory's."""
        word = self._take()
        if word.text in self._parts:
            return self._part(word)
        if word.text not in names:
            self._refuse(word.at, f"there is no quantity {_clip(word.text)!r}{_near(word.text, names)}")
        return Quantity(word.text)

    def _part(self, word: _Token) -> Quantity:
        """Reads the id in `sense("foot.touch")`, and looks whether there is such a thing."""
        known = self._parts[word.text]
        self._expect("(", f"and an id after {word.text}")
        token = self._token
        name = token.text[1:-1]
        if token.kind != "string":
            self._refuse(token.at, f'expected an id in quotes, as in {word.text}("leg"), found {self._here()}')
        if name not in known:
            self._refuse(token.at, f"there is none {_clip(name)!r}{_near(name, known)}")
        self._take()
        self._expect(")", "after the id")
        return Quantity(word.text, name)

    def _cube(self) -> str:
        self._take()
        self._take()
        token = self._token
        if token.kind != "string":
            self._refuse(token.at, f'expected the id of a cube, as in cube("leg"), found {self._here()}')
        self._take()
        for mark, why in ((")", "after the id of a cube"), (".", "and a quantity after the cube")):
            if not self._is(mark):
                self._refuse(self._token.at, f"expected {mark!r} {why}, found {self._here()}")
            self._take()
        return token.text[1:-1]


_VECTORS = {name.rpartition(".")[0] for name in QUANTITIES if "." in name}


def _clip(name: str) -> str:
    return name if len(name) <= 80 else f"{name[:77]}..."


def _near(name: str, known: Collection[str]) -> str:
    there = list(islice(known, _LISTED))
    more = f" and {len(known) - _LISTED} more" if len(known) > _LISTED else ""
    return did_you_mean(name, known) or (f"; there are {', '.join(there)}{more}" if there else "")
