"""What the service costs and stands, measured on the running thing: `python -m tests.service.measure WHAT`.

upload     1 GB over loopback: MB/s, and the API's memory
parallel   100 verifications sent at once: none may be refused or lost; /healthz while two embeds run
overhead   an embed through the service against `mark3dgs embed`, same scene and profile
bodies     1,100 POSTs at a time that drip, without an API key
fairness   another tenant's embed and lists beside 600 verifications and 44 conversions
copies     the oldest of many copies of one asset: found among all, and in a stranger's embed
oracle     what an uploader can learn of another owner's mark from its own embeds: AUC over so many questions
looking    processor time of looking for another owner's mark: with the mark in the upload, and without
scale      two API processes, three workers, PostgreSQL, S3: throughput; workers killed, the database restarted
kill       kill -9 of worker, API or both at random moments of embeds: nothing acknowledged may be lost or doubled

Prints one JSON object. Only this machine is talked to.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from engine.lab.evaluate.machine import machine_info
from tests.service import serving
from tests.service.measure_kills import kill
from tests.service.measure_load import bodies, copies, fairness
from tests.service.measure_oracle import looking, oracle
from tests.service.measure_scale import scale
from tests.service.measuring import FINAL, PLANT, client_of, resident_mb, wait_for


def upload(folder: Path, args: argparse.Namespace) -> dict[str, Any]:
    """A PLY of 1 GB, of noise: as large as a model gets."""
    rows = (1 << 30) // 248
    names = [
        *"xyz",
        "nx",
        "ny",
        "nz",
        *(f"f_dc_{i}" for i in range(3)),
        *(f"f_rest_{i}" for i in range(45)),
        "opacity",
        *(f"scale_{i}" for i in range(3)),
        *(f"rot_{i}" for i in range(4)),
    ]
    path = folder / "large.ply"
    head = "ply\nformat binary_little_endian 1.0\n" + f"element vertex {rows}\n"
    head += "".join(f"property float {name}\n" for name in names) + "end_header\n"
    rng = np.random.default_rng(0)
    with path.open("wb") as file:
        file.write(head.encode())
        block = rng.standard_normal((1 << 14, 62), dtype=np.float32).tobytes()
        for start in range(0, rows, 1 << 14):
            file.write(block[: 248 * min(1 << 14, rows - start)])
    size = path.stat().st_size
    served = serving.start(folder, workers=0)
    speeds = []
    try:
        with client_of(served) as client:
            idle = resident_mb(served.process.pid)
            for _ in range(args.repeats):
                slot = client.post("/v1/uploads", json={"size": size}).json()["id"]
                began = time.perf_counter()
                command = [
                    "curl",
                    "-sf",
                    "-T",
                    str(path),
                    "-H",
                    f"Authorization: Bearer {served.api_key}",
                    f"{served.address}/v1/uploads/{slot}",
                ]
                subprocess.run(command, check=True, capture_output=True)
                speeds.append(size / 1e6 / (time.perf_counter() - began))
                assert client.get(f"/v1/uploads/{slot}").json()["state"] == "complete"
        peak = resident_mb(served.process.pid, peak=True)
    finally:
        served.stop()
    return {
        "bytes": size,
        "mb_per_s": statistics.median(speeds),
        "all": speeds,
        "api_idle_mb": idle,
        "api_peak_mb": peak,
    }


def prepared(client: httpx.Client) -> tuple[str, str]:
    """An owner key and an asset under it."""
    key = client.post("/v1/keys", json={}).json()["id"]
    form = {"key_id": key, "profile": "fast"}
    job = client.post("/v1/embed", data=form, files={"model": PLANT.read_bytes()}).json()["id"]
    return key, str(wait_for(client, job)["result"]["asset_id"])


def parallel(folder: Path, args: argparse.Namespace) -> dict[str, Any]:
    """100 verifications at once, then /healthz twenty times a second while two embeds run."""
    served = serving.start(folder, workers=2)
    try:
        with client_of(served) as client:
            key, asset = prepared(client)
            data = client.get(f"/v1/assets/{asset}/model").content
            slot = client.post("/v1/uploads", json={"size": len(data)}).json()["id"]
            client.put(f"/v1/uploads/{slot}", content=data)

            def ask(_: int) -> tuple[int, str]:
                answer = client.post("/v1/verify", json={"upload_id": slot, "asset_id": asset})
                return answer.status_code, answer.json().get("id", "")

            began = time.perf_counter()
            with ThreadPoolExecutor(100) as pool:
                answers = list(pool.map(ask, range(100)))
            queued = time.perf_counter() - began
            ended = [wait_for(client, job) for _, job in answers]
            done = time.perf_counter() - began

            jobs = [
                client.post("/v1/embed", data={"key_id": key, "copy_name": name}, files={"model": PLANT.read_bytes()})
                for name in ("a", "b")
            ]
            times = []
            while any(client.get(f"/v1/jobs/{job.json()['id']}").json()["state"] not in FINAL for job in jobs):
                for _ in range(10):
                    began = time.perf_counter()
                    assert client.get("/healthz").status_code == 200
                    times.append(time.perf_counter() - began)
                    time.sleep(0.05)
    finally:
        served.stop()
    return {
        "verifies": len(answers),
        "refused": sum(status != 202 for status, _ in answers),
        "marked": sum(job["result"]["verdict"] == "marked" for job in ended if job["result"]),
        "seconds_to_queue": queued,
        "seconds_to_end": done,
        "health_requests": len(times),
        "health_p50_ms": 1e3 * float(np.quantile(times, 0.5)),
        "health_p99_ms": 1e3 * float(np.quantile(times, 0.99)),
    }


def overhead(folder: Path, args: argparse.Namespace) -> dict[str, Any]:
    """Alternating: the command line on a file, and the service from request to final state."""
    scene = Path(args.scene)
    key = folder / "owner.key"
    command = [sys.executable, "-m", "service.cli"]
    subprocess.run([*command, "keygen", str(key)], check=True, capture_output=True)
    secret = key.read_text().splitlines()[-1]
    served = serving.start(folder, workers=1)
    bare, inside, through = [], [], []
    try:
        with client_of(served) as client:
            prepared(client)  # the registry is not empty: every upload is screened
            key_id = client.post("/v1/keys", json={"key": secret}).json()["id"]
            data = scene.read_bytes()
            slot = client.post("/v1/uploads", json={"size": len(data)}).json()["id"]
            began = time.perf_counter()
            assert client.put(f"/v1/uploads/{slot}", content=data).status_code == 200
            upload_seconds = time.perf_counter() - began
            for number in range(args.repeats + 1):
                time.sleep(4)  # the process in waiting has loaded
                began = time.perf_counter()
                body = {"upload_id": slot, "key_id": key_id, "profile": args.profile, "copy_name": f"c{number}"}
                job = wait_for(client, client.post("/v1/embed", json=body).json()["id"])
                assert job["state"] == "succeeded", job
                through.append(time.perf_counter() - began)
                inside.append(job["result"]["seconds"])
                began = time.perf_counter()
                out = folder / f"m{number}{''.join(scene.suffixes)}"
                subprocess.run(
                    [
                        *command,
                        "embed",
                        str(scene),
                        str(out),
                        "--key",
                        str(key),
                        "--record",
                        f"{out}.record",
                        "--profile",
                        args.profile,
                        "--copy",
                        f"c{number}",
                    ],
                    check=True,
                    capture_output=True,
                )
                bare.append(time.perf_counter() - began)
    finally:
        served.stop()
    # The first round finds cold files.
    ratios = [a / b for a, b in zip(through[1:], bare[1:], strict=True)]
    return {
        "scene": scene.name,
        "profile": args.profile,
        "upload_and_look_s": upload_seconds,
        "service_s": through[1:],
        "engine_inside_s": inside[1:],
        "command_line_s": bare[1:],
        "first_round": [through[0], bare[0]],
        "overhead_percent": 100 * (statistics.median(ratios) - 1),
    }


WHAT = {
    "upload": upload,
    "parallel": parallel,
    "overhead": overhead,
    "bodies": bodies,
    "fairness": fairness,
    "copies": copies,
    "kill": kill,
    "oracle": oracle,
    "looking": looking,
    "scale": scale,
}


def main() -> None:
    """Measure, and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=sorted(WHAT))
    parser.add_argument("--scene", default=str(PLANT), help="overhead: the model to mark")
    parser.add_argument("--profile", default="fast")
    parser.add_argument("--repeats", type=int, default=3, help="timed runs, or rounds of kills")
    parser.add_argument("--jobs", type=int, default=600, help="fairness: verifications of the crowd")
    parser.add_argument("--lines", type=int, default=1100, help="bodies: connections at a time")
    parser.add_argument("--verifies", type=int, default=24, help="scale: verifications, for each number of workers")
    parser.add_argument("--embeds", type=int, default=30, help="scale: during which things fail")
    parser.add_argument("--copies", type=int, default=41, help="copies: how many")
    parser.add_argument("--questions", type=int, default=200, help="oracle: embeds of the uploader, at each service")
    parser.add_argument("--kinds", default="marked,original,unrelated", help="oracle: what uploads are, by service")
    parser.add_argument("--minutes", type=float, default=100, help="oracle: begins no more questions after that")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="mark3dgs-measure-"))
    watchdog = threading.Timer(7200, os._exit, [1])
    watchdog.daemon = True
    watchdog.start()
    try:
        found = WHAT[args.what](folder, args)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    sys.stdout.write(
        json.dumps({"what": args.what, **found, "seed": args.seed, "machine": machine_info()}, indent=1) + "\n"
    )


if __name__ == "__main__":
    main()
