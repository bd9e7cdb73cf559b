"""A compose project under test: started, looked into, hurt, and torn down."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import httpx

from tests.docker.images import run

ROOT = Path(__file__).parents[2]
COMPOSE = Path(sys.executable).with_name("docker-compose")
IMAGE = "mark3dgs-test:latest"
START_SECONDS = 180
T = TypeVar("T")
TOKEN = re.compile(r"mk_[0-9a-f]{16}_[0-9a-f]{64}")


class Stack:
    """A running compose project.

    Parameters
    ----------
    project : str
    files : list of Path
    environment : dict
        For the compose files; the published port is a free one.
    """

    def __init__(self, project: str, files: list[Path], environment: dict[str, str]) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.project = project
        self._command = [str(COMPOSE), "--project-name", project, *(f"--file={file}" for file in files)]
        self._environment = {"MARK3DGS_IMAGE": IMAGE, "MARK3DGS_PORT": str(self.port), **environment}

    @property
    def url(self) -> str:
        """Where the published port is."""
        return f"http://127.0.0.1:{self.port}"

    def compose(self, *arguments: str) -> str:
        """Call compose on this project."""
        done = subprocess.run(
            [*self._command, *arguments],
            capture_output=True,
            text=True,
            timeout=1500,
            env=os.environ | self._environment,
        )
        if done.returncode:
            raise RuntimeError(f"compose {' '.join(arguments)}: {done.stdout[-1000:]}\n{done.stderr[-3000:]}")
        return done.stdout

    def up(self, *arguments: str) -> None:
        """Start, and wait until all that have a health check are healthy."""
        self.compose("up", "--detach", "--no-build", "--wait", f"--wait-timeout={START_SECONDS}", *arguments)

    def token(self, service: str) -> str:
        """The admin key that the first start wrote to a file; none is in the log."""
        assert not TOKEN.findall(self.compose("logs", "--no-log-prefix", service)), "a key in the log"
        found = TOKEN.fullmatch(self.compose("exec", "-T", service, "cat", "/data/admin.key").strip())
        assert found, "no key in the file"
        return found[0]

    def containers(self, service: str) -> list[str]:
        """Ids of a service's running containers."""
        return self.compose("ps", "--quiet", service).split()

    def inspect(self, container: str) -> dict[str, Any]:
        """What the engine says of a container."""
        found: list[dict[str, Any]] = json.loads(run("docker", "inspect", container))
        return found[0]

    def processes(self, container: str) -> dict[int, str]:
        """The host's process ids in a container, and their command lines."""
        lines = run("docker", "top", container, "-eo", "pid,args").splitlines()[1:]
        return {int(pid): words for pid, words in (line.split(maxsplit=1) for line in lines)}

    def process(self, container: str, words: str) -> int:
        """The one process whose command line contains something."""
        found = [pid for pid, line in self.processes(container).items() if words in line]
        assert len(found) == 1, f"{len(found)} processes with {words!r}: {self.processes(container)}"
        return found[0]

    def client(self, token: str) -> Client:
        """A client with a key."""
        return Client(self.url, token)


class Client(httpx.Client):
    """What a user of the service does."""

    def __init__(self, url: str, token: str) -> None:
        super().__init__(base_url=url, headers={"Authorization": f"Bearer {token}"}, timeout=90)

    def start(self, kind: str, model: bytes, **fields: str) -> str:
        """Hand in a job; its id."""
        answer = self.post(f"/v1/{kind}", files={"model": ("model.splat", model)}, data=fields)
        assert answer.status_code == 202, answer.text
        return str(answer.json()["id"])

    def job(self, job: str) -> dict[str, Any]:
        """The job as it stands."""
        answer = self.get(f"/v1/jobs/{job}")
        assert answer.status_code == 200, answer.text
        found: dict[str, Any] = answer.json()
        return found

    def end(self, job: str, seconds: float = 240) -> dict[str, Any]:
        """The job once it has ended; a service that is away for a while is polled again."""
        ended = ("succeeded", "disputed", "failed", "cancelled")

        def look() -> dict[str, Any] | None:
            try:
                found = self.job(job)
            except (httpx.TransportError, AssertionError):
                return None
            return found if found["state"] in ended else None

        return wait_for(look, seconds, f"the end of {job}")

    def middle(self, job: str) -> None:
        """Wait until the engine is at work on a job."""

        def look() -> bool:
            found = self.job(job)
            assert found["state"] in ("queued", "running"), f"too fast to be hurt: {found}"
            return found["state"] == "running" and bool(found["stage"]) and 0 < found["fraction"] < 1

        wait_for(look, 120, f"the middle of {job}")


def wait_for(look: Callable[[], T | None], seconds: float, what: str) -> T:
    """What `look` finds, once it finds something."""
    until = time.monotonic() + seconds
    while not (found := look()):
        if time.monotonic() > until:
            raise TimeoutError(f"{what} did not come within {seconds:.0f} s")
        time.sleep(0.1)
    return found


def kill(pid: int) -> None:
    """kill -9, from the host."""
    os.kill(pid, signal.SIGKILL)


@contextmanager
def running(stack: Stack, *arguments: str) -> Iterator[Stack]:
    """The project from up to down; its log goes with what failed."""
    try:
        stack.up(*arguments)
        yield stack
    except RuntimeError as error:
        raise RuntimeError(f"{error}\n{stack.compose('logs')[-3000:]}") from None
    finally:
        stack.compose("down", "--volumes", "--remove-orphans", "--timeout", "10")
