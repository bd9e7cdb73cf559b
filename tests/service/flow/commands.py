"""Commands beside a running service, clients with keys that they made, and the bare line to it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from typing import Any

import httpx

from service.client import Client
from tests.service.measuring import FINAL
from tests.service.serving import ROOT, Served


def mark3dgs(served: Served, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A command beside the running service."""
    environment = {**os.environ, "MARK3DGS_DATA_DIR": str(served.folder / "data")}
    command = [sys.executable, "-m", "service.cli", *arguments]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)


def token_of(served: Served, tenant: str) -> str:
    done = mark3dgs(served, "apikey", "create", "--tenant", tenant, "--scopes", "admin", "--json")
    return str(json.loads(done.stdout)["api_key"])


def client_of(served: Served, tenant: str) -> Client:
    return Client(served.address, token_of(served, tenant))


class Line(httpx.Client):
    """What goes over the line, for tests of its faults: no client of ours mends any."""

    def wait(self, job: dict[str, Any]) -> dict[str, Any]:
        """The job once it has ended."""
        until = time.monotonic() + 120
        while time.monotonic() < until:
            found: dict[str, Any] = self.get(f"/v1/jobs/{job['id']}").json()
            if found["state"] in FINAL:
                return found
            time.sleep(0.05)
        raise AssertionError(f"not ended: {found}")

    def verify(self, data: bytes) -> dict[str, Any]:
        """A verify job, ended."""
        return self.wait(self.post("/v1/verify", files={"model": data}).json())
