"""Searching: Hypothesis plays random commands, legal and not, against a model of a world, and shrinks what goes wrong.

It hides Hypothesis. Same seed, same search: nothing is kept from run to run, nor taken from the modules that happen to
be imported, whose constants Hypothesis else draws too. A failure becomes the shortest script that shows it,
`Trial.script`, which is then played once more for the report.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import hypothesis
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.configuration import set_hypothesis_home_dir
from hypothesis.errors import Flaky
from hypothesis.internal.conjecture.providers import AVAILABLE_PROVIDERS, HypothesisProvider
from hypothesis.internal.constants_ast import Constants
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule, run_state_machine_as_test

from nmes.conformance.case import Category, Finding, Row, Scope
from nmes.conformance.model import CLIENTS, Player, Script, play_script
from nmes.conformance.trial import Halted, Trial
from nmes.conformance.values import FIELD_NEEDS, fields, wrong
from nmes.conformance.wire import Log, Wire
from nmes.protocol import COMMANDS
from nmes.schemas import Schema

SEARCH = Category(17, "search")
case, table = SEARCH.case, SEARCH.table

EXAMPLES = 60  # conversations a case
STEPS = 30  # commands in each, at most
CUBES = 3  # names that a script gives
MILD = 5.0  # numbers that move things are drawn up to this, so that no engine goes wild
FIXED = frozenset(
    {"type", "id", "cube_name", "position", "cube1", "cube2", "joint_type", "list", "sensors", "rays", "group"}
)


class _Provider(HypothesisProvider):
    """Hypothesis' own source of examples, without the constants of the modules that are imported."""

    _local_constants = Constants()


@contextmanager
def _own_provider() -> Iterator[None]:
    """Has Hypothesis draw from the seed alone, and leave no folder in that of the user."""
    usual = AVAILABLE_PROVIDERS["hypothesis"]
    with tempfile.TemporaryDirectory(prefix="nmes-conform-", ignore_cleanup_errors=True) as folder:
        AVAILABLE_PROVIDERS["hypothesis"] = _Provider
        set_hypothesis_home_dir(folder)
        try:
            yield
        finally:
            set_hypothesis_home_dir(None)
            AVAILABLE_PROVIDERS["hypothesis"] = usual


def values(part: Schema) -> st.SearchStrategy[Any]:
    """Returns a strategy of mild values that a schema allows."""
    if "anyOf" in part:
        return st.one_of([values(choice) for choice in part["anyOf"]])
    low, high = max(part.get("minimum", -MILD), -MILD), min(part.get("maximum", MILD), MILD)
    match part.get("type"):
        case "boolean":
            return st.booleans()
        case "integer":
            return st.integers(int(low), int(high))
        case "number":
            # Not the tiniest: a cube of a micrometre and a microgramme is legal, but no engine's delight.
            return st.floats(max(low, 0.1) if low > 0 else low, high, allow_subnormal=False)
        case "array":
            least, most = part.get("minItems", 0), part.get("maxItems", 3)
            items = values(part.get("items", {}))
            lists = st.lists(items, min_size=least, max_size=most)
            return lists.filter(lambda value: any(abs(x) > 0.1 for x in value)) if "contains" in part else lists
    return st.sampled_from(part.get("enum", ["x"]))


def options(kind: str) -> st.SearchStrategy[dict[str, Any]]:
    """Returns a strategy of a command's optional fields."""
    return st.fixed_dictionaries(
        {}, optional={name: values(part) for name, part in fields(kind) if name not in FIXED and name != "is_base"}
    )


CUBE = st.sampled_from([*["{c0}", "{c1}", "{c2}"] * 3, "{c0}_BASE", "{c1}_BASE", "{u0}", "{u1}"])  # mostly there
JOINT = st.sampled_from(["{j0}", "{j1}", "{j2}"])
CLIENT = st.integers(0, CLIENTS - 1)


class Conversation(RuleBasedStateMachine):
    """Two clients in one world. `machine` derives from it, for one server.

    Attributes:
        trial: The case that searches.
        scripts: Where each conversation that fails leaves its script.
        findings: Where it leaves what was wrong.
    """

    trial: Trial
    scripts: list[Script]
    findings: list[Finding]

    def __init__(self) -> None:
        super().__init__()
        self.wires: list[Wire] = []
        try:
            for name in "ab":
                self.wires.append(wire := self.trial.target.connect(Log(), name))
                self.trial.halt.watch(wire)
                self.trial.target.enter(wire)
        except (Finding, Halted):
            self.teardown()  # Hypothesis calls it only where there is something to tear down
            raise
        self.player = Player(self.trial, self.wires)
        self.script: Script = []

    def say(self, client: int, command: dict[str, Any]) -> None:
        """Sends a command and judges the reply."""
        self.script.append({"client": client, "command": command})
        try:
            self.player.say(client, command)
        except Finding as finding:
            self.scripts.append(list(self.script))
            self.findings.append(finding)
            raise

    @rule(
        client=CLIENT,
        number=st.integers(0, CUBES - 1),
        base=st.integers(0, 4).map(lambda n: n == 4),
        more=options("spawn_cube"),
    )
    def spawn(self, client: int, number: int, base: bool, more: dict[str, Any]) -> None:
        """Spawns a cube of a name that scripts know, some as a base."""
        where = self.trial.at(2.5 * number - 4, 1.0 + 2.0 * base)
        extra = {"cube_name": f"{{c{number}}}", "position": where, **({"is_base": True} if base else {})}
        self.say(client, {"type": "spawn_cube", **more, **extra})

    @rule(client=CLIENT, number=st.integers(1, 5))
    def spawn_unnamed(self, client: int, number: int) -> None:
        """Spawns a cube that the world names."""
        self.say(client, {"type": "spawn_cube", "position": self.trial.at(y=5 + 2 * number), "list": False})

    @rule(client=CLIENT, cube=CUBE)
    def despawn(self, client: int, cube: str) -> None:
        """Removes a cube."""
        self.say(client, {"type": "despawn_cube", "cube_name": cube})

    @precondition(lambda self: self.trial.probe.claims("remove_joint"))
    @rule(client=CLIENT, joint=JOINT)
    def cut(self, client: int, joint: str) -> None:
        """Removes a joint."""
        self.say(client, {"type": "remove_joint", "joint_name": joint})

    @rule(client=CLIENT, cube=st.none() | CUBE, more=options("apply_physics"))
    def push(self, client: int, cube: str | None, more: dict[str, Any]) -> None:
        """Applies forces, torques and impulses."""
        more.pop("at", None)
        self.say(client, {"type": "apply_physics", "force": [0, 0, 0], **({"cube_name": cube} if cube else {}), **more})

    @precondition(lambda self: self.trial.probe.claims("freeze_cube"))
    @rule(client=CLIENT, cube=CUBE, freeze=st.booleans())
    def freeze(self, client: int, cube: str, freeze: bool) -> None:
        """Freezes a cube, or lets it go."""
        self.say(client, {"type": "freeze_cube", "cube_name": cube, "freeze": freeze})

    @precondition(lambda self: self.trial.probe.claims("set_cube_state"))
    @rule(client=CLIENT, cube=CUBE, more=options("set_cube_state"), height=st.none() | st.floats(1, 5))
    def put(self, client: int, cube: str, more: dict[str, Any], height: float | None) -> None:
        """Puts a cube somewhere."""
        where = {} if height is None else {"position": self.trial.at(y=height)}
        self.say(client, {"type": "set_cube_state", "cube_name": cube, **more, **where})

    @rule(client=CLIENT, cube=CUBE)
    def look(self, client: int, cube: str) -> None:
        """Reads a cube."""
        self.say(client, {"type": "get_cube_info", "cube_name": cube})

    @rule(client=CLIENT)
    def list_cubes(self, client: int) -> None:
        """Lists the cubes."""
        self.say(client, {"type": "get_cube_list"})

    @precondition(lambda self: self.trial.probe.claims("get_joint_list"))
    @rule(client=CLIENT)
    def list_joints(self, client: int) -> None:
        """Lists the joints."""
        self.say(client, {"type": "get_joint_list"})

    @precondition(lambda self: self.trial.probe.claims("get_world_state"))
    @rule(client=CLIENT, cubes=st.none() | st.lists(CUBE, max_size=3))
    def look_around(self, client: int, cubes: list[str] | None) -> None:
        """Reads the world, or some cubes of it."""
        self.say(client, {"type": "get_world_state", **({} if cubes is None else {"cubes": cubes})})

    @precondition(lambda self: self.trial.probe.claims("get_cube_state"))
    @rule(client=CLIENT)
    def look_at_own(self, client: int) -> None:
        """Reads the cube that the connection owns."""
        self.say(client, {"type": "get_cube_state"})

    @precondition(lambda self: self.trial.probe.stepping)
    @rule(client=CLIENT, ticks=st.integers(1, 5))
    def step(self, client: int, ticks: int) -> None:
        """Makes the world tick."""
        self.say(client, {"type": "step", "ticks": ticks})

    def teardown(self) -> None:
        """Closes the connections and removes the cubes."""
        for wire in self.wires:
            self.trial.halt.forget(wire)
            wire.close()
        self.trial.clean_up()
        self.trial.forget()


def machine(t: Trial, scripts: list[Script], findings: list[Finding]) -> type[Conversation]:
    """Returns the machine of one server, which adds the rules that depend on what the server claims."""
    probe = t.probe
    kinds = [kind for kind in ("fixed", "hinge", "slide", "pin") if probe.claims(f"joint.{kind}")]
    commands = [kind for kind in COMMANDS if probe.claims(kind) and kind not in ("reset", "set_mode", "step", "batch")]

    class World(Conversation):
        """Two clients in the server's world."""

        @precondition(lambda self: bool(kinds))
        @rule(client=CLIENT, one=CUBE, two=CUBE, kind=st.sampled_from(kinds or ["fixed"]))
        def join(self, client: int, one: str, two: str, kind: str) -> None:
            self.say(client, {"type": "create_joint", "cube1": one, "cube2": two, "joint_type": kind})

        @rule(client=CLIENT, kind=st.sampled_from(commands), data=st.data())
        def mistake(self, client: int, kind: str, data: st.DataObject) -> None:
            bad = [
                (name, value)
                for name, part in fields(kind)
                if all(map(probe.claims, FIELD_NEEDS.get((kind, name), ())))
                for value in wrong(part)
            ]
            name, value = data.draw(st.sampled_from(bad)) if bad else ("type", "no_such_command")
            self.say(client, {**COMMANDS[kind].schema["examples"][0], name: value})

    World.trial, World.scripts, World.findings = t, scripts, findings
    return World


def search(t: Trial, seed: int) -> tuple[Script, Finding] | None:
    """Returns the shortest script found that a server answers wrongly, and what was wrong; or None."""
    scripts: list[Script] = []
    findings: list[Finding] = []

    factory = machine(t, scripts, findings)

    def explore(phases: Sequence[Phase]) -> bool:
        hypothesis.seed(seed)(factory)
        profile = settings(
            max_examples=EXAMPLES,
            stateful_step_count=STEPS,
            phases=phases,
            database=None,
            deadline=None,
            report_multiple_bugs=False,
            suppress_health_check=list(HealthCheck),
        )
        try:
            with _own_provider():
                run_state_machine_as_test(factory, settings=profile)
        except (Finding, Flaky) as error:  # Flaky: the server answered otherwise when it was asked the same again
            t.halt.sleep(0)  # all that it met while it was cut says nothing
            if not findings:  # it failed before anything was said
                raise Finding("two connections", str(error)) from error
            return True
        return False

    if not explore([Phase.generate]):
        return None
    # To shrink a silence would cost a time-out for each attempt.
    if "in time" not in findings[-1].expected:
        explore([Phase.generate, Phase.shrink])
        _shorten(factory)
    shortest = _shortest(scripts)
    return scripts[shortest], findings[shortest]


def _shortest(scripts: Sequence[Script]) -> int:
    return min(range(len(scripts)), key=lambda n: (len(scripts[n]), len(str(scripts[n])), n))


def _shorten(factory: type[Conversation]) -> None:
    """Leaves out one command after the other where the rest fails too: Hypothesis gives up after 500 steps."""
    script = factory.scripts[_shortest(factory.scripts)]
    number = len(script)
    while number > 0:
        number = min(number, len(script)) - 1
        conversation = factory()
        try:
            for step in [*script[:number], *script[number + 1 :]]:
                conversation.say(step["client"], step["command"])
        except Finding:
            script = factory.scripts[-1]
        finally:
            conversation.teardown()


@table(1, "3.3.1", [Row(str(n), n) for n in range(4)], scope=Scope.TIME)
def random_conversations(t: Trial, number: int) -> None:
    """Two clients that say anything, legal and not, get the answers that a world must give."""
    failure = search(t, t.seed * 1000 + number)
    if failure is not None:
        script, finding = failure
        t.script = script
        play_script(t, script)
        raise Finding("the same answers to the same script", f"once {finding.received}, not {finding.expected}")
