"""The page of errors has every code that the sources raise, and no other."""

from __future__ import annotations

import ast
import pickle
import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

from layout import ROOT
from nmes import errors
from nmes.errors import NmesError
from nmes.protocol import ERROR_CODES

SOURCES = sorted(path for name in ("nmes", "backends", "cli", "schemas") for path in (ROOT / name).rglob("*.py"))
ERRORS = {name for name, value in vars(errors).items() if isinstance(value, type) and issubclass(value, NmesError)}
CODE = re.compile(r"[a-z]+(_[a-z]+)*")
RELAYED = re.compile(r"\.code$|\['code'\]|\.get\('code'")
"""Code that another error brought, or a reply."""


def classes(trees: Iterable[ast.Module]) -> set[str]:
    """Returns the names of all classes of errors, those too that stand elsewhere."""
    nodes = (node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    return ERRORS | {node.name for node in nodes if any(ast.unparse(base) in ERRORS for base in node.bases)}


@cache
def sources() -> dict[str, ast.Module]:
    """Returns all sources, by their place in the tree."""
    return {str(path.relative_to(ROOT)): ast.parse(path.read_text()) for path in SOURCES}


def called(call: ast.Call) -> str:
    """Returns the last name of what is called, `b` of `a.b()`; nothing for what has no name."""
    return getattr(call.func, "attr", getattr(call.func, "id", ""))


def codes(tree: ast.Module, known: set[str]) -> Iterator[tuple[str, int]]:
    """Yields the codes that a module's errors are made with, and their lines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef) and node.name in known - {"NmesError"}:
            for call in (call for call in ast.walk(node) if isinstance(call, ast.Call)):
                if ast.unparse(call.func) == "super().__init__" and not ast.unparse(call.args[0]) == "code":
                    yield from ((code, call.lineno) for code in values(call.args[0], tree))
        elif isinstance(node, ast.Call) and called(node) in known - OWN and node.args:
            yield from ((code, node.lineno) for code in values(node.args[0], tree))


OWN = {"DocumentError", "BackendNotFound", "DamagedFile", "MissingPackage", "NotDeterministic"}
"""Classes that set their code themselves."""


def values(code: ast.expr, tree: ast.Module) -> Iterator[str]:
    """Yields the strings that an expression may be; one that is not understood is a failure."""
    if isinstance(code, ast.Constant):
        yield str(code.value)
    elif isinstance(code, ast.IfExp):
        yield from values(code.body, tree)
        yield from values(code.orelse, tree)
    elif isinstance(code, ast.Name):
        bound = [*bindings(code.id, tree)]
        assert bound, f"{code.id} in line {code.lineno} may be any code"
        for value in bound:
            yield from values(value, tree)
    else:
        assert RELAYED.search(ast.unparse(code)), f"{ast.unparse(code)} in line {code.lineno} may be any code"


def bindings(name: str, tree: ast.Module) -> Iterator[ast.expr]:
    """Yields what a name is assigned, or stands for in a loop over the pairs of a table of the module."""
    tables = {
        ast.unparse(node.targets[0]): node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Dict)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and [ast.unparse(target) for target in node.targets] == [name]:
            yield node.value
        elif isinstance(node, ast.For) and f"({name}, " in ast.unparse(node.target):
            table = tables[ast.unparse(node.iter).removesuffix(".items()")]
            yield from (pair.elts[0] for pair in table.values if isinstance(pair, ast.Tuple))


def raised() -> dict[str, str]:
    """Returns every code in the sources, with a place where it is."""
    known = classes(sources().values())
    places: dict[str, str] = {}
    for place, tree in sources().items():
        for code, line in codes(tree, known):
            places[code] = f"{place}:{line}"
    return places


def rows(page: Path) -> list[tuple[str, str, str]]:
    lines = [line for line in page.read_text().splitlines() if line.startswith("| `")]
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]
    return [(code.strip("`"), meaning, remedy) for code, meaning, remedy in cells]


PAGE = rows(ROOT / "docs" / "errors.md")


def test_the_page_has_the_codes_of_the_sources_and_no_others() -> None:
    places = raised()
    listed = [code for code, _, _ in PAGE]
    assert len(listed) == len(set(listed))
    assert {code: place for code, place in places.items() if code not in listed} == {}
    assert set(listed) - places.keys() == set()
    assert all(CODE.fullmatch(code) and meaning and remedy for code, meaning, remedy in PAGE)


def test_codes_over_the_wire_mean_what_their_schema_says() -> None:
    meanings = {code: meaning for code, meaning, _ in PAGE}
    assert {code: meanings.get(code) for code in ERROR_CODES} == dict(ERROR_CODES)


@pytest.mark.parametrize("name", sorted(ERRORS))
def test_the_page_names_every_class_of_errors(name: str) -> None:
    assert f"`{name}`" in (ROOT / "docs" / "errors.md").read_text()


def test_what_is_raised_is_a_class_of_its_own_and_not_the_base_of_all() -> None:
    nodes = ((place, node) for place, tree in sources().items() for node in ast.walk(tree))
    raises = [(place, node) for place, node in nodes if isinstance(node, ast.Raise)]
    bare = [(place, node.lineno) for place, node in raises if node.exc and is_bare(node.exc)]
    assert bare == []


def is_bare(raised: ast.expr) -> bool:
    """Whether what is raised is an NmesError and no more."""
    return isinstance(raised, ast.Call) and called(raised) == "NmesError"


@pytest.mark.parametrize("source", ["NmesError('lost', 'x')", "errors.NmesError('lost', 'x')"])
def test_the_base_of_all_is_found_where_it_is_raised(source: str) -> None:
    assert is_bare(ast.parse(source, mode="eval").body)
    assert not is_bare(ast.parse(source.replace("Nmes", "World"), mode="eval").body)


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("raise WorldError('lost', 'x')", {"lost"}),
        ("raise errors.WorldError('a' if x else 'b', 'x')", {"a", "b"}),
        ("code = 'a'\nraise WorldError(code, 'x')", {"a"}),
        (
            "T = {1: ('a', 'x'), 2: ('b', 'y')}\nfor n, (code, m) in T.items():\n    raise WorldError(code, m)",
            {"a", "b"},
        ),
        ("class WorldError(NmesError):\n    def __init__(self):\n        super().__init__('own', 'x')", {"own"}),
        ("raise WorldError(error.code, 'x')", set()),
    ],
)
def test_codes_are_found_in_sources(source: str, expected: set[str]) -> None:
    assert {code for code, _ in codes(ast.parse(source), ERRORS)} == expected


def test_a_code_that_may_be_anything_is_noticed() -> None:
    with pytest.raises(AssertionError, match="may be any code"):
        list(codes(ast.parse("raise WorldError(what(), 'x')"), ERRORS))


@pytest.mark.parametrize(
    "error",
    [
        errors.NmesError("code", "message", "a/b"),
        errors.DocumentError([(f"cubes/{number}", "is wrong") for number in range(30)]),
        errors.SimulationFault("unstable", "it flew apart", body=3),
        errors.BackendNotFound("there is none"),
        errors.MissingPackage("install it"),
        errors.NotDeterministic(["a seed"]),
        errors.Disconnected("closed", "the server left"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_an_error_comes_out_of_another_process_as_it_was(error: NmesError) -> None:
    copied = pickle.loads(pickle.dumps(error))
    assert type(copied) is type(error) and copied.args == error.args and str(copied) == str(error)
    assert vars(copied) == vars(error)
