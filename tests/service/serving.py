"""`mark3dgs serve` as a user starts it, for tests and measurements."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
LEAN = Path(__file__).parent / "lean"


@dataclass
class Served:
    """A running service."""

    address: str
    api_key: str
    folder: Path
    process: subprocess.Popen[bytes]

    @property
    def headers(self) -> dict[str, str]:
        """Of a request by its administrator."""
        return {"Authorization": f"Bearer {self.api_key}"}

    def log(self) -> str:
        """What it has said."""
        return (self.folder / "log.txt").read_text()

    def workers(self) -> list[int]:
        """Process ids of its workers."""
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        return [pid for pid in map(int, children) if b"worker" in Path(f"/proc/{pid}/cmdline").read_bytes()]

    def stop(self) -> None:
        """As Ctrl-C does."""
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(60)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise


def start(folder: Path, *, workers: int = 1, api_key: str = "", lean: bool = False, **settings: str) -> Served:
    """Start a service in a folder, which may hold an earlier one's data; returns once it answers.

    Parameters
    ----------
    folder : Path
    workers : int
    api_key : str
        Of an earlier start; the first start writes its own to a file.
    lean : bool
        The profile "fast" is a lean one (see lean/sitecustomize.py), for tests that ask nothing of pictures.
    settings
        Environment variables without their prefix, such as TSA_URL.
    """
    port = free_port()
    log = folder / "log.txt"
    environment = {k: v for k, v in os.environ.items() if not k.startswith("MARK3DGS_")}
    environment |= {"MARK3DGS_DATA_DIR": str(folder / "data")}
    environment |= {f"MARK3DGS_{name}": value for name, value in settings.items()}
    if lean:
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, (str(LEAN), os.environ.get("PYTHONPATH"))))
    with log.open("a") as out:
        process = subprocess.Popen(
            [sys.executable, "-m", "service.cli", "serve", "--port", str(port), "--workers", str(workers)],
            cwd=ROOT,
            env=environment,
            stdout=out,
            stderr=subprocess.STDOUT,
        )
    address = f"http://127.0.0.1:{port}"
    wait_until_up(process, address, log)
    if not api_key:
        api_key = (folder / "data" / "admin.key").read_text().strip()
        assert "mk_" not in log.read_text(), "the log is no place for a key"
    return Served(address, api_key, folder, process)


def free_port() -> int:
    """A port of loopback that nothing listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wait_until_up(process: subprocess.Popen[bytes], address: str, log: Path) -> None:
    """Return once /healthz answers."""
    for _ in range(600):
        try:
            urllib.request.urlopen(f"{address}/healthz", timeout=1).close()
            return
        except OSError:
            assert process.poll() is None, log.read_text()
            time.sleep(0.1)
    raise AssertionError(f"not up within 60 s: {log.read_text()}")
