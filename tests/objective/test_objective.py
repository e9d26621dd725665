"""Objectives: which expressions there are, what they refuse and where, and what their quantities are."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmes.backend.rotation import normalize, quaternion_from_euler, rotate
from nmes.errors import WorldError
from nmes.objective import CUBE_QUANTITIES, FOLDS, FUNCTIONS, QUANTITIES, Condition, Objective, Quantity
from nmes.objective.trajectory import ObservedBodies, RunningQuantities, Trajectory


def refused(text: str, kind: type[Objective] | type[Condition] = Objective) -> str:
    with pytest.raises(WorldError) as caught:
        kind(text)
    assert caught.value.code == "bad_expression"
    assert caught.value.path == "expression"
    return caught.value.message


# -- expressions ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2", 2.0),
        ("1 / 2", 0.5),
        ("2 * height - 1", 5.0),
        ("-height + - -3", 0.0),
        ("height > 1 && !(height == 4) ? sqrt(16) : 0", 4.0),
        ("height > 1 || 1 / 0 > 1 ? 1 : 2", 1.0),
        ("max(1, height, 2) + min(1, height) + abs(-2)", 6.0),
        ("log(exp(height))", 3.0),
        ("max.height - min.height + start.height", 3.0),
        ("final.height", 3.0),
        ('cube("left leg").position.y * mean . speed', 9.0),
        ("1e2 + .5", 100.5),
    ],
)
def test_expressions_have_these_values(text: str, value: float) -> None:
    objective = Objective(text)
    assert objective.value(dict.fromkeys(objective.needs, 3.0)) == value


def test_an_objective_lists_the_names_it_needs_in_order_and_once() -> None:
    objective = Objective("max.height + speed * speed - cube(\"a\").height - final.speed - max.cube('a').velocity.x")
    assert [str(quantity) for quantity in objective.needs] == [
        "max.height", "speed", 'cube("a").height', 'max.cube("a").velocity.x',
    ]  # fmt: skip


@pytest.mark.parametrize("name", QUANTITIES)
def test_every_quantity_can_be_named_under_every_fold_and_reads_as_it_was_written(name: str) -> None:
    for fold in FOLDS:
        (quantity,) = Objective(f"{fold}.{name}").needs
        assert quantity == Quantity(name, None, fold)
        assert Objective(str(quantity)).needs == (quantity,)
    if name in CUBE_QUANTITIES:
        assert Objective(f'min.cube("a").{name}').needs == (Quantity(name, "a", "min"),)
    else:
        assert name in refused(f'cube("a").{name}')


@pytest.mark.parametrize(
    ("text", "place", "word"),
    [
        ("heigth", (1, 1), "did you mean height?"),
        ("height +", (1, 9), "found the end"),
        ("height\n + \n  spede", (3, 3), "did you mean speed?"),
        ("displacement * 2", (1, 1), "displacement.horizontal"),
        ("1 + displacement.q", (1, 5), "did you mean displacement"),
        ("cubes + cube.height", (1, 9), "cube.height"),
        ('cube("a")', (1, 10), "quantity"),
        ("cube(a).height", (1, 6), 'cube("leg")'),
        ("max > 2 ? 1 : 2", (1, 1), "max.height"),
        ("max(height)", (1, 1), "two numbers or more, not 1"),
        ("sqrt(1, 2)", (1, 1), "one number, not 2"),
        ("sqroot(2)", (1, 1), "did you mean sqrt?"),
        ("[1, 2].map(x, x)", (1, 1), "'['"),
        ("has(height)", (1, 1), "no function 'has'"),
        ("height > 2", (1, 1), "it must give a number"),
        ("1 + (height > 2)", (1, 5), "+ takes a number, but this is true or false"),
        ("1 < height < 2", (1, 5), "< takes a number"),
        ("height ? 1 : 2", (1, 1), "? takes true or false"),
        ("true ? 1 : false", (1, 12), "the choice before ':' is a number"),
        ("!height", (1, 2), "! takes true or false"),
        ("-true", (1, 2), "- takes a number"),
        ("'text'", (1, 1), "no text"),
        ('cube("a\\"").height', (1, 6), "backslash"),
        ("2 height", (1, 3), "expected an operator or the end"),
        ("(height", (1, 8), "expected ')'"),
        ("1e400", (1, 1), "too large"),
        ("7 % 2", (1, 3), "'%'"),
        ("é", (1, 1), "'é'"),
        ("", (1, 1), "expected a value"),
        ("(" * 40 + "1" + ")" * 40, (1, 31), "nested"),
        ("1" + " " * 2000, (1, 2001), "longer than 2,000"),
        ("-" * 500 + "1", (1, 501), "more than 500 words"),
    ],
)
def test_a_mistake_in_an_expression_is_reported_with_its_place(text: str, place: tuple[int, int], word: str) -> None:
    message = refused(text)
    assert message.startswith(f"expression: line {place[0]}, column {place[1]}: ")
    assert word in message


def test_a_condition_is_true_or_false_and_an_objective_a_number() -> None:
    condition = Condition("height < 0.2 || time > 5")
    assert condition.holds({condition.needs[0]: 0.1, condition.needs[1]: 0.0})
    assert not condition.holds({condition.needs[0]: 0.2, condition.needs[1]: 5.0})
    assert "it must give true or false" in refused("height", Condition)


@pytest.mark.parametrize(
    "text", ["1 / (height - 3)", "0 / (height - 3)", "sqrt(-height)", "log(height - 3)", "exp(999)"]
)
def test_a_value_that_is_not_finite_is_an_error_that_shows_its_inputs(text: str) -> None:
    objective = Objective(text, "objectives/0")
    with pytest.raises(WorldError, match=r"objectives/0: its value is -?(inf|nan), no finite number") as caught:
        objective.value(dict.fromkeys(objective.needs, 3.0))
    assert caught.value.code == "bad_expression"
    assert all(f"{quantity} = 3" in caught.value.message for quantity in objective.needs)


@pytest.mark.parametrize("text", ["x" * 2000, "f" * 1990 + "(1)"])
def test_a_long_word_is_shortened_in_the_error(text: str) -> None:
    assert len(refused(text)) < 700


@pytest.mark.parametrize(
    "text",
    [
        "+".join(["1"] * 250),
        "||".join(["true"] * 248) + "?1:2",
        "!" * 495 + "true?1:2",
        "-" * 499 + "1",
        "sqrt(" * 29 + "1" + ")" * 29,
        "(true?" * 28 + "1" + ":2)" * 28,
        "true?1:" * 29 + "2",
        "(1+" * 29 + "1" + ")" * 29,
        "max(" + ",".join(["1"] * 248) + ")",
    ],
    ids=lambda text: text[:8],
)
def test_the_longest_and_deepest_expressions_run_with_little_stack_left(text: str) -> None:
    results: list[float] = []
    before = threading.stack_size(256 * 1024)
    try:
        thread = threading.Thread(target=lambda: results.append(Objective(text).value({})))
        thread.start()
    finally:
        threading.stack_size(before)
    thread.join()
    assert len(results) == 1


WORDS = [
    *(*QUANTITIES, *FUNCTIONS, *FOLDS, "cube", "position", "true", "false", "null", "in", "size", "map", "all"),
    *('("a")', "(", ")", "(", ")", ".", ".", ",", "+", "-", "*", "/", "?", ":", "<", "<=", "==", "&&", "||", "!"),
    *("1", "2.5", "1e9", "1u", "0x1", "[", "]", "{", "}", "'", '"', "\\", "//", "\n", "\0", "é", "\ud800", "dyn(", "@"),
]


@given(st.one_of(st.text(max_size=80), st.lists(st.sampled_from(WORDS), max_size=25).map(" ".join)))
def test_any_text_is_a_valid_expression_or_is_refused(text: str) -> None:
    for kind in (Objective, Condition):
        try:
            expression = kind(text)
            values = {quantity: 0.5 + i for i, quantity in enumerate(expression.needs)}
            result: Any = expression.value(values) if isinstance(expression, Objective) else expression.holds(values)
        except WorldError as error:
            assert error.code == "bad_expression"
        else:
            assert math.isfinite(result)


VALUES = {
    **{"height": 3.0, "max.speed": 0.25, 'cube("a").position.x': -1.5, "min.displacement.z": 0.0, "energy": -0.0},
    **{"time": math.nan, "mass": math.inf, "cubes": -1.7e308, "reach": 5e-324},
}
Meant = tuple[str, float]  # an expression, and what it comes to
MEASURES = {
    "+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "min": np.minimum, "max": np.maximum,
    "abs": np.abs, "sqrt": np.sqrt, "exp": np.exp, "log": np.log,
    "<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal, "==": np.equal, "!=": np.not_equal,
    "&&": np.logical_and, "||": np.logical_or,
}  # fmt: skip


@st.composite
def numbers(draw: st.DrawFn, depth: int) -> Meant:
    kind = draw(st.integers(0, 8 if depth else 2))
    if kind == 0:
        return draw(st.sampled_from(list(VALUES.items())))
    if kind == 1:
        number = draw(st.floats(0, 1e6))
        return repr(number), number
    if kind == 2:
        whole = draw(st.integers(0, 10**6))
        return str(whole), float(whole)
    a, b = draw(numbers(depth - 1)), draw(numbers(depth - 1))
    if kind == 3:
        return f"-({a[0]})", -a[1]
    if kind == 4:
        truth = draw(truths(depth - 1))
        return f"({truth[0]} ? {a[0]} : {b[0]})", a[1] if truth[1] else b[1]
    if kind == 5:
        return call(draw(st.sampled_from(["min", "max"])), a, b)
    if kind == 6:
        return call(draw(st.sampled_from(["abs", "sqrt", "exp", "log"])), a)
    return binary(a, draw(st.sampled_from("+-*/")), b)


@st.composite
def truths(draw: st.DrawFn, depth: int) -> Meant:
    if not depth:
        return draw(st.sampled_from([("true", True), ("false", False)]))
    kind = draw(st.integers(0, 2))
    if kind == 0:
        a, b = draw(numbers(depth - 1)), draw(numbers(depth - 1))
        return binary(a, draw(st.sampled_from(["<", "<=", ">", ">=", "==", "!="])), b)
    a, b = draw(truths(depth - 1)), draw(truths(depth - 1))
    return (f"!({a[0]})", not a[1]) if kind == 1 else binary(a, draw(st.sampled_from(["&&", "||"])), b)


@np.errstate(all="ignore")
def call(name: str, *arguments: Meant) -> Meant:
    return f"{name}({', '.join(text for text, _ in arguments)})", MEASURES[name](*(value for _, value in arguments))


@np.errstate(all="ignore")
def binary(a: Meant, mark: str, b: Meant) -> Meant:
    return f"({a[0]} {mark} {b[0]})", MEASURES[mark](a[1], b[1])


@given(numbers(3))
def test_an_expression_has_the_value_that_ieee_754_gives_it(meant: Meant) -> None:
    text, value = meant
    objective = Objective(text)
    values = {quantity: VALUES[str(quantity)] for quantity in objective.needs}
    if math.isfinite(value):
        assert objective.value(values) == pytest.approx(value, rel=1e-12)
    else:
        with pytest.raises(WorldError, match="no finite number"):
            objective.value(values)


@given(truths(3))
def test_a_condition_has_the_truth_that_ieee_754_gives_it(meant: Meant) -> None:
    condition = Condition(meant[0])
    assert condition.holds({quantity: VALUES[str(quantity)] for quantity in condition.needs}) == meant[1]


@pytest.mark.parametrize("mark", ["<", "<=", ">", ">=", "==", "!="])
def test_what_is_no_number_is_unequal_to_everything_and_neither_less_nor_greater(mark: str) -> None:
    for text in (f"height {mark} sqrt(-1)", f"sqrt(-1) {mark} height", f"sqrt(-1) {mark} sqrt(-1)"):
        condition = Condition(text)
        assert condition.holds(dict.fromkeys(condition.needs, 1.0)) == (mark == "!=")


def test_one_row_and_many_rows_and_running_quantities_agree_about_what_is_no_number() -> None:
    trajectory = random_trajectory(5)
    condition = Condition("position.y < sqrt(position.x)")
    rows = trajectory.series(Quantity("position.x")).tolist(), trajectory.series(Quantity("position.y")).tolist()
    expected = [x >= 0 and y < math.sqrt(x) for x, y in zip(*rows, strict=True)]
    assert not expected[0] and any(expected) and min(rows[0]) < 0
    assert trajectory.first(condition, 0, 21) == expected.index(True)
    running = RunningQuantities(trajectory.bodies, condition.needs, trajectory.states[0], trajectory.touches[0])
    choice = Objective("position.y < sqrt(position.x) ? 1 : 2")
    assert trajectory.values_so_far(choice).tolist() == [1.0 if held else 2.0 for held in expected]
    for row, held in enumerate(expected):
        now = trajectory.states[row], trajectory.work[row], trajectory.touches[row]
        assert condition.holds(running.values(*now)) == held
        running.add(*now)


def test_one_expression_serves_many_threads() -> None:
    objective, condition = Objective("2 * height + max(speed, 1)"), Condition("speed > 50")
    height, speed = objective.needs
    wrong: list[float] = []

    def work(offset: int) -> None:
        for i in range(2000):
            h, s = float(i * 7 + offset), float(i % 100)
            if objective.value({height: h, speed: s}) != 2 * h + max(s, 1.0) or condition.holds({speed: s}) != (s > 50):
                wrong.append(h)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


# -- quantities -------------------------------------------------------------------------------------------------------


def random_trajectory(seed: int, n: int = 3, ticks: int = 20, **changes: Any) -> Trajectory:
    """A trajectory of cubes that are anywhere: a body, and one cube besides."""
    random = np.random.default_rng(seed)
    fields = {"target": (1.0, 2.0, 3.0), "tick_rate": 50, **changes}
    ids = tuple("abcdefgh"[: n + 1])
    trajectory = Trajectory(
        ObservedBodies(ids, n, random.uniform(0.1, 2, (n + 1, 3)), random.uniform(0.1, 5, n + 1), **fields),
        ticks,
        2,
        contacts=True,
    )
    trajectory.states[:] = random.normal(size=trajectory.states.shape)
    trajectory.states[:, :, 3:7] /= np.linalg.norm(trajectory.states[:, :, 3:7], axis=2, keepdims=True)
    trajectory.meter(0, random.uniform(0.0, 2.0, trajectory.work.shape))
    trajectory.touches[:] = random.uniform(size=trajectory.touches.shape) < 0.5
    trajectory.rows = ticks + 1
    return trajectory


def reckon(trajectory: Trajectory, row: int, quantity: Quantity) -> float:
    """The definitions of docs/objectives.md, one cube and one corner at a time."""
    name, _, axis = quantity.name.partition(".")
    bodies = trajectory.bodies
    who = range(bodies.body) if quantity.cube is None else [bodies.cubes.index(quantity.cube)]
    mass = sum(bodies.masses[i] for i in who)

    def mean(at: int, first: int) -> Any:
        return sum(bodies.masses[i] * trajectory.states[at, i, first : first + 3] for i in who) / mass

    centre, start, velocity = mean(row, 0), mean(0, 0), mean(row, 7)
    corners = [
        trajectory.states[row, i, :3]
        + rotate(tuple(trajectory.states[row, i, 3:7]), tuple(bodies.sizes[i] / 2 * (x, y, z)))
        for i in who
        for x in (-1, 1)
        for y in (-1, 1)
        for z in (-1, 1)
    ]

    def aim(target: Any) -> Any:
        if isinstance(target, str):
            return trajectory.states[row, bodies.cubes.index(target), :3]
        return start if target is None else target

    up = [rotate(tuple(trajectory.states[k, 0, 3:7]), (0.0, 1.0, 0.0))[1] for k in range(row + 1)]
    vectors = {"position": centre, "displacement": centre - start, "velocity": velocity}
    if axis == "horizontal":
        return float(np.hypot(vectors[name][0], vectors[name][2]))
    if axis:
        return float(vectors[name]["xyz".index(axis)])
    plain: dict[str, Callable[[], Any]] = {
        "time": lambda: row / bodies.tick_rate,
        "speed": lambda: np.linalg.norm(velocity),
        "distance": lambda: np.linalg.norm(centre - aim(bodies.target)),
        "height": lambda: centre[1],
        "lowest": lambda: min(corner[1] for corner in corners),
        "highest": lambda: max(corner[1] for corner in corners),
        "reach": lambda: max(np.linalg.norm(corner - centre) for corner in corners),
        "uprightness": lambda: rotate(tuple(trajectory.states[row, who[0], 3:7]), (0.0, 1.0, 0.0))[1],
        "time_upright": lambda: sum(cosine >= 0.5 for cosine in up[1:]) / bodies.tick_rate,
        "energy": lambda: trajectory.work[row].sum(),
        "work": lambda: trajectory.work[row].sum(),
        "grown": lambda: 0.0,  # of a body that keeps its parts
        "contacts": lambda: sum(trajectory.touches[row, i, 0 if quantity.cube else 1] for i in who),
        "cubes": lambda: len(who),
        "mass": lambda: mass,
    }
    return float(plain[name]())


@pytest.mark.parametrize("name", QUANTITIES)
@pytest.mark.parametrize("target", [None, (1.0, 2.0, 3.0), "d"])
def test_each_quantity_is_as_defined(name: str, target: Any) -> None:
    trajectory = random_trajectory(1, target=target)
    for cube in (None, "b", "d") if name in CUBE_QUANTITIES else (None,):
        expected = [reckon(trajectory, row, Quantity(name, cube)) for row in range(trajectory.rows)]
        assert trajectory.series(Quantity(name, cube)) == pytest.approx(np.array(expected), abs=1e-12)
        values = trajectory.values(Quantity(name, cube, fold) for fold in FOLDS)
        assert list(values.values()) == pytest.approx(
            [expected[-1], expected[0], min(expected), max(expected), np.mean(expected)]
        )


EVERYTHING = [
    *(Quantity(name, None, fold) for name in QUANTITIES for fold in FOLDS),
    *(Quantity(name, cube, fold) for name in CUBE_QUANTITIES for fold in FOLDS for cube in ("a", "d")),
]


@pytest.mark.parametrize("n", [1, 2, 7])
def test_running_quantities_equal_those_of_the_whole_trajectory_bit_for_bit(n: int) -> None:
    trajectory = random_trajectory(n, n)
    quantities = [q if q.cube != "d" else Quantity(q.name, trajectory.bodies.cubes[-1], q.fold) for q in EVERYTHING]
    running_quantities = RunningQuantities(trajectory.bodies, quantities, trajectory.states[0], trajectory.touches[0])
    for ticks in range(21):
        row = (trajectory.states[ticks], trajectory.work[ticks], trajectory.touches[ticks])
        if ticks:
            running_quantities.add(*row)
            if ticks == 10:  # half way it is put down and taken up again
                state = running_quantities.state()
                running_quantities = RunningQuantities(
                    trajectory.bodies, quantities, trajectory.states[10], trajectory.touches[10]
                )
                running_quantities.resume(state)
        trajectory.rows = ticks + 1
        assert running_quantities.values(*row) == trajectory.values(quantities)


def test_the_first_row_at_which_a_condition_holds_is_found_for_any_block_size() -> None:
    trajectory = random_trajectory(5)
    condition = Condition("max.speed > 1.1 && mean.height < 0.05 || time > 0.35")
    outcomes = []
    for row in range(trajectory.rows):
        trajectory.rows = row + 1
        outcomes.append(condition.holds(trajectory.values(condition.needs)))
    trajectory.rows = 21
    expected = outcomes.index(True)
    assert 0 < expected < 18
    assert trajectory.first(condition, 0, 21) == expected
    for size in (1, 2, 5):
        rows = [trajectory.first(condition, begin, begin + size) for begin in range(0, expected + 1, size)]
        assert rows[:-1] == [None] * (len(rows) - 1) and rows[-1] == expected
    assert trajectory.first(condition, 0, expected) is None
    assert trajectory.first(Condition("true"), 3, 9) == 3
    assert trajectory.first(Condition("true"), 9, 9) is None


def test_work_adds_up_what_every_motor_gave_since_the_start() -> None:
    trajectory = Trajectory(ObservedBodies(("a",), 1, np.ones((1, 3)), np.ones(1), 10), 3, 2)
    trajectory.rows = 4
    powers = np.array([[81.0, 81.0], [5.0, 10.0], [10.0, 0.0], [15.0, 5.0]])
    trajectory.meter(0, powers)
    assert trajectory.series(Quantity("energy")).tolist() == pytest.approx([0.0, 1.5, 2.5, 4.5])
    whole = trajectory.work.copy()
    for begin, end in ((0, 1), (1, 3), (3, 3), (3, 4)):
        trajectory.meter(begin, powers[begin:end])
    assert (trajectory.work == whole).all()


def test_a_turned_body_is_upright_by_its_cosine_and_as_high_as_its_top_corner() -> None:
    trajectory = Trajectory(ObservedBodies(("a",), 1, np.array([[1.0, 2.0, 1.0]]), np.array([1.0]), 60), 0, 0)
    trajectory.states[0, 0, 3:7] = normalize(quaternion_from_euler(0.0, 1.0, math.pi / 6))
    trajectory.rows = 1
    (up, high, reach) = (trajectory.series(Quantity(name))[0] for name in ("uprightness", "highest", "reach"))
    assert up == pytest.approx(math.cos(math.pi / 6))
    assert high == pytest.approx(math.cos(math.pi / 6) + 0.5 * math.sin(math.pi / 6))
    assert reach == pytest.approx(math.hypot(0.5, 1.0, 0.5))
