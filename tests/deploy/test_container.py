"""The files of which images are made, read as their builder reads them: none is at hand where tests run."""

from __future__ import annotations

import fnmatch
import json
import re
from typing import NamedTuple

import pytest

from layout import ROOT

DEPLOY = ROOT / "deploy"
INSTRUCTIONS = {
    *("ARG", "FROM", "COPY", "RUN", "ENV", "USER", "WORKDIR", "VOLUME", "EXPOSE", "STOPSIGNAL", "HEALTHCHECK"),
    *("ENTRYPOINT", "CMD"),
}


class Stage(NamedTuple):
    base: str
    name: str | None
    instructions: list[tuple[str, str]]

    def last(self, instruction: str) -> str:
        return [value for each, value in self.instructions if each == instruction][-1]


def parse(text: str) -> list[Stage]:
    """Returns the stages of a Containerfile; raises a ValueError for what is none."""
    arguments: dict[str, str] = {}
    stages: list[Stage] = []
    joined = re.sub(r"\\\n", " ", re.sub(r"^\s*#.*\n", "", text, flags=re.MULTILINE))
    for line in filter(str.strip, joined.splitlines()):
        instruction, _, value = line.strip().partition(" ")
        if instruction not in INSTRUCTIONS or not value.strip():
            raise ValueError(f"no instruction: {line}")
        value = re.sub(r" +", " ", value.strip())
        if instruction == "FROM":
            base = re.sub(r"\$\{(\w+)\}", lambda match: arguments[match[1]], value)
            match = re.fullmatch(r"(\S+)(?: AS (\w+))?", base)
            if match is None:
                raise ValueError(f"no base: {line}")
            stages.append(Stage(match[1], match[2], []))
        elif not stages:
            if instruction != "ARG":
                raise ValueError(f"before the first FROM: {line}")
            key, _, default = value.partition("=")
            arguments[key] = default
        else:
            if source := re.match(r"--from=(\S+)", value):
                if source[1] not in [stage.name for stage in stages[:-1]]:
                    raise ValueError(f"no such stage: {line}")
            stages[-1].instructions.append((instruction, value))
    return stages


@pytest.mark.parametrize(
    "text",
    [
        "FORM python:3.11\n",
        "RUN true\nFROM python:3.11\n",
        "FROM python:3.11 AS a\nCOPY --from=b /x /x\n",
        "FROM python:3.11 as a b\n",
        "FROM python:3.11\nUSER\n",
    ],
)
def test_a_file_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        parse(text)


def test_the_host_is_built_in_one_stage_and_runs_in_another() -> None:
    build, host = parse((DEPLOY / "Containerfile").read_text())
    assert build.base == host.base and re.fullmatch(r"python:3\.11\.\d+-slim-\w+", host.base)  # as tested in CI
    copied = [value for instruction, value in host.instructions if instruction == "COPY"]
    assert copied == ["--from=build /opt/nmes /opt/nmes"]  # no source, and nothing that builds
    installs = [value for instruction, value in build.instructions if instruction == "RUN"]
    assert len(installs) == 1 and "--constraint /source/constraints.txt" in installs[0]


def test_the_host_is_nobody_in_particular_and_ends_by_sigterm() -> None:
    _, host = parse((DEPLOY / "Containerfile").read_text())
    user, group = host.last("USER").split(":")
    assert int(user) > 0 and int(group) > 0
    assert json.loads(host.last("ENTRYPOINT")) == ["nmes"]  # no shell between, which would keep signals to itself
    assert host.last("STOPSIGNAL") == "SIGTERM"
    command = json.loads(host.last("CMD"))
    assert float(command[command.index("--drain") + 1]) > 0
    assert host.last("EXPOSE").split() == ["14000", command[command.index("--metrics-port") + 1]]
    assert f":{command[command.index('--metrics-port') + 1]}/health" in host.last("HEALTHCHECK")
    assert host.last("VOLUME") == command[command.index("--record") + 1]
    health = re.search(r"CMD (\[.*\])$", host.last("HEALTHCHECK"))
    assert health is not None
    compile(json.loads(health[1])[2], "HEALTHCHECK", "exec")


def test_nodes_of_ray_have_the_ray_that_was_tested() -> None:
    (stage,) = parse((DEPLOY / "ray" / "Containerfile").read_text())
    pinned = re.search(r"^ray==(\S+)", (ROOT / "constraints.txt").read_text(), re.MULTILINE)
    assert pinned is not None and stage.base == f"rayproject/ray:{pinned[1]}-py311"
    assert stage.last("USER") == "ray"
    assert "--constraint" in stage.last("RUN")


def test_no_file_names_an_architecture_in_what_it_runs() -> None:
    for file in ("Containerfile", "ray/Containerfile"):
        for stage in parse((DEPLOY / file).read_text()):
            assert not re.search(r"amd64|x86|arm64|aarch64", str(stage))


def test_what_is_sent_to_the_builder_is_what_it_needs() -> None:
    lines = (ROOT / ".dockerignore").read_text().splitlines()
    assert lines[0] == "*"
    sent = {line.removeprefix("!") for line in lines if line.startswith("!")}
    assert {"backends", "cli", "nmes", "schemas", "pyproject.toml", "setup.py", "constraints.txt", "README.md"} <= sent
    assert all((ROOT / each).exists() for each in sent)
    assert not any(fnmatch.fnmatch(each, "*secret*") or each in (".git", "tests", "deploy") for each in sent)
