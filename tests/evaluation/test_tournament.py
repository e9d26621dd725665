"""`nmes tournament`: who plays whom, what comes of it, and what is kept when it is stopped."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from command_line import run
from creatures import snake
from duels import DUEL, push, roles
from nmes.errors import MissingPackage, RunError, WorldError
from nmes.evaluation import prove_match
from nmes.evaluation.judge import Result
from nmes.evaluation.match_task import MatchTask
from nmes.evaluation.parallel import Here, Lost, Workers
from nmes.evaluation.ratings import places, rate
from nmes.evaluation.tournament import LOG, Tournament
from nmes.genome import Genome

NMES = str(Path(sys.executable).parent / "nmes")
# Whoever has come farther towards the other has more.
RACE = {
    **DUEL, "name": "race", "duration": 0.5, "seeds": [1], "interchangeable": True, "margin": 0.01,
    **roles({"objective": "red.displacement.x"}, {"objective": "-blue.displacement.x"}),
}  # fmt: skip
FIELD = [push(9.0, name="fast"), push(4.0, name="slow"), snake(None, name="still"), push(-5.0, name="backwards")]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a task and, in `field`, four creatures."""
    (tmp_path / "race.json").write_text(json.dumps(RACE))
    (tmp_path / "field").mkdir()
    for genome in FIELD:
        (tmp_path / "field" / f"{genome['name']}.json").write_text(json.dumps(genome))
    return tmp_path


def tournament(genomes: list[dict[str, Any]] = FIELD, **changes: Any) -> Tournament:
    return Tournament(MatchTask({**RACE, **changes}), [Genome(genome) for genome in genomes])


def played(contest: Tournament, path: Path | None = None, most: int = 10_000) -> list[int]:
    """Plays a tournament, or so many matches of it; returns which were played."""
    done = []
    matches = contest.play(Here(), path)
    for number in matches:
        done.append(number)
        if len(done) == most:
            break
    matches.close()  # type: ignore[attr-defined]
    return done


def test_a_package_that_is_missing_is_no_fault_of_those_who_play(monkeypatch: pytest.MonkeyPatch) -> None:
    def lacking(_: Genome) -> None:
        raise MissingPackage("a brain needs a package")

    monkeypatch.setattr("nmes.evaluation.match.brain_of", lacking)
    with pytest.raises(MissingPackage):
        tournament()


def test_the_better_come_first_and_all_play_all_in_all_roles() -> None:
    contest = tournament()
    played(contest)
    standings = contest.standings()
    assert [each.genome for each in standings] == ["fast", "slow", "still", "backwards"]
    assert [(each.wins, each.draws, each.losses, each.matches) for each in standings] == [
        (6, 0, 0, 6), (4, 0, 2, 6), (2, 0, 4, 6), (0, 0, 6, 6),
    ]  # fmt: skip
    assert Counter(pairing.players for pairing in contest.pairings) == {
        (a, b): 1 for a in range(4) for b in range(4) if a != b
    }
    for each in standings:  # mirrored places are worth the same
        assert each.score["red"] == pytest.approx(each.score["blue"], abs=1e-3)


def test_the_table_is_the_same_in_any_order_and_any_number_of_processes(folder: Path) -> None:
    backwards = tournament(FIELD[::-1])
    with Workers(2) as pool:
        assert len(list(backwards.play(pool, folder / "cup"))) == 12
    contest = tournament()
    played(contest)
    assert [each.to_json() for each in backwards.standings()] == [each.to_json() for each in contest.standings()]
    assert {each: contest.results[each] for each in range(12)} == {each: backwards.results[each] for each in range(12)}


def test_both_ways_are_played_where_roles_are_not_interchangeable_too() -> None:
    contest = tournament(FIELD[:2], interchangeable=False)
    assert sorted(pairing.players for pairing in contest.pairings) == [(0, 1), (1, 0)]


def test_every_match_is_kept_with_its_proof_and_is_not_played_again(folder: Path) -> None:
    contest = tournament()
    assert len(played(contest, folder / "cup")) == 12
    recordings = sorted((folder / "cup").glob("*.mcap"))
    assert len(recordings) == 12
    proof = prove_match(recordings[0], brain=True)
    assert dict(proof.results) in [match.results for match in contest.results.values()]
    before = [path.stat().st_mtime_ns for path in recordings]
    again = tournament()
    assert played(again, folder / "cup") == []
    assert again.results == contest.results and again.standings() == contest.standings()
    assert [path.stat().st_mtime_ns for path in recordings] == before


def test_what_was_stopped_goes_on_from_whatever_is_there(folder: Path) -> None:
    whole, log = tournament(), folder / "cup" / LOG
    played(whole)
    assert len(played(tournament(), folder / "cup", most=5)) == 5
    lines = log.read_bytes().splitlines(keepends=True)
    log.write_bytes(b"".join(lines)[:-7])  # the last line was not written to its end
    assert len(lines) == 5
    name = json.loads(lines[0])["recording"][0]
    (folder / "cup" / name).write_bytes(b"something else")
    rest = tournament()
    assert len(played(rest, folder / "cup")) == 9
    assert rest.standings() == whole.standings() and rest.results == whole.results
    assert dict(prove_match(folder / "cup" / name).results) in [match.results for match in rest.results.values()]


class Loses(Here):
    """A pool whose process dies over the first thing that it is given."""

    def run(self, function: Any, items: Any) -> Any:
        """Yields the results, the first of which is lost."""
        for index, item in enumerate(items):
            yield index, function(item) if index else Lost("the process that worked on it was killed by SIGKILL")


def test_a_match_over_which_a_process_died_is_void_and_played_again_the_next_time(folder: Path) -> None:
    contest, whole = tournament(), tournament()
    assert len(list(contest.play(Loses(), folder / "cup"))) == 12
    assert [each.void for each in contest.standings()].count(1) == 2
    assert all(result.score is None for result in contest.results[0].results.values())
    played(whole)
    again = tournament()
    assert played(again, folder / "cup") == [0]
    assert again.results == whole.results


@pytest.mark.parametrize(("number", "status"), [(signal.SIGKILL, -9), (signal.SIGTERM, 1), (signal.SIGINT, 1)])
def test_a_tournament_that_was_ended_goes_on_to_the_same_table(
    folder: Path, number: signal.Signals, status: int
) -> None:
    cup = folder / "cup"
    command = [NMES, "tournament", str(folder / "field"), "--task", str(folder / "race.json"), "--jobs", "1", "--json"]
    process = subprocess.Popen([*command, "-o", str(cup)], stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and not ((cup / LOG).is_file() and (cup / LOG).read_bytes().count(b"\n") >= 2):
        time.sleep(0.01)
    process.send_signal(number)
    assert process.wait() == status
    contest = tournament()
    played(contest)
    result = run(*command[1:], "-o", cup)
    assert result.exit_code == 0
    data = json.loads(result.stdout)
    assert data["standings"] == [each.to_json() for each in contest.standings()]
    assert len(data["matches"]) == 12 and all(Path(match["recording"]).is_file() for match in data["matches"])
    assert not list(cup.glob("*.part")) or len(list(cup.glob("*.mcap"))) == 12


def test_the_table_is_printed_with_who_lost_by_rule(folder: Path) -> None:
    (folder / "race.json").write_text(json.dumps({**RACE, "limits": {"energy": 3}}))
    result = run("tournament", folder / "field", "--task", folder / "race.json", "--jobs", "1")
    assert result.exit_code == 0, result.output
    rows = [line.split() for line in result.stdout.splitlines()]
    assert [row[1] for row in rows if row and row[0] in "1234"][-1] == "fast"
    assert "fast as red, seed 1: beyond: it was beyond its limit of energy" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["field", "--task", "walk"], "roles: there are none"),
        (["field", "--task", "interference-alone"], "between two roles and creatures, or more"),
        (["field/fast.json", "--task", "race.json"], "there are 1 creatures"),
        (["field", "race.json", "--task", "race.json"], "race.json:"),
        (["field", "--task", "race.json", "-o", "race.json"], "race.json"),
    ],
    ids=str,
)
def test_what_is_no_tournament_is_refused(arguments: list[str], said: str, folder: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(folder)
    result = run("tournament", *arguments)
    assert result.exit_code in (1, 2) and said in " ".join(result.stderr.split())


def test_the_same_genome_twice_is_refused() -> None:
    with pytest.raises(WorldError, match="'fast' and 'fast' are the same genome"):
        tournament([FIELD[0], FIELD[0]])


def test_a_creature_that_may_not_play_is_refused() -> None:
    with pytest.raises(WorldError, match=r"'\w+' may not play race: red: the body has 5 cubes"):
        tournament(limits={"cubes": 4})


@pytest.mark.parametrize("content", [b"My diary\n", b"My diary", b'{"key": 1}\n', b'{"key":"a","results":{}}\n'])
def test_a_log_of_somebody_else_is_left_alone(content: bytes, folder: Path) -> None:
    cup = folder / "cup"
    cup.mkdir()
    (cup / LOG).write_bytes(content)
    with pytest.raises(RunError, match=r"cup/matches.jsonl, line 1: not what `nmes tournament` writes"):
        played(tournament(), cup)
    assert (cup / LOG).read_bytes() == content


def test_a_log_that_is_a_link_or_a_pipe_is_not_written_to(folder: Path) -> None:
    (notes := folder / "notes").write_bytes(b"")
    (linked := folder / "linked").mkdir()
    (linked / LOG).symlink_to(notes)
    (piped := folder / "piped").mkdir()
    os.mkfifo(piped / LOG)
    for cup, said in ((linked, "it is a link"), (piped, "it is no regular file")):
        with pytest.raises(RunError, match=said):
            played(tournament(), cup, most=1)
    assert notes.read_bytes() == b""


def test_two_cannot_play_in_one_folder(folder: Path) -> None:
    first = tournament().play(Here(), folder / "cup")
    next(first)
    with pytest.raises(RunError, match="another nmes tournament plays in"):
        played(tournament(), folder / "cup")
    first.close()  # type: ignore[attr-defined]


def test_a_log_that_cannot_be_locked_is_told_as_that(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "no locks here")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(RunError, match=r"cannot be locked: no locks here") as error:
        played(tournament(), folder / "cup", most=1)
    assert error.value.code == "cannot_write"


# -- ratings -----------------------------------------------------------------------------------------------------------


def results(**scores: float | None) -> dict[str, Result]:
    return {role: Result(1, score, 0.0, 0.0, 1) for role, score in scores.items()}


@pytest.mark.parametrize(
    ("scores", "margin", "expected"),
    [
        ({"a": 1.0, "b": 2.0}, 0.0, {"a": 1, "b": 0}),
        ({"a": 1.0, "b": 1.04}, 0.05, {"a": 0, "b": 0}),
        ({"a": 1.0, "b": 1.06}, 0.05, {"a": 1, "b": 0}),
        ({"a": None, "b": -9.0}, 0.0, {"a": 1, "b": 0}),
        ({"a": None, "b": None}, 0.0, None),
        ({"a": 1.0, "b": 0.97, "c": 0.94, "d": None}, 0.04, {"a": 0, "b": 0, "c": 1, "d": 2}),
    ],
)
def test_places(scores: dict[str, float | None], margin: float, expected: dict[str, int] | None) -> None:
    assert places(results(**scores), margin) == expected


def test_who_wins_is_rated_above_who_loses_and_draws_bring_together() -> None:
    (untried,) = rate(1, [])
    assert (untried.skill, untried.doubt, untried.sure) == (25.0, 25.0 / 3.0, 0.0)
    first, second = rate(2, [((0, 1), (0, 1))] * 5)
    assert first.skill > 25.0 > second.skill and first.doubt < untried.doubt
    drawn = rate(2, [((0, 1), (0, 1))] * 5 + [((0, 1), (0, 0))] * 5)
    assert 0 < drawn[0].skill - drawn[1].skill < first.skill - second.skill
    three = rate(3, [((0, 1, 2), (2, 1, 0))] * 3)
    assert three[2].skill > three[1].skill > three[0].skill
