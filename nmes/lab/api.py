"""What the pages of a lab ask over HTTP: which question goes to what of the lab, and how its answer is written.

Invariants: what is sent is bounded before it is read; an error that is somebody's doing is JSON with a code; whatever
starts a command answers with its command line.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Awaitable, Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Route

from nmes.backend.registry import entry_points_by_name
from nmes.errors import DocumentError, NmesError
from nmes.evaluation.leaderboard import Leaderboard
from nmes.evaluation.match_task import MatchTask, load_task
from nmes.evaluation.task import Task
from nmes.evolution.algorithms import ALGORITHMS
from nmes.genome import Genome
from nmes.lab.folder import Folder, LabError
from nmes.lab.genomes import checked, mutated
from nmes.lab.lab import KEYFRAMES, Lab
from nmes.lab.recordings import about_recording
from nmes.lab.runs import (
    about_run,
    begin_command,
    candidate,
    genome_source,
    resume_command,
    table_command,
    task_source,
)
from nmes.lab.staging import stage
from nmes.learning.learners.q_table import read_q_table
from nmes.recording import Recording
from nmes.schemas.documents import JsonObject, parse_document, write_json

__all__ = ["ROUTES", "routes"]

_BODY: Final = 8 << 20  # bytes of a request
_FILM: Final = 8.0  # s of an episode that are filmed
_ENTRIES: Final = 500  # of a leaderboard that are told at once

Answer = Callable[[Request], Awaitable[Any]]


ROUTES: Final = {
    ("GET", "/api/state"): "state",
    ("GET", "/api/genomes"): "genomes",
    ("POST", "/api/genomes/check"): "check_genome",
    ("POST", "/api/genomes/mutate"): "mutate_genome",
    ("GET", "/api/genomes/{name}"): "genome",
    ("PUT", "/api/genomes/{name}"): "put_genome",
    ("DELETE", "/api/genomes/{name}"): "delete_genome",
    ("GET", "/api/tasks"): "tasks",
    ("GET", "/api/runs"): "runs",
    ("POST", "/api/runs"): "begin_run",
    ("GET", "/api/runs/{name}"): "run",
    ("POST", "/api/runs/{name}/pause"): "pause_run",
    ("POST", "/api/runs/{name}/resume"): "resume_run",
    ("GET", "/api/runs/{name}/candidates/{number}/genome"): "candidate",
    ("POST", "/api/runs/{name}/candidates/{number}/world"): "stage",
    ("GET", "/api/tables"): "tables",
    ("POST", "/api/tables"): "learn_table",
    ("GET", "/api/tables/{name}"): "table",
    ("GET", "/api/recordings"): "recordings",
    ("GET", "/api/recordings/{name}"): "recording",
    ("GET", "/api/recordings/{name}/file"): "recording_file",
    ("POST", "/api/recordings/{name}/replay"): "replay",
    ("POST", "/api/recordings/{name}/diff"): "diff",
    ("POST", "/api/recordings/{name}/fork"): "fork",
    ("POST", "/api/scores"): "score",
    ("GET", "/api/leaderboards"): "leaderboards",
    ("GET", "/api/leaderboards/{name}"): "leaderboard",
    ("POST", "/api/leaderboards/{name}/verify"): "verify",
    ("POST", "/api/leaderboards/{name}/film"): "film",
    ("GET", "/api/films/{name}/file"): "film_file",
    ("GET", "/api/jobs"): "jobs",
    ("GET", "/api/jobs/{id}"): "job",
    ("POST", "/api/jobs/{id}/stop"): "stop_job",
}
"""What answers which question: a method of one of the classes below."""


def routes(lab: Lab) -> list[Route]:
    """Returns the routes of a lab's API."""
    parts = [part(lab) for part in (_Documents, _Runs, _Recordings, _Leaderboards)]
    answers = {name: getattr(part, name) for part in parts for name in dir(part) if not name.startswith("_")}
    return [Route(path, _written(answers[name]), methods=[method]) for (method, path), name in ROUTES.items()]


def _written(answer: Answer) -> Callable[[Request], Awaitable[Response]]:
    """Writes an answer, or what was wrong, as JSON."""

    async def write(request: Request) -> Response:
        try:
            result = await answer(request)
        except LabError as error:
            return _json({"error": _told(error)}, error.status)
        except DocumentError as error:
            problems = [{"path": path, "message": message} for path, message in error.problems]
            return _json({"error": {**_told(error), "problems": problems}}, 422)
        except NmesError as error:
            return _json({"error": _told(error)}, 409)
        return result if isinstance(result, Response) else _json(result)

    return write


def _told(error: NmesError) -> JsonObject:
    return {"code": error.code, "message": error.message, "path": error.path}


def _json(value: Any, status: int = 200) -> Response:
    return Response(write_json(value), status, media_type="application/json")


async def _body(request: Request) -> bytes:
    """Reads what was sent.

    Raises:
        LabError: It is too long.
    """
    data = bytearray()
    async for part in request.stream():
        data += part
        if len(data) > _BODY:
            raise LabError("request_too_large", f"a request has at most {_BODY:,} bytes")
    return bytes(data)


def _number(request: Request) -> int:
    """Returns the number of a job in a path; -1, which none has, where there is no number."""
    text = request.path_params["id"]
    return int(text) if re.fullmatch(r"[0-9]{1,12}", text) else -1


async def _object(request: Request) -> JsonObject:
    """Reads a JSON object that was sent; an empty one where nothing was."""
    text = await _body(request)
    value = parse_document(text) if text.strip() else {}
    if not isinstance(value, dict):
        raise LabError("invalid", "what is sent is a JSON object")
    return value


class _Answers:
    """What all answers are made with."""

    def __init__(self, lab: Lab) -> None:
        self._lab = lab
        self._folder: Folder = lab.folder

    async def _page(self, kind: Any, request: Request) -> JsonObject:
        query = request.query_params
        return await self._lab.index.page(kind, query.get("after"), query.get("name", ""))

    async def _start(self, command: list[str], about: str = "") -> JsonObject:
        return (await self._lab.jobs.start(command, about)).to_json()


class _Documents(_Answers):
    """What the lab is, its genomes and tasks, and the commands that it has started."""

    async def state(self, _: Request) -> JsonObject:
        lab = self._lab
        return {
            "version": version("nmes"),
            "port": lab.port,
            "folder": str(self._folder.path),
            "backends": sorted(entry_points_by_name()),
            "templates": lab.templates,
            "algorithms": {"evolve": list(ALGORITHMS), "learn": ["ppo", "reinforce", "clone"]},
        }

    async def genomes(self, _: Request) -> JsonObject:
        own = [{"name": name, "ships": False} for name in self._folder.names("genomes")]
        names = {each["name"] for each in own}
        ships = [{"name": name, "ships": True} for name in Genome.names() if name not in names]
        return {"items": [*own, *ships], "next": None}

    async def genome(self, request: Request) -> JsonObject:
        name = request.path_params["name"]
        if name in Genome.names() and name not in self._folder.scan("genomes"):
            return Genome.load(name).document
        path = self._folder.find("genomes", name)
        document = parse_document(path.read_bytes())
        return document if isinstance(document, dict) else {}

    async def put_genome(self, request: Request) -> JsonObject:
        name, text = request.path_params["name"], await _body(request)
        self._folder.place("genomes", name)
        if name in Genome.names():
            reason = f"a genome called {name!r} ships with NMES: choose another name"
            raise LabError("name_taken", reason, "name")
        genome = await self._lab.do(Genome.parse, text)
        path = self._folder.write("genomes", name, text)
        return {"name": name, "hash": genome.hash, "command": shlex.join(["nmes", "genome", "check", str(path)])}

    async def delete_genome(self, request: Request) -> JsonObject:
        path = self._folder.find("genomes", request.path_params["name"])
        path.unlink()
        return {"command": shlex.join(["rm", str(path)])}

    async def check_genome(self, request: Request) -> JsonObject:
        text = await _body(request)
        return await self._lab.do(lambda: checked(parse_document(text)))

    async def mutate_genome(self, request: Request) -> JsonObject:
        asked = await _object(request)
        task = asked.get("task")
        source = None if task is None else task_source(self._folder, task)
        return await self._lab.do(mutated, asked, source)

    async def tasks(self, _: Request) -> JsonObject:
        own = self._folder.names("tasks")
        return {"items": await self._lab.do(self._all_tasks, own), "next": None}

    def _all_tasks(self, own: list[str]) -> list[JsonObject]:
        found: list[JsonObject] = []
        for name in [*Task.names(), *MatchTask.names(), *own]:
            source = str(self._folder.find("tasks", name)) if name in own else name
            try:
                task = load_task(source)
            except DocumentError as error:
                found.append({"name": name, "ships": False, "error": error.message})
                continue
            roles = list(task.roles) if isinstance(task, MatchTask) else []
            about = {"description": task.description, "unit": task.unit, "duration": task.duration, "roles": roles}
            found.append({"name": name, "ships": name not in own, **about, "seeds": list(task.seeds)})
        return found

    async def jobs(self, _: Request) -> JsonObject:
        return {"items": [job.to_json() for job in self._lab.jobs.all()[:100]], "next": None}

    async def job(self, request: Request) -> JsonObject:
        job = self._lab.jobs.get(_number(request))
        told = job.to_json()  # first: a job that ends meanwhile has no result while it still is said to run
        return {**told, "result": await self._lab.do(job.result) if told["status"] is not None else None}

    async def stop_job(self, request: Request) -> JsonObject:
        job = self._lab.jobs.get(_number(request))
        job.interrupt()
        return job.to_json()


class _Runs(_Answers):
    """Runs of evolution and learning, and scores."""

    async def runs(self, request: Request) -> JsonObject:
        page = await self._page("runs", request)
        for item in page["items"]:
            job = self._lab.jobs.of(f"run {item['name']}")
            item["job"] = None if job is None else job.id
        return page

    async def begin_run(self, request: Request) -> JsonObject:
        asked = await _object(request)
        name = asked.get("name")
        command = await self._lab.do(begin_command, self._folder, asked.get("kind"), name, asked.get("settings"))
        return await self._start(command, f"run {name}")

    async def run(self, request: Request) -> JsonObject:
        name = request.path_params["name"]
        job = self._lab.jobs.of(f"run {name}")
        about = await self._lab.do(about_run, self._folder, name)
        state = "running" if job is not None else "finished" if about["finished"] else "paused"
        return {"name": name, "state": state, "job": None if job is None else job.id, **about}

    async def pause_run(self, request: Request) -> JsonObject:
        name = request.path_params["name"]
        job = self._lab.jobs.of(f"run {name}")
        if job is None:
            raise LabError("not_running", f"{name!r} is not running, or not by this lab", "name")
        job.interrupt()
        return job.to_json()

    async def resume_run(self, request: Request) -> JsonObject:
        name, budget = request.path_params["name"], (await _object(request)).get("budget")
        return await self._start(await self._lab.do(resume_command, self._folder, name, budget), f"run {name}")

    async def candidate(self, request: Request) -> JsonObject:
        name, number = request.path_params["name"], request.path_params["number"]
        return await self._lab.do(candidate, self._folder, name, number)

    async def stage(self, request: Request) -> JsonObject:
        asked = await _object(request)
        name, number = request.path_params["name"], request.path_params["number"]
        staging = await self._lab.do(stage, self._folder, name, number, asked.get("world"), asked.get("seed"))
        await self._lab.host.create({**staging.config, **KEYFRAMES})
        told = staging._asdict()
        return {"world": told.pop("config")["name"], **told}

    async def tables(self, _: Request) -> JsonObject:
        return {"items": [{"name": name} for name in self._folder.names("tables")], "next": None}

    async def table(self, request: Request) -> JsonObject:
        path = self._folder.find("tables", request.path_params["name"])
        return await self._lab.do(lambda: read_q_table(path.read_bytes()))

    async def learn_table(self, request: Request) -> JsonObject:
        return await self._start(table_command(self._folder, await _object(request)))

    async def score(self, request: Request) -> JsonObject:
        asked = await _object(request)
        genome = genome_source(self._folder, asked.get("genome"))
        task = task_source(self._folder, asked.get("task"))
        return await self._start(["eval", genome, "--task", task, "--json"])


class _Recordings(_Answers):
    """Recordings, and what is made of them."""

    async def recordings(self, request: Request) -> JsonObject:
        return await self._page("recordings", request)

    async def recording(self, request: Request) -> JsonObject:
        path = self._folder.find("recordings", request.path_params["name"])
        return {"name": request.path_params["name"], **await self._lab.do(about_recording, path)}

    async def recording_file(self, request: Request) -> Response:
        path = self._folder.find("recordings", request.path_params["name"])
        return FileResponse(path, media_type="application/octet-stream", filename=path.name)

    async def replay(self, request: Request) -> JsonObject:
        path = self._folder.find("recordings", request.path_params["name"])
        return await self._start(["replay", str(path), "--json"])

    async def diff(self, request: Request) -> JsonObject:
        other = (await _object(request)).get("other")
        if not isinstance(other, str):
            raise LabError("invalid", "a recording is compared with another, by its name", "other")
        paths = [self._folder.find("recordings", name) for name in (request.path_params["name"], other)]
        return await self._start(["diff", *map(str, paths), "--json"])

    async def fork(self, request: Request) -> JsonObject:
        path = self._folder.find("recordings", request.path_params["name"])
        asked = await _object(request)
        frame, world = asked.get("frame"), asked.get("world")
        if not isinstance(world, str) or not (frame is None or (type(frame) is int and 0 <= frame < 1 << 53)):
            raise LabError("invalid", "a fork has the name of its world, and may have a frame", "world")
        recording = await self._lab.do(Recording, path)
        hosted = await self._lab.host.fork(recording, frame, world)
        at = [] if frame is None else ["--at", str(frame)]
        command = shlex.join(["nmes", "serve", "--resume", str(path), *at])
        return {"world": world, "frame": hosted.status.frame, "command": command}


class _Leaderboards(_Answers):
    """Leaderboards, their proofs and films."""

    async def leaderboards(self, _: Request) -> JsonObject:
        return {"items": [{"name": name} for name in self._folder.names("leaderboards")], "next": None}

    async def leaderboard(self, request: Request) -> JsonObject:
        path = self._folder.find("leaderboards", request.path_params["name"])
        task = request.query_params.get("task")

        def read() -> JsonObject:
            with Leaderboard(path) as board:
                entries = board.entries(task=task, top=_ENTRIES, broken=True)
                units = board.units(entries)
                tasks = [{"name": name, "hash": digest} for name, digest in board.tasks()]
            items = [{**entry.to_json(), "unit": units.get(entry.task_hash, "")} for entry in entries]
            return {"name": request.path_params["name"], "tasks": tasks, "items": items[:_ENTRIES], "next": None}

        return await self._lab.do(read)

    async def verify(self, request: Request) -> JsonObject:
        path = self._folder.find("leaderboards", request.path_params["name"])
        entry = (await _object(request)).get("entry")  # all if there is none
        if entry is not None and (type(entry) is not int or entry < 1):
            raise LabError("invalid", "an entry is meant by its number", "entry")
        only = [] if entry is None else [str(entry)]
        return await self._start(["leaderboard", "verify", str(path), *only, "--json"])

    async def film(self, request: Request) -> JsonObject:
        name = request.path_params["name"]
        path, number = self._folder.find("leaderboards", name), (await _object(request)).get("entry")

        def proof() -> Path | None:
            with Leaderboard(path) as board:
                found = [entry for entry in board.entries(broken=True) if entry.id == number]
                return board.recording(found[0].recordings[0]) if found else None

        recording = await self._lab.do(proof) if type(number) is int else None
        if recording is None:
            raise LabError("not_found", f"{name!r} has no such entry", "entry")
        film = self._folder.place("films", f"{name[:150]}-{number}")
        options = ["--to", f"{_FILM:g}s", "--size", "480x360", "--fps", "15"]
        return {**await self._start(["render", str(recording), "-o", str(film), *options]), "film": film.stem}

    async def film_file(self, request: Request) -> Response:
        return FileResponse(self._folder.find("films", request.path_params["name"]), media_type="image/gif")
