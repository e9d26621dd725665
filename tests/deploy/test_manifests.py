"""What deploy/ tells Kubernetes, Agones, KubeRay and Compose: judged by schemas, without any of them."""

from __future__ import annotations

import copy
import json
import re
import shlex
import stat
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jsonschema
import kubernetes_validate
import pytest
import yaml
from click.testing import CliRunner
from kubernetes_validate.utils import schema_contents
from referencing import Registry, Resource

from layout import ROOT
from nmes.cli import main

DEPLOY = ROOT / "deploy"
SCHEMAS = Path(__file__).parent / "schemas"
VERSIONS = kubernetes_validate.utils.all_versions()  # of Kubernetes: all that the validator knows
MANIFESTS = [
    path
    for folder in ("kubernetes", "agones", "ray")
    for path in sorted((DEPLOY / folder).glob("*.yaml"))
    if path.name != "kustomization.yaml"
]
OWN = {
    "agones.dev": "agones",
    "autoscaling.agones.dev": "agones",
    "allocation.agones.dev": "agones",
    "ray.io": "kuberay",
}


def read(path: Path) -> Any:
    return yaml.safe_load(path.read_text())


def judge(schema: str, document: Any, version: str = VERSIONS[-1]) -> None:
    """Raises a ValidationError for a document that a schema of ours refuses; pods are judged by those of Kubernetes."""
    definitions = schema_contents(f"kubernetes-json-schema/v{version}-local-strict/_definitions.json", version)
    registry: Any = Resource.from_contents(definitions) @ Registry()
    contents = json.loads((SCHEMAS / f"{schema}.json").read_text())
    validator = jsonschema.Draft202012Validator(contents, registry=registry)
    validator.check_schema(contents)
    error = jsonschema.exceptions.best_match(validator.iter_errors(document))
    if error is not None:
        raise error


def judge_manifest(document: Any, version: str = VERSIONS[-1]) -> None:
    """Raises a ValidationError for a resource of any kind that cannot be used."""
    group = document["apiVersion"].partition("/")[0]
    if group in OWN:
        judge(OWN[group], document, version)
    else:
        kubernetes_validate.validate(document, version, strict=True)


def pods(document: Any) -> Iterator[Mapping[str, Any]]:
    """Yields the specs of all pods in a document."""
    if isinstance(document, dict):
        if "containers" in document:
            yield document
        for value in document.values():
            yield from pods(value)
    elif isinstance(document, list):
        for value in document:
            yield from pods(value)


def places(document: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Yields the place of every object in a document, but for those whose names are anybody's choice."""
    free = {"labels", "annotations", "matchLabels", "rayStartParams", "requests", "limits", "counters", "environment"}
    free |= {"services", "secrets", "volumes", "depends_on"} if path == () else set()
    if isinstance(document, dict):
        if not (path and path[-1] in free):
            yield path
        for key, value in document.items():
            yield from places(value, (*path, key))
    elif isinstance(document, list):
        for index, value in enumerate(document):
            yield from places(value, (*path, index))


def planted(document: Any, place: tuple[str | int, ...]) -> Any:
    """Returns a document with a field that nothing knows."""
    changed = copy.deepcopy(document)
    at = changed
    for step in place:
        at = at[step]
    at["replicsa"] = 1
    return changed


def name(path: Path) -> str:
    return str(path.relative_to(DEPLOY))


@pytest.mark.parametrize("version", [VERSIONS[0], VERSIONS[-1]])
@pytest.mark.parametrize("path", MANIFESTS, ids=name)
def test_a_manifest_is_valid(path: Path, version: str) -> None:
    judge_manifest(read(path), version)


@pytest.mark.parametrize("path", MANIFESTS, ids=name)
def test_a_field_that_nothing_knows_is_refused_wherever_it_stands(path: Path) -> None:
    document = read(path)
    for place in list(places(document))[::3]:  # some of them, for each takes a while
        with pytest.raises(jsonschema.ValidationError):
            judge_manifest(planted(document, place))


@pytest.mark.parametrize(
    ("path", "place", "value"),
    [
        ("agones/fleet.yaml", "spec/template/spec/ports/0/portPolicy", "Dynamc"),
        ("agones/fleet.yaml", "spec/template/spec/ports/0/containerPort", "14000"),
        ("agones/fleet.yaml", "spec/template/spec/counters/rooms/capacity", -1),
        ("agones/fleet.yaml", "spec/template/spec/template/spec/containers/0/args", "serve"),
        ("agones/fleetautoscaler.yaml", "spec/policy/type", "Buffer"),
        ("agones/gameserverallocation.yaml", "spec/selectors/0/gameServerState", "Asleep"),
        ("ray/raycluster.yaml", "spec/headGroupSpec/rayStartParams/num-cpus", 0),
        ("ray/rayjob.yaml", "spec/submissionMode", "ByMail"),
        ("ray/rayjob.yaml", "spec/rayClusterSpec/workerGroupSpecs/0/template/spec/containers/0/name", 4),
        ("kubernetes/statefulset.yaml", "spec/replicas", "one"),
        ("kubernetes/poddisruptionbudget.yaml", "spec/selector/matchLabels", ["nmes"]),
    ],
)
def test_a_wrong_value_is_refused(path: str, place: str, value: Any) -> None:
    document = at = read(DEPLOY / path)
    *way, last = place.split("/")
    for step in way:
        at = at[int(step)] if isinstance(at, list) else at[step]
    assert last in at
    at[last] = value
    with pytest.raises(jsonschema.ValidationError):
        judge_manifest(document)


def test_compose_and_kustomize_are_valid_and_refuse_what_nothing_knows() -> None:
    for schema, path in (("compose", "compose/compose.yaml"), ("kustomization", "kubernetes/kustomization.yaml")):
        document = read(DEPLOY / path)
        judge(schema, document)
        for place in places(document):
            with pytest.raises(jsonschema.ValidationError):
                judge(schema, planted(document, place))


def test_what_is_named_is_there() -> None:
    folder = DEPLOY / "kubernetes"
    kustomization = read(folder / "kustomization.yaml")
    assert sorted([*kustomization["resources"], "kustomization.yaml"]) == sorted(each.name for each in folder.iterdir())
    image = {each["image"] for pod in pods(read(folder / "statefulset.yaml")) for each in pod["containers"]}
    assert image == {each["name"] for each in kustomization["images"]}
    compose = read(DEPLOY / "compose" / "compose.yaml")
    for service in compose["services"].values():
        for volume in service.get("volumes", []):
            source = volume.split(":")[0]
            assert (DEPLOY / "compose" / source).is_file() if source.startswith("./") else source in compose["volumes"]
        assert set(service.get("secrets", [])) <= set(compose["secrets"])
        if "build" in service:
            context = DEPLOY / "compose" / service["build"]["context"]
            assert (context / service["build"]["dockerfile"]).resolve() == DEPLOY / "Containerfile"
    assert not (DEPLOY / "compose" / compose["secrets"]["password"]["file"]).exists()  # no password in the tree


def test_the_password_of_the_compose_recipe_is_read_in_the_container_and_by_nobody_else_here(tmp_path: Path) -> None:
    recipe = DEPLOY / "compose" / "compose.yaml"
    (command,) = (line.lstrip("# ") for line in recipe.read_text().splitlines() if "/dev/urandom" in line)
    assert f"$ {command}" in (ROOT / "docs" / "deploying.md").read_text().splitlines()
    subprocess.run(["sh", "-euc", command], cwd=tmp_path, check=True)
    password = tmp_path / read(recipe)["secrets"]["password"]["file"]
    assert len(password.read_text().strip()) == 24
    assert stat.S_IMODE(password.stat().st_mode) == 0o444  # Compose binds the file, with its owner and mode
    assert stat.S_IMODE(password.parent.stat().st_mode) == 0o700 and password.parent != tmp_path


@pytest.mark.parametrize("path", MANIFESTS, ids=name)
def test_pods_run_as_nobody_in_particular(path: Path) -> None:
    for pod in pods(read(path)):
        assert pod["securityContext"]["runAsNonRoot"] is True and pod["securityContext"]["runAsUser"] > 0
        assert pod["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
        for container in pod["containers"]:
            assert container["securityContext"]["allowPrivilegeEscalation"] is False
            assert container["securityContext"]["capabilities"] == {"drop": ["ALL"]}
            assert {"requests", "limits"} <= container["resources"].keys()
            mounts = {each["name"] for each in container.get("volumeMounts", [])}
            claims = {each["metadata"]["name"] for each in read(path)["spec"].get("volumeClaimTemplates", [])}
            assert mounts == {each["name"] for each in pod.get("volumes", [])} | claims


# -- what they say to nmes -------------------------------------------------------------------------------------------


def commands() -> list[list[str]]:
    """Returns the arguments that nmes is given by all of deploy/."""
    found: list[list[str]] = []
    for path in MANIFESTS:
        document = read(path)
        found += [each["args"] for pod in pods(document) for each in pod["containers"] if "args" in each]
        if entrypoint := document["spec"].get("entrypoint"):
            program, *arguments = shlex.split(entrypoint)
            assert program == "nmes"
            found.append(arguments)
    found.append(read(DEPLOY / "compose" / "compose.yaml")["services"]["nmes"]["command"])
    (built,) = re.findall(r"^CMD (\[.*\])$", (DEPLOY / "Containerfile").read_text(), re.MULTILINE)
    found.append(json.loads(built))
    return found


def option(arguments: list[str], wanted: str) -> str | None:
    """Returns the value of an option, given as one argument or as two."""
    for index, argument in enumerate(arguments):
        if argument == wanted:
            return arguments[index + 1]
        if argument.startswith(f"{wanted}="):
            return argument.partition("=")[2]
    return None


def test_every_command_is_one_that_nmes_has() -> None:
    assert len(commands()) == 5
    for subcommand, *arguments in commands():
        result = CliRunner().invoke(main, [subcommand, *arguments, "--help"])
        assert result.exit_code == 0 and result.output.startswith("Usage:"), result.output
        for argument in arguments:
            if argument.startswith("--"):
                assert re.search(rf"^ +(-\w, )?{re.escape(argument.partition('=')[0])}\b", result.output, re.MULTILINE)


def test_the_run_of_the_ray_job_is_one_that_can_be_made(tmp_path: Path) -> None:
    program, *arguments = shlex.split(read(DEPLOY / "ray" / "rayjob.yaml")["spec"]["entrypoint"])
    assert program == "nmes" and option(arguments, "--ray") == "auto" and option(arguments, "-o")
    smaller = {"--ray": ["--jobs", "1"], "--budget": ["--budget", "1"], "-o": ["-o", str(tmp_path / "run")]}
    for name, instead in smaller.items():
        arguments[(at := arguments.index(name)) : at + 2] = instead
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output


def test_ports_probes_and_graces_are_those_of_the_command() -> None:
    (pod,) = pods(read(DEPLOY / "kubernetes" / "statefulset.yaml"))
    (container,) = pod["containers"]
    ports = {each["name"]: each["containerPort"] for each in container["ports"]}
    assert ports == {"worlds": 14000, "metrics": int(option(container["args"], "--metrics-port") or 0)}
    service = read(DEPLOY / "kubernetes" / "service.yaml")
    assert {each["name"]: each["port"] for each in service["spec"]["ports"]} == ports
    probes = {kind: container[f"{kind}Probe"]["httpGet"] for kind in ("startup", "liveness", "readiness")}
    assert {kind: probe["path"] for kind, probe in probes.items()} == {
        "startup": "/health",
        "liveness": "/health",
        "readiness": "/ready",
    }
    assert {probe["port"] for probe in probes.values()} == {"metrics"}
    assert pod["terminationGracePeriodSeconds"] > float(option(container["args"], "--drain") or 0) + 5
    (game_server,) = pods(read(DEPLOY / "agones" / "fleet.yaml"))
    assert game_server["terminationGracePeriodSeconds"] > float(
        option(game_server["containers"][0]["args"], "--drain") or 0
    )
    compose = read(DEPLOY / "compose" / "compose.yaml")["services"]["nmes"]
    grace = int(compose["stop_grace_period"].removesuffix("s"))
    assert grace > float(option(compose["command"], "--drain") or 0) + 5


def test_the_counter_of_rooms_is_the_same_everywhere() -> None:
    fleet = read(DEPLOY / "agones" / "fleet.yaml")["spec"]
    (pod,) = pods(fleet)
    arguments = pod["containers"][0]["args"]
    assert "--agones" in arguments
    spec = fleet["template"]["spec"]
    assert spec["counters"] == {"rooms": {"count": 0, "capacity": int(option(arguments, "--max-worlds") or 0)}}
    scaler = read(DEPLOY / "agones" / "fleetautoscaler.yaml")["spec"]
    allocation = read(DEPLOY / "agones" / "gameserverallocation.yaml")["spec"]
    assert scaler["policy"]["counter"]["key"] == allocation["priorities"][0]["key"] == "rooms"
    assert list(allocation["counters"]) == ["rooms"]
    assert [list(each["counters"]) for each in allocation["selectors"]] == [["rooms"], ["rooms"]]
    assert scaler["fleetName"] == "nmes" == read(DEPLOY / "agones" / "fleet.yaml")["metadata"]["name"]
    assert scaler["policy"]["counter"]["minCapacity"] == fleet["replicas"] * spec["counters"]["rooms"]["capacity"]


def test_both_ray_manifests_have_the_same_cluster() -> None:
    cluster, job = read(DEPLOY / "ray" / "raycluster.yaml"), read(DEPLOY / "ray" / "rayjob.yaml")
    assert cluster["spec"] == job["spec"]["rayClusterSpec"]
    pinned = re.search(r"^ray==(\S+)", (ROOT / "constraints.txt").read_text(), re.MULTILINE)
    assert pinned is not None and cluster["spec"]["rayVersion"] == pinned[1]
    claim = read(DEPLOY / "ray" / "runs.yaml")["metadata"]["name"]
    (volume,) = cluster["spec"]["headGroupSpec"]["template"]["spec"]["volumes"]
    assert volume["persistentVolumeClaim"]["claimName"] == claim
