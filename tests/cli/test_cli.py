from __future__ import annotations

import base64
import json
import random
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click
import pytest
from click.testing import CliRunner, Result
from PIL import Image

from layout import ROOT
from nmes import Client
from nmes.cli import SUBCOMMANDS, main
from nmes.errors import RecordingError
from nmes.evaluation.leaderboard import Leaderboard
from nmes.recording import Kind, Recording
from opengl import with_opengl
from processes import NMES, process, ready
from recordings import busy, record
from servers import PATIENCE

DOCUMENT = (ROOT / "docs" / "cli.md").read_text()


def run(*arguments: str, **environment: str | None) -> Result:
    """Runs a command in this process."""
    return CliRunner().invoke(main, arguments, env={"NMES_PASSWORD": None, **environment})


# -- the command line as a whole --------------------------------------------------------------------------------------


def test_help_lists_all_subcommands_and_loads_none() -> None:
    code = "import sys; from nmes.cli import main; main(['--help'], standalone_mode=False); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=PATIENCE)
    for name, about in SUBCOMMANDS.items():
        assert re.search(rf"^  {name} +{re.escape(about)}$", done.stdout, flags=re.MULTILINE)
    loaded = set(done.stdout.splitlines()[-1].split())
    assert not loaded & {"numpy", "mujoco", "mcap", "asyncio", "jsonschema_rs", "nmes.server", "nmes.cli.serve"}


def commands(group: click.Group) -> Iterator[click.Command]:
    """Yields what a group holds, and what groups in it hold."""
    with click.Context(group) as context:
        for name in group.list_commands(context):
            command = group.get_command(context, name)
            assert command is not None
            yield command
            if isinstance(command, click.Group):
                yield from commands(command)


def test_help_shows_no_layout_marks() -> None:
    for command in commands(main):
        text = command.get_help(click.Context(command))
        assert "\\" not in text and "\b" not in text, text  # marks for layout that came through
        for line in text.splitlines():
            assert line.count("nmes ") < 2, line  # examples that have run together


def test_no_number_that_has_bounds_may_be_none_or_infinite() -> None:
    for command in commands(main):
        for option in command.params:
            if isinstance(option.type, click.FloatRange):
                for text in ("nan", "inf", "-inf"):
                    with pytest.raises(click.BadParameter):
                        option.type(text, option, None)


def test_version_is_printed() -> None:
    result = run("--version")
    assert result.exit_code == 0
    assert re.fullmatch(r"\S+ \d+\.\d+\.\d+\n", result.output)


def test_an_unknown_subcommand_is_wrong_usage() -> None:
    assert run("fly").exit_code == 2


def test_errors_are_one_line_and_exit_1(monkeypatch: pytest.MonkeyPatch) -> None:
    @click.command()
    def failing() -> None:
        raise RecordingError("damaged", "it ends at byte 7")

    monkeypatch.setitem(SUBCOMMANDS, "failing", "Fail.")
    module = type(sys)("nmes.cli.failing")
    monkeypatch.setattr(module, "command", failing, raising=False)
    monkeypatch.setitem(sys.modules, "nmes.cli.failing", module)
    result = run("failing")
    assert (result.exit_code, result.output) == (1, "Error: it ends at byte 7\n")


@pytest.mark.parametrize("name", SUBCOMMANDS)
def test_every_option_is_documented(name: str) -> None:
    command = main.get_command(click.Context(main), name)
    assert command is not None
    part = DOCUMENT.split(f"\n## nmes {name}\n")[1].split("\n## ")[0]
    documented = set(re.findall(r"--[a-z-]+", part))
    parts = [command, *commands(command)] if isinstance(command, click.Group) else [command]
    parameters = [parameter for part in parts for parameter in part.params if not getattr(parameter, "hidden", False)]
    options = {option for parameter in parameters for option in parameter.opts if option.startswith("--")}
    assert options <= documented
    assert {option for option in documented if f"`{option}" in part} <= options


def test_the_only_options_that_help_hides_are_an_old_name() -> None:
    hidden = [
        (command.name, option)
        for command in (main, *commands(main))
        for parameter in command.params
        if getattr(parameter, "hidden", False)
        for option in (*parameter.opts, *parameter.secondary_opts)
        if option.startswith("-")
    ]
    assert sorted(hidden) == [("diff", "--anyway"), ("export", "--anyway")]


FILES: list[tuple[str, ...]] = [
    ("info", "FILE"),
    ("verify", "FILE"),
    ("verify", "GOOD", "--verify-key", "FILE"),
    ("sign", "FILE", "--key", "FILE"),
    ("sign", "GOOD", "--key", "FILE"),
    ("replay", "FILE"),
    ("diff", "GOOD", "FILE"),
    ("export", "FILE", "--to", "csv"),
    ("fork", "FILE", "-o", "out.mcap"),
    ("render", "FILE", "-o", "out.png"),
    ("view", "FILE", "--save", "out.rrd"),
    ("serve", "--resume", "FILE", "--at", "0", "--port", "0"),
    ("serve", "--config", "FILE", "--port", "0", "--no-record"),
    ("serve", "--tls-cert", "FILE", "--tls-key", "FILE", "--port", "0", "--no-record"),
    ("genome", "check", "FILE"),
    ("genome", "show", "FILE"),
    ("genome", "expand", "FILE"),
    ("tasks", "FILE"),
    ("eval", "FILE"),
    ("eval", "walker", "--task", "FILE"),
    ("eval", "--from-recording", "FILE"),
    ("leaderboard", "add", "out.sqlite", "FILE"),
    ("leaderboard", "show", "FILE"),
    ("leaderboard", "verify", "FILE"),
    ("leaderboard", "export", "FILE", "-o", "out.html"),
    ("conform", "127.0.0.1:1", "--password", "x", "--replay", "FILE"),
    ("worlds", "127.0.0.1:1", "--password", "x", "--tls-ca", "FILE"),
]


@pytest.mark.parametrize("arguments", FILES, ids=" ".join)
def test_a_file_of_nonsense_is_an_error_and_leaves_no_output(
    arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "empty").touch()
    (tmp_path / "noise").write_bytes(random.Random(1).randbytes(4000))
    (tmp_path / "deep").write_text("[" * 100_000)
    (tmp_path / "long").write_text(f'{{"format": {"9" * 5000}, "seed": 1e400}}')
    record(tmp_path / "good.mcap", busy, {"backend": "ballistic"})
    before = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    for name in ("folder", "empty", "noise", "deep", "long", "nowhere"):
        result = run(*(name if word == "FILE" else "good.mcap" if word == "GOOD" else word for word in arguments))
        assert isinstance(result.exception, SystemExit) and result.exit_code in (1, 2), (name, result.output)
        assert name in result.output or name in result.stderr, result.output
    (tmp_path / "out.sqlite").unlink(missing_ok=True)  # made before its recordings are looked at
    assert {path.name: path.stat().st_size for path in tmp_path.iterdir()} == before


OUTPUTS: list[tuple[str, ...]] = [
    ("export", "GOOD", "--to", "csv", "-o", "FILE"),
    ("export", "GOOD", "--to", "parquet", "-o", "FILE"),
    ("fork", "GOOD", "-o", "FILE"),
    ("diff", "GOOD", "OTHER", "--plot", "FILE"),  # of equal ones there is nothing to plot
    ("replay", "GOOD", "--backend", "mujoco", "--plot", "FILE"),
    ("genome", "show", "walker", "-o", "FILE"),
    ("leaderboard", "export", "BOARD", "-o", "FILE"),
    ("leaderboard", "add", "FILE", "GOOD"),
]


@pytest.mark.parametrize("arguments", OUTPUTS, ids=" ".join)
def test_a_file_that_cannot_be_written_is_an_error(arguments: tuple[str, ...], tmp_path: Path) -> None:
    names = {"GOOD": "good.mcap", "OTHER": "other.mcap", "BOARD": "board.sqlite", "FILE": "nowhere/x"}
    words = {word: tmp_path / name for word, name in names.items()}
    record(words["GOOD"], busy, {"backend": "ballistic"})
    record(words["OTHER"], busy, {"backend": "ballistic", "gravity": [0, -5, 0]})
    Leaderboard(words["BOARD"], create=True).close()
    result = run(*(str(words.get(word, word)) for word in arguments))
    assert isinstance(result.exception, SystemExit) and result.exit_code in (1, 2), result.output
    assert "nowhere" in result.output


@pytest.mark.parametrize(
    "arguments", ["evolve verify", "evolve resume", "learn verify", "survey verify", "study verify"]
)
def test_a_folder_that_holds_nothing_of_its_kind_is_wrong_usage(arguments: str, tmp_path: Path) -> None:
    result = run(*arguments.split(), str(tmp_path))
    assert isinstance(result.exception, SystemExit) and result.exit_code == 2, result.output
    assert str(tmp_path) in result.output


@pytest.mark.parametrize(
    ("limit", "arguments", "words"),
    [
        (5, ("serve", "--port", "0", "--no-record", "--backend", "ballistic"), "a host needs 32 open files, 5 are"),
        (6, ("eval", "walker", "roller", "--jobs", "2"), "too many open files: allow more"),
    ],
)
def test_few_descriptors_are_told_in_words(limit: int, arguments: tuple[str, ...], words: str) -> None:
    # Python itself cannot start with fewer than 5: three are its standard streams, two are for importing.
    command = ["sh", "-c", f'ulimit -n {limit}; exec "$0" "$@"', NMES, *arguments]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert ended.returncode == 1 and words in ended.stdout + ended.stderr
    assert "Traceback" not in ended.stderr and "never awaited" not in ended.stderr


@pytest.mark.parametrize("imported", ["click", "jsonschema_rs"])
def test_ctrl_c_during_an_import_is_told_in_a_word(imported: str, tmp_path: Path) -> None:
    (tmp_path / f"{imported}.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n")
    with process("eval", "walker", PYTHONPATH=str(tmp_path)) as running:
        _, told = running.communicate(timeout=PATIENCE)
    assert running.returncode == 1 and told.strip() == "Aborted!"


# -- nmes serve -------------------------------------------------------------------------------------------------------


_DROPPING = """
import signal, sys

class Finder:
    @staticmethod
    def find_spec(name, *_):
        if name == "nmes.evaluation":
            try:
                signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt:
                pass

sys.meta_path.insert(0, Finder)
"""


def test_ctrl_c_that_a_module_drops_as_it_is_loaded_ends_a_command(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(_DROPPING)
    with process("eval", "walker", "--task", "walk", PYTHONPATH=str(tmp_path)) as running:
        _, told = running.communicate(timeout=PATIENCE)
    assert (running.returncode, told) == (1, "stopped: 0 of 1 done\n")


def test_ctrl_c_that_a_library_drops_ends_an_evaluation_before_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # where an evaluation keeps what it has done

    @contextmanager
    def dropped(*_: signal.Signals) -> Iterator[Callable[[], bool]]:
        yield lambda: True

    monkeypatch.setattr("nmes.cli._eval_jobs.interruptions", dropped)
    result = CliRunner().invoke(main, ["eval", "walker", "--task", "walk"])
    assert result.exit_code == 1 and "stopped: 0 of 1 done" in result.stderr


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_everything_properly(tmp_path: Path, number: int) -> None:
    options = ["--json", "--port", "0", "--backend", "ballistic", "--mode", "fast", "--seed", "7", "--record"]
    with process("serve", *options, str(tmp_path), NMES_PASSWORD="secret in the environment") as server:
        message = ready(server)
        port = message.pop("port")
        recording = Path(message.pop("recording"))
        assert message == {
            "host": "127.0.0.1",
            "password_source": "environment",
            "world": "main",
            "backend": "ballistic",
            "mode": "fast",
            "rate": 1.0,
            "seed": 7,
        }
        with Client(port=port, password="secret in the environment", timeout=PATIENCE) as client:
            client.spawn_cube("a")
            client.subscribe(events=["tick"], every=1_000_000)
            server.send_signal(number)
            assert [event["type"] for event in client.events() if event["type"] != "tick"] == ["world_closed"]
        out, log = server.communicate(timeout=PATIENCE)
        assert server.returncode == 0, log
        assert "secret" not in out + log
    assert recording.parent == tmp_path
    assert Recording(recording).complete
    assert sum(record.kind is Kind.COMMAND for record in Recording(recording)) == 2
    assert b"secret" not in recording.read_bytes()


def test_serve_prints_its_state_for_people(tmp_path: Path) -> None:
    with process("serve", "--port", "0", "--backend", "ballistic", "--record", str(tmp_path)) as server:
        assert server.stdout is not None
        lines = [server.stdout.readline() for _ in range(6)]
        text = "".join(lines)
        assert re.match(r"World 'main': ballistic \S+, realtime x 1, seed 0\nListening on 127\.0\.0\.1:\d+\n", text)
        password = re.search(r"^Password: (\S+)  \(made up for this run\)$", text, flags=re.MULTILINE)
        port = re.search(r":(\d+)$", lines[1])
        assert password and port
        assert f"Recording to {tmp_path}/main-" in text
        with Client(port=int(port[1]), password=password[1], timeout=PATIENCE) as client:
            assert client.ping()
        server.terminate()
        out, log = server.communicate(timeout=PATIENCE)
        assert re.fullmatch(r"Stopped at frame \d+\n", out)
        assert server.returncode == 0, log


def test_options_win_over_the_config_file(tmp_path: Path) -> None:
    (tmp_path / "world.json").write_text('{"name": "arena", "backend": "ballistic", "seed": 3, "tick_rate": 100}')
    (tmp_path / "password").write_text("secret of a file\nsecond line\n")
    options = ["--config", str(tmp_path / "world.json"), "--password-file", str(tmp_path / "password")]
    with process("serve", "--json", "--port", "0", "--no-record", "--seed", "4", *options) as server:
        message = ready(server)
        assert message["recording"] is None
        assert message["password_source"] == "file"
        assert "password" not in message
        with Client(port=message["port"], password="secret of a file", world="arena", timeout=PATIENCE) as client:
            config = client.get_world_info()["config"]
        assert (config["name"], config["seed"], config["tick_rate"]) == ("arena", 4, 100)
        server.terminate()
        assert server.wait(PATIENCE) == 0


def test_a_landscape_s_image_comes_from_beside_the_config(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    Image.linear_gradient("L").save(tmp_path / "below" / "hills.png")
    scene = {"type": "heightfield", "heightfield": {"image_file": "hills.png"}}
    (tmp_path / "below" / "world.json").write_text(json.dumps({"scene": scene, "mode": "lockstep"}))
    options = ["--config", str(tmp_path / "below" / "world.json"), "--password", "p", "--record", str(tmp_path)]
    with process("serve", "--json", "--port", "0", *options) as server:
        message = ready(server)
        server.terminate()
        assert server.wait(PATIENCE) == 0
    image = Recording(Path(message["recording"])).config["scene"]["heightfield"]["image"]
    assert base64.b64decode(image) == (tmp_path / "below" / "hills.png").read_bytes()


@pytest.mark.parametrize(
    ("options", "config", "says"),
    [
        (["--host", "0.0.0.0"], None, "0.0.0.0 can be reached from elsewhere: give a password"),
        (["--host", "example.org"], None, "give a password"),
        (["--password", ""], None, "is empty"),
        (["--password", "a", "--password-file", "world.json"], "{}", "not both"),
        (["--password-file", "nowhere"], None, "nowhere"),
        (["--mode", "slow"], None, "slow"),
        (["--rate", "0"], None, "rate"),
        (["--port", "65536"], None, "65536"),
        (["--config", "nowhere.json"], None, "nowhere.json"),
        (["--config", "world.json"], "{", "world.json: "),
        (["--config", "world.json"], "[]", "a world config is a JSON object"),
        (["--config", "world.json"], "[" * 10_000, "world.json: not strict JSON"),
        (["--config", "world.json"], '{"seed": 1, "seed": 2}', "duplicate key"),
        (["--config", "world.json"], '{"substeps": 0}', "substeps: "),
        (["--config", "world.json"], '{"limits": {"cubes": "many"}}', "limits/cubes: "),
        (["--config", "world.json"], '{"gravitiy": [0, 0, 0]}', "gravitiy: "),
        (["--config", "world.json"], '{"scene": {"type": "heightfield"}}', "ballistic backend has no scenery"),
        (
            ["--config", "world.json"],
            '{"scene": {"type": "heightfield", "heightfield": {"image_file": "nowhere.png"}}}',
            "scene/heightfield/image_file: ",
        ),
    ],
)
def test_wrong_usage_exits_2_and_names_what_is_wrong(
    options: list[str], config: str | None, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if config is not None:
        Path("world.json").write_text(config)
    result = run("serve", "--no-record", "--port", "0", "--backend", "ballistic", *options)
    assert result.exit_code == 2, result.output
    assert says in result.output
    assert result.exception is None or isinstance(result.exception, SystemExit)


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (("view", "FILE", "--web", "--world", "x"), "--world"),
        (("view", "FILE", "FILE", "--save", "x.rrd", "--tls"), "--tls"),
        (("view", "FILE", "--password", "x"), "--password"),
        (("view", "FILE", "--save", "x.rrd", "--port", "0"), "--port"),
        (("view", "127.0.0.1:1", "--password", "x", "--port", "9000"), "--port"),
        (("view", "FILE", "--save", "x.rrd", "--host", "127.0.0.1"), "--host"),
        (("serve", "--port", "0", "--record", "x", "--no-record"), "--record"),
        (("serve", "--port", "0", "--metrics-host", "127.0.0.1"), "--metrics-host"),
    ],
)
def test_an_option_that_would_do_nothing_is_wrong_usage(
    arguments: tuple[str, ...], option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    recording = str(ROOT / "replays" / "mujoco-clients.mcap")
    result = run(*(recording if word == "FILE" else word for word in arguments))
    assert result.exit_code == 2 and option in result.stderr.splitlines()[-1], result.output
    assert not [*tmp_path.iterdir()]


def test_an_unreadable_password_file_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "password").write_bytes(b"\xff")
    result = run("serve", "--no-record", "--password-file", str(tmp_path / "password"))
    assert result.exit_code == 2
    (tmp_path / "password").write_bytes(b"")
    assert run("serve", "--no-record", "--password-file", str(tmp_path / "password")).exit_code == 2


def test_failures_exit_1_with_one_line(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = str(listener.getsockname()[1])
        result = run("serve", "--no-record", "--backend", "ballistic", "--port", port)
    assert result.exit_code == 1
    assert re.fullmatch(rf"Error: cannot listen on 127\.0\.0\.1:{port}: .+\n", result.output)
    result = run("serve", "--no-record", "--backend", "mojoco")
    assert result.exit_code == 1
    assert result.output.startswith("Error: ") and "did you mean 'mujoco'" in result.output
    (tmp_path / "file").touch()
    result = run("serve", "--backend", "ballistic", "--port", "0", "--record", str(tmp_path / "file" / "below"))
    assert result.exit_code == 1
    assert result.output.startswith("Error: cannot make ")


# -- progress ---------------------------------------------------------------------------------------------------------


QUIET = {
    "corpus",
    "eval",
    "evolve",
    "info",
    "learn",
    "leaderboard",
    "play",
    "render",
    "replay",
    "study",
    "survey",
    "tournament",
    "view",
}


@with_opengl
def test_a_terminal_is_shown_progress_unless_it_is_to_be_quiet(tmp_path: Path) -> None:
    recording = record(tmp_path / "run.mcap", busy)
    for options, shown in ([], True), (["--quiet"], False), (["-q"], False):
        output = str(tmp_path / "last.gif")
        result = run("render", str(recording), "-o", output, "--size", "64x48", *options, FORCE_COLOR="1")
        assert result.exit_code == 0, result.output
        assert bool(result.stderr) == shown, result.stderr
        assert result.stdout == f"wrote {output}\n"


def test_every_command_that_shows_progress_can_be_quiet() -> None:
    sources = {path.stem: path.read_text() for path in (ROOT / "cli").glob("*.py")}
    showing = {name for name, text in sources.items() if "progress_bars" in text} - {"_progress"}
    named = {name for name in SUBCOMMANDS if any("--quiet" in parameter.opts for parameter in parameters(name))}
    assert named == QUIET
    assert {name for name in showing if not name.startswith("_")} <= named


def parameters(name: str) -> list[click.Parameter]:
    command = main.get_command(click.Context(main), name)
    assert command is not None
    return [*command.params, *(each for part in commands_in(command) for each in part.params)]


def commands_in(command: click.Command) -> list[click.Command]:
    return list(commands(command)) if isinstance(command, click.Group) else []


@pytest.mark.parametrize("command", ["evolve", "learn"])
def test_a_command_that_begins_runs_is_called_in_errors_as_one_types_it(command: str) -> None:
    result = CliRunner().invoke(main, [command, "--no-such-option"], prog_name="nmes")
    assert result.exit_code == 2
    assert f"Usage: nmes {command} [OPTIONS] WHAT" in result.output and f"'nmes {command} --help'" in result.output
