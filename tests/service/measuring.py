"""What measurements of the running service share."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import httpx

from tests.service.serving import ROOT, Served

PLANT = ROOT / "tests" / "data" / "plant.splat"
FINAL = {"succeeded", "disputed", "failed", "cancelled"}


def client_of(served: Served, **headers: str) -> httpx.Client:
    """A client of the administrator."""
    return httpx.Client(base_url=served.address, headers={**served.headers, **headers}, timeout=600)


def resident_mb(pid: int, peak: bool = False) -> float:
    """Memory of a process."""
    wanted = "VmHWM:" if peak else "VmRSS:"
    status = Path(f"/proc/{pid}/status").read_text()
    return next(int(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith(wanted))


def wait_for(client: httpx.Client, job: str, seconds: float = 600) -> dict[str, Any]:
    """The job once it has ended."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        found: dict[str, Any] = client.get(f"/v1/jobs/{job}").json()
        if found["state"] in FINAL:
            return found
        time.sleep(0.1)
    raise AssertionError(f"job {job} has not ended: {found}")
