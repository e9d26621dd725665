"""Leaderboards of creatures that have met: each entry is all matches of the same creatures on a task with roles."""

from __future__ import annotations

import json
from pathlib import Path
from statistics import pstdev
from typing import Any

import pytest

from boards import edit, key_in, proofs_of, run, signed, verdicts
from creatures import mlp, snake
from duels import DUEL, push, roles
from nmes.errors import LeaderboardError
from nmes.evaluation import MatchTask, play, prove_match
from nmes.evaluation.leaderboard import Leaderboard
from nmes.evaluation.leaderboard_entry import facts
from nmes.genome import Genome
from opengl import OPENGL

# Whoever has come farther towards the other has more, and both have both sides.
RACE = {
    **DUEL, "name": "race", "duration": 0.5, "seeds": [3, 4], "interchangeable": True, "margin": 0.01,
    **roles({"objective": "red.displacement.x"}, {"objective": "-blue.displacement.x"}),
}  # fmt: skip
FAST, SLOW, STILL = push(9.0, name="fast"), push(4.0, name="slow"), snake(None, name="still")


def meet(folder: Path, task: dict[str, Any], one: dict[str, Any], other: dict[str, Any]) -> list[str]:
    """Plays all matches of two creatures; returns their recordings."""
    folder.mkdir(exist_ok=True)
    asked, creatures = MatchTask(task), (Genome(one), Genome(other))
    found = []
    for seed in asked.seeds:
        for way in asked.sides(seed):
            cast = {role: creatures[number] for role, number in zip(asked.roles, way, strict=True)}
            (match,) = play(asked, cast, seeds=[seed], record=folder)
            assert match.recording is not None
            found.append(match.recording)
    return found


@pytest.fixture(scope="module")
def races(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The recordings of three creatures that race each other: twelve matches."""
    folder = tmp_path_factory.mktemp("races")
    pairs = ((FAST, SLOW), (STILL, FAST), (SLOW, STILL))
    return [path for one, other in pairs for path in meet(folder, RACE, one, other)]


@pytest.fixture
def board(tmp_path: Path, races: list[str]) -> Path:
    """A leaderboard with the races."""
    path = new_board(tmp_path, RACE)
    result = run("add", path, *races)
    assert result.exit_code == 0, result.output
    return path


def new_board(folder: Path, *tasks: dict[str, Any]) -> Path:
    """Makes a leaderboard that takes these tasks."""
    path = folder / "board.sqlite"
    for task in tasks:
        (folder / "task.json").write_text(json.dumps(task))
        assert run("tasks", path, "--allow", folder / "task.json").exit_code == 0
    return path


def shown(board: Path, *options: str) -> list[dict[str, Any]]:
    listed: list[dict[str, Any]] = json.loads(run("show", board, "--json", *options).stdout)
    return listed


def test_a_pair_is_listed_with_what_all_its_matches_prove(board: Path, races: list[str]) -> None:
    entries = shown(board)
    assert len(entries) == 3
    (entry,) = (each for each in entries if {player["name"] for player in each["players"]} == {"fast", "slow"})
    proofs = [prove_match(path) for path in races[:4]]
    for player in entry["players"]:
        own = [
            proof.results[role].score
            for proof in proofs
            for role, genome in proof.genomes.items()
            if genome.name == player["name"]
        ]
        scores = [score for score in own if score is not None]
        assert len(scores) == 4 and player["role"] == ""
        assert player["score"] == pytest.approx(sum(scores) / 4) and player["spread"] == pytest.approx(pstdev(scores))
        assert player["places"] == [0 if player["name"] == "fast" else 1] * 4
    assert entry["score"] == pytest.approx(sum(player["score"] for player in entry["players"]) / 2)
    assert entry["author"] == entry["key"] == "" and len(entry["recordings"]) == 4
    assert "fast" in run("show", board).stdout and run("verify", board, "--jobs", "2").stdout == "3 of 3 entries hold\n"


def test_roles_that_differ_have_one_match_a_seed(tmp_path: Path) -> None:
    recordings = meet(tmp_path / "proofs", DUEL, push(), snake())
    path = new_board(tmp_path, DUEL)
    result = run("add", path, *reversed(recordings))
    assert result.exit_code == 0 and "listed: red cart " in result.stdout, result.output
    (entry,) = shown(path)
    assert [player["role"] for player in entry["players"]] == ["red", "blue"] and len(entry["recordings"]) == 2
    other_way = run("add", path, *meet(tmp_path / "proofs", DUEL, snake(), push()))
    assert other_way.exit_code == 0, "who plays what makes another entry"
    assert run("verify", path, "--jobs", "1").stdout == "2 of 2 entries hold\n"


@pytest.mark.parametrize("kept", [slice(0, 3), slice(1, 4), slice(0, 0)])
def test_a_pair_takes_all_matches_from_all_sides(kept: slice, tmp_path: Path, races: list[str]) -> None:
    path = new_board(tmp_path, RACE)
    chosen = races[:4][kept] or [races[0], races[0], races[1], races[2], races[3]]
    result = run("add", path, *chosen)
    assert result.exit_code == 1 and "all matches with the seeds 3, 4, played from every side" in result.stderr
    assert shown(path) == []


def test_a_pair_is_listed_once_whatever_it_is_called_and_in_whatever_order(board: Path, tmp_path: Path) -> None:
    copies = {**SLOW, "name": "mine", "author": "Eve"}, {**FAST, "name": "yours"}
    again = run("add", board, *meet(tmp_path / "copies", RACE, *copies))
    assert again.exit_code == 1 and "these creatures are listed for the task race already" in again.stderr
    assert len(shown(board)) == 3


def test_matches_of_others_are_no_part_of_an_entry(races: list[str], tmp_path: Path) -> None:
    proofs = [prove_match(path, brain=True) for path in races]
    for mixed in (proofs[:3] + proofs[4:5], proofs[:8]):
        with pytest.raises(LeaderboardError, match="all matches") as caught:
            facts(mixed)
        assert caught.value.code == "incomplete"
    alone = proofs_of(tmp_path / "alone", snake(mlp(4), name="alone"))
    path = new_board(tmp_path, RACE)
    result = run("add", path, *races[:4], *alone)  # each is judged by itself
    assert result.exit_code == 1 and "does not take the task dash" in result.stderr and len(shown(path)) == 1


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"name":"fast"', '"name":"best"', "players: listed"),
        ('"places":[1,', '"places":[0,', "players: listed"),
        ('"role":""', '"role":"red"', "players: listed"),
        ('"score":', '"score":1', "players: listed"),
        ('"places":[0', '"places":[0.0', "no leaderboard writes"),
        ('"places":[', '"place":[', "no leaderboard writes"),
        ('"places":[1,', '"places":[1,1,', "no leaderboard writes"),
        ('"name":"slow"', '"name":["slow"]', "no leaderboard writes"),
        ("[{", "{", "cannot be read"),
    ],
)
def test_what_was_edited_of_a_pair_is_found(old: str, new: str, said: str, board: Path) -> None:
    edit(
        board,
        f"UPDATE entries SET players = replace(players, '{old}', '{new}') WHERE name IN ('fast, slow', 'slow, fast')",
    )
    status, found = verdicts(board)
    broken = [reason for verdict, reason in found.values() if verdict == "broken"]
    assert status == 1 and len(broken) == 1 and said in broken[0]
    assert run("show", board).exit_code == run("ratings", board).exit_code == 0


@pytest.mark.parametrize("kept", [0, 1])
def test_ratings_pass_over_a_row_with_too_few_players(kept: int, board: Path) -> None:
    edit(board, f"UPDATE entries SET players = json_array(json_extract(players, '$[{kept}]')) WHERE name LIKE '%slow%'")
    rated = run("ratings", board, "--json")
    assert rated.exit_code == 0 and {
        each["name"]: each["wins"] + each["losses"] for each in json.loads(rated.stdout)
    } == {
        "fast": 4,
        "still": 4,
    }
    status, found = verdicts(board)
    assert status == 1 and [verdict for verdict, _ in found.values()].count("broken") == 2


def test_a_signature_of_matches_is_no_claim_to_a_creature(tmp_path: Path) -> None:
    """Who records a match of somebody else's creature does not get that author's name, nor is kept from playing."""
    path = new_board(tmp_path, RACE, {**RACE, "name": "again", "duration": 0.4})
    theirs = {**FAST, "author": "Ada"}
    first = signed(meet(tmp_path / "one", RACE, theirs, SLOW), key_in(tmp_path / "one.pem", 1))
    assert run("add", path, *first).exit_code == 0
    second = meet(tmp_path / "two", {**RACE, "name": "again", "duration": 0.4}, theirs, SLOW)
    assert run("add", path, *signed(second, key_in(tmp_path / "two.pem", 2))).exit_code == 0
    assert [(entry["author"], len(entry["key"])) for entry in shown(path)] == [("", 64), ("", 64)]
    assert verdicts(path)[0] == 0


def test_a_role_without_a_score_is_not_listed(tmp_path: Path) -> None:
    never = {**DUEL, **roles({"objective": "log(red.displacement.x - 100)"}, {})}
    result = run("add", new_board(tmp_path, never), *meet(tmp_path / "proofs", never, push(), snake()))
    assert result.exit_code == 1 and "'cart' as red on duel: a match has no score" in result.stderr


def test_ratings_follow_from_the_entries_alone(board: Path, races: list[str], tmp_path: Path) -> None:
    found = json.loads(run("ratings", board, "--json").stdout)
    assert [(each["name"], each["wins"], each["draws"], each["losses"]) for each in found] == [
        ("fast", 8, 0, 0),
        ("slow", 4, 0, 4),
        ("still", 0, 0, 8),
    ]
    other = tmp_path / "other"
    other.mkdir()
    path = new_board(other, RACE)
    assert run("add", path, *races[8:], *races[:8]).exit_code == 0
    assert json.loads(run("ratings", path, "--json").stdout) == found
    assert run("ratings", board, "--task", "race").stdout.count("\n") == 4
    assert run("ratings", board, "--task", "sumo").stdout.count("\n") == 1


def test_who_lists_a_creature_again_renames_it_for_nobody(tmp_path: Path) -> None:
    board = new_board(tmp_path, RACE)
    assert run("add", board, *meet(tmp_path / "hers", RACE, FAST, SLOW)).exit_code == 0
    for number in range(4):  # whichever of the entries comes first by its hash
        his = meet(tmp_path / str(number), RACE, {**FAST, "name": "his"}, push(1.5 + number, name=f"dummy {number}"))
        assert run("add", board, *his).exit_code == 0
    rated = json.loads(run("ratings", board, "--json").stdout)
    assert [each["name"] for each in rated if each["name"] in ("fast", "his")] == ["fast"]


def test_where_all_have_one_objective_nobody_is_rated(tmp_path: Path) -> None:
    """They are always equally good: of who is better, nothing follows."""
    objective = {"objective": "red.displacement.x - blue.displacement.x"}
    task = {**DUEL, **roles(objective, objective)}
    path = new_board(tmp_path, task)
    assert run("add", path, *meet(tmp_path / "proofs", task, push(), snake())).exit_code == 0
    (entry,) = shown(path)
    assert entry["score"] == entry["players"][0]["score"] == entry["players"][1]["score"]
    assert json.loads(run("ratings", path, "--json").stdout) == []


def test_a_board_of_pairs_is_packed_imported_and_shown_as_a_page(board: Path, tmp_path: Path) -> None:
    packed, page = tmp_path / "board.zip", tmp_path / "board.html"
    assert run("pack", board, "-o", packed).exit_code == 0
    imported = run("import", tmp_path / "theirs.sqlite", packed, "--allow")
    assert imported.exit_code == 0 and "3 entries of 3 new" in imported.stdout, imported.output
    drop = {"id", "unit"}
    assert [{k: v for k, v in each.items() if k not in drop} for each in shown(tmp_path / "theirs.sqlite")] == [
        {k: v for k, v in each.items() if k not in drop} for each in shown(board)
    ]
    assert run("export", board, "-o", page).exit_code == 0
    text = page.read_text()
    assert text.count("<li>") == 3 and "seed 3, side 1" in text and "seed 4, side 2" in text
    films = 1 if OPENGL else 0  # of the best
    assert text.count('src="data:image/gif;base64,') == films and text.count('src="data:image/png;base64,') == 3 - films


def test_a_forged_match_is_not_listed(tmp_path: Path, races: list[str]) -> None:
    path = new_board(tmp_path, RACE)
    forged = tmp_path / "forged.mcap"
    forged.write_bytes(Path(races[0]).read_bytes()[:-2000])
    result = run("add", path, forged, *races[1:4])
    assert result.exit_code == 1 and result.stderr.count("refused") == 2 and shown(path) == []


def test_the_creatures_of_an_entry_are_told(board: Path) -> None:
    with Leaderboard(board) as kept:
        entry = kept.entries()[0]
        assert {genome.hash for genome in kept.genomes(entry)} == {player.genome_hash for player in entry.players}
        edit(board, f"UPDATE entries SET players = replace(players, '{entry.players[0].genome_hash}', '{'0' * 64}')")
        with pytest.raises(LeaderboardError, match="of other genomes"):
            kept.genomes(kept.entries()[0])
