"""Documents that are no studies: what is wrong with them is told with its place, and nothing is run."""

from __future__ import annotations

from pathlib import Path

import pytest

from command_line import run
from studies import edit, make_study


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("seeds = [1, 2, 3]", "seeds = [1]", "budgets/small/seeds"),
        ("seeds = [1, 2, 3]", "seeds = [1, 1, 2]", "budgets/small/seeds"),
        ("gain > 2", "gian > 2", "claims/1/holds: line 1, column 1: there is no quantity 'gian'; did you mean gain?"),
        ("gain > 2", "gain", "claims/1/holds: line 1, column 1: it must give true or false"),
        ("{genome}.json", "{genom}.json", "there is nothing that {genom} stands for; did you mean genome?"),
        ('"{study}/slide.json"', '"{stud}/slide.json"', "setting task: there is nothing that {stud} stands for"),
        ("nmes eval", "rm -r", "commands/score"),
        ('"score /0/score"', '"sore /0/score"', "columns/score: there is no command sore; did you mean score?"),
        ('over = "still" }', 'over = "stil" }', "values/gain/over: there is no arm stil; did you mean still?"),
        ('arm = "swinging" }', 'arm = "swinging", over = "still" }', "values/swinging/over: iqm is of one arm"),
        ('name = "open"', 'name = "farther"', "claims/1/name: there are two of the name farther"),
        (
            'title = "A small study"',
            'title = "."\nmeasured = ["scor"]',
            "measured: there is no column scor; did you mean",
        ),
        ("minutes = 0.1", "minutes = nan", "is no TOML: nan is no finite number"),
        ("minutes = 0.1", f"minutes = 1{26 * '0'}", "budgets/small/minutes: whole numbers go to 9,007,199,254,740,992"),
        ('"m"', '"m"\nwhere = { size = 1 }', "figures/0/where: there is no factor size"),
        ('about = "It swings."', 'about = "\\u0000"', "arms/0/about: it has a character of the code 0"),
        ('"It swings."', '"."\nenvironment = { "A=B" = "" }', "arms/0/environment: 'A=B' cannot be the name of a"),
        ('{ genome = "still" }', '{ genome = "{kind}", kind = "{seed}" }', "setting genome: {kind} stands for {seed}"),
        ("nmes eval", "nmes eval '", "commands/score: it is no command line: no closing quotation"),
        ("[settings]", "[scales.f]\n1 = 0\n[settings]", "scales/f/1"),
        ("[settings]", "[settings]\nstudy = 1", "settings/study: {study} is a placeholder of every command"),
        ('{ genome = "still" }', '{ genome = "still", run = 1 }', "arms/1/settings/run: {run} is a placeholder of"),
        ("[settings]", "[factors]\nseed = [1]\n[settings]", "factors/seed: {seed} is a placeholder of every command"),
        (
            "minutes = 0.1",
            "minutes = 0.1\nsettings = { seed = 1 }",
            "budgets/small/settings/seed: {seed} is a",
        ),
        ("[settings]", "[settings", "is no TOML"),
        ('format = "nmes-study/1"', 'format = "nmes-study/9"', "format"),
    ],
)
def test_what_is_wrong_with_a_study_is_told_with_its_place(old: str, new: str, words: str, tmp_path: Path) -> None:
    folder = make_study(tmp_path / "wrong")
    edit(folder / "study.toml", old, new)
    result = run("study", "run", folder)
    assert result.exit_code == 2 and words in result.output, result.output


def test_arms_that_share_nothing_are_not_equal(tmp_path: Path) -> None:
    folder = make_study(tmp_path / "wrong")
    edit(folder / "study.toml", 'statistic = "equal", column = "hash"', 'statistic = "equal"')
    edit(folder / "study.toml", 'title = "A small study"', 'title = "A small study"\nmeasured = ["score", "hash"]')
    result = run("study", "run", folder)
    assert result.exit_code == 2 and "values/alike/column: both arms have no column that is not" in result.output


def test_what_is_not_there_is_told_with_what_to_do(tmp_path: Path) -> None:
    result = run("study", "report", tmp_path / "none")
    assert result.exit_code == 2 and "there is no study in " in result.output
    folder = make_study(tmp_path / "fresh")
    result = run("study", "verify", folder)
    assert result.exit_code == 1 and f"nmes study run {folder} --budget small" in result.output
    assert "fresh has no budget full: there is small" in run("study", "run", folder, "--budget", "full").output
