"""Rounds of kill -9 during embeds on the running service; `python -m tests.service.measure kill` runs them."""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from tests.service import serving
from tests.service.measuring import PLANT, client_of, wait_for
from tests.service.serving import ROOT, Served


def kill(folder: Path, args: argparse.Namespace) -> dict[str, Any]:
    """Rounds of: start embeds, kill something with SIGKILL at a random moment, bring it back, look."""
    rng = random.Random(args.seed)
    served = serving.start(folder, workers=1, WORKER_SILENCE_SECONDS="6")
    lost: list[str] = []
    killed = {"worker": 0, "api": 0, "child": 0}
    acknowledged: list[tuple[str, str]] = []
    with client_of(served) as client:
        key = client.post("/v1/keys", json={}).json()["id"]
        data = client_model(folder)
        slot = client.post("/v1/uploads", json={"size": len(data)}).json()["id"]
        assert client.put(f"/v1/uploads/{slot}", content=data).status_code == 200
    for number in range(args.repeats):
        with client_of(served) as client:
            body = {
                "upload_id": slot,
                "key_id": key,
                "profile": "fast",
                "bits": 16,
                "psnr": 40,
                "copy_name": f"copy {number}",
            }
            headers = {"Idempotency-Key": f"round {number}"}
            job = client.post("/v1/embed", json=body, headers=headers).json()["id"]
            time.sleep(rng.uniform(0.0, 2.5))
            target = rng.choice(["worker", "worker", "api", "child"])
            killed[target] += 1
            _kill(served, target)
        if target == "api":
            served.process.wait()
            time.sleep(0.5)
            served = serving.start(folder, workers=1, api_key=served.api_key, WORKER_SILENCE_SECONDS="6")
        with client_of(served) as client:
            again = client.post("/v1/embed", json=body, headers=headers)
            if again.json().get("id") != job:
                lost.append(f"round {number}: the retry is another job: {again.text}")
            found = wait_for(client, job, 180)
            if found["state"] != "succeeded":
                lost.append(f"round {number}: {target}: {found}")
                continue
            acknowledged.append((job, found["result"]["asset_id"]))
        if number % 10 == 9:
            sys.stderr.write(f"{number + 1} rounds, {len(lost)} lost\n")
    with client_of(served) as client:
        for job, asset in acknowledged:
            record = client.get(f"/v1/assets/{asset}/record")
            model = client.get(f"/v1/assets/{asset}/model")
            if record.status_code != 200 or model.status_code != 200:
                lost.append(f"{job}: its files are gone")
        assets, after = [], ""
        while after is not None:
            page = client.get("/v1/assets", params={"limit": 100, "after": after}).json()
            assets += [asset["copy_name"] for asset in page["items"]]
            after = page["next"]
    served.stop()
    environment = {**os.environ, "MARK3DGS_DATA_DIR": str(folder / "data")}
    audit = subprocess.run(
        [sys.executable, "-m", "service.cli", "audit", "verify", "--json"],
        env=environment,
        capture_output=True,
        cwd=ROOT,
    )
    left = [str(path) for path in (folder / "data" / "scratch").rglob("*") if path.is_file()]
    return {
        "rounds": args.repeats,
        "killed": killed,
        "lost": lost,
        "assets": len(assets),
        "duplicates": len(assets) - len(set(assets)),
        "audit_exit": audit.returncode,
        "left_in_scratch": left,
        "succeeded": len(acknowledged),
    }


def client_model(folder: Path) -> bytes:
    """A small real model, so that a round is short: an eighth of the shipped one."""
    out = folder / "thin.ply"
    command = [
        sys.executable,
        "-m",
        "service.cli",
        "attack",
        "prune_random",
        str(PLANT),
        str(out),
        "--strength",
        "0.85",
    ]
    subprocess.run(command, check=True, capture_output=True, cwd=ROOT)
    return out.read_bytes()


def _kill(served: Served, target: str) -> None:
    if target == "api":
        served.process.kill()
        return
    for worker in served.workers():
        pids = [worker]
        if target == "child":
            children = Path(f"/proc/{worker}/task/{worker}/children").read_text().split()
            pids = [int(pid) for pid in children]
        for pid in pids:
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
