"""What one tenant's load costs another, and what many copies of one asset cost their owner, on a running service."""

from __future__ import annotations

import argparse
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from engine.flows.views.camera_rig import make_rig
from engine.formats import read_model
from engine.raster import render
from engine.usecases.files import write_picture
from service.client import Client
from tests.service import serving
from tests.service.flow.commands import token_of
from tests.service.measuring import PLANT, resident_mb

FORMATS = ("splat", "spz", "sog", "glb", "compressed.ply")
CONVERSIONS = 44


def fairness(folder: Path, args: argparse.Namespace) -> dict[str, Any]:
    """Another tenant's embed alone, behind many verifications, and after these; its list during conversions.

    Limits are lifted, so that the crowd gets what it asks for.
    """
    jobs = ("QUEUED_JOBS", "VERIFIES_PER_HOUR", "SUBJECT_VERIFIES_PER_DAY")
    lifted = {**dict.fromkeys(jobs, "10000"), "CONVERSIONS_AT_ONCE": str(CONVERSIONS)}
    served = serving.start(folder, workers=1, **lifted)
    try:
        keys = {name: token_of(served, name) for name in ("crowd", "other")}
        crowd, other = (Client(served.address, key) for key in keys.values())
        bare = httpx.Client(base_url=served.address, timeout=600, headers={"Authorization": f"Bearer {keys['crowd']}"})
        assets = [crowd.embed(PLANT, profile="fast", copy_name=name).asset_id for name in "abcd"]
        upload = crowd.upload(crowd.download(assets[0], folder / "copy.ply")).id

        def embed() -> Any:
            return other.embed(PLANT, profile="fast", timeout=7200)

        embed()  # its owner key is made
        time.sleep(5)  # the process in waiting is warm
        alone = _seconds(embed)

        def ask(_: int) -> int:
            return bare.post("/v1/verify", json={"upload_id": upload, "asset_id": assets[0]}).status_code

        began = time.perf_counter()
        with ThreadPoolExecutor(32) as pool:
            answers = Counter(pool.map(ask, range(args.jobs)))
        queued = time.perf_counter() - began
        behind = _seconds(embed)
        left = _open_jobs(crowd)
        began = time.perf_counter()
        with ThreadPoolExecutor(32) as pool:
            list(pool.map(lambda job: bare.delete(f"/v1/jobs/{job}"), left))
        cancelled = time.perf_counter() - began
        after = _seconds(embed)

        def convert(number: int) -> int:
            kind = FORMATS[number % len(FORMATS)]
            return bare.get(f"/v1/assets/{assets[number % len(assets)]}/model", params={"format": kind}).status_code

        stop, times = threading.Event(), list[float]()

        def look() -> None:
            while not stop.is_set():
                times.append(_seconds(other.assets))
                time.sleep(0.02)

        looking = threading.Thread(target=look)
        looking.start()
        began = time.perf_counter()
        with ThreadPoolExecutor(CONVERSIONS) as pool:
            converted = Counter(pool.map(convert, range(CONVERSIONS)))
        took = time.perf_counter() - began
        stop.set()
        looking.join()
    finally:
        served.stop()
    return {
        "embed_alone_s": alone,
        "verifications": dict(answers),
        "queued_in_s": queued,
        "embed_behind_them_s": behind,
        "left_when_it_ended": len(left),
        "cancelled_in_s": cancelled,
        "embed_after_that_s": after,
        "conversions": dict(converted),
        "converted_in_s": took,
        "list_p50_ms": 1e3 * float(np.median(times)),
        "list_most_ms": 1e3 * max(times),
    }


def copies(folder: Path, args: argparse.Namespace) -> dict[str, Any]:
    """The oldest of many copies of one asset: its model and a picture of it among all; a stranger's embed of it."""
    served = serving.start(folder, workers=1, WATCH_MINUTES="0")
    try:
        owner, stranger = (Client(served.address, token_of(served, name)) for name in ("owner", "stranger"))
        made = [owner.embed(PLANT, profile="fast", copy_name=f"c{number}").asset_id for number in range(args.copies)]
        model = owner.download(made[0], folder / "leak.ply")
        loaded = read_model(model).model
        camera = make_rig(loaded, 1, 1200, 800, jitter=np.random.default_rng(args.seed).random((1, 4)))[0]
        picture = folder / "leak.jpg"
        write_picture(np.clip(render(loaded, camera), 0.0, 1.0), picture, picture, 90)
        found: dict[str, Any] = {"copies": args.copies}
        for name, suspect in (("model", model), ("picture", picture), ("original", PLANT)):
            time.sleep(5)
            began = time.perf_counter()
            answer = owner.verify(suspect)
            found |= {f"{name}_s": time.perf_counter() - began, f"{name}_verdict": answer.verdict}
            found[f"{name}_named"] = answer.asset_id == made[0]
        time.sleep(5)
        began = time.perf_counter()
        stranger.embed(model, profile="fast")
        found["stranger_s"] = time.perf_counter() - began
        while not (notices := owner.notices()):
            time.sleep(0.1)
        return found | {"notice_s": time.perf_counter() - began, "notice_named": notices[0].asset_id == made[0]}
    finally:
        served.stop()


def bodies(folder: Path, args: argparse.Namespace) -> dict[str, Any]:
    """Many who send the head of a POST without an API key, and then nothing: what each gets, and what others notice."""
    served = serving.start(folder, workers=0, CONNECTIONS=str(2 * args.lines))
    try:
        return drip(served, args.lines)
    finally:
        served.stop()


def drip(served: serving.Served, many: int) -> dict[str, Any]:
    """So many dripping POSTs at a time: statuses, seconds until all had their answer and an end, the slowest /healthz
    meanwhile, and what the log has grown by."""
    host, port = served.address.removeprefix("http://").split(":")
    head = b"POST /v1/verify HTTP/1.1\r\nHost: t\r\nContent-Type: application/json\r\nContent-Length: 100000\r\n\r\n{"
    said, memory = len(served.log()), resident_mb(served.process.pid)
    began, times = time.perf_counter(), list[float]()
    lines = [socket.create_connection((host, int(port)), timeout=60) for _ in range(many)]
    for line in lines:
        line.sendall(head)
    statuses = Counter[int]()
    for number, line in enumerate(lines):
        if number % 20 == 0:
            times.append(_seconds(lambda: httpx.get(f"{served.address}/healthz", timeout=60).raise_for_status()))
        answer = b""
        while chunk := line.recv(65536):
            answer += chunk
        statuses[int(answer[9:12])] += 1
        line.close()
    return {
        "lines": many,
        "statuses": dict(statuses),
        "all_ended_s": time.perf_counter() - began,
        "health_most_s": max(times),
        "log_bytes": len(served.log()) - said,
        "memory_mb": [memory, resident_mb(served.process.pid, peak=True)],
    }


def _open_jobs(client: Client) -> list[str]:
    return [job.id for state in ("queued", "running") for job in client.jobs(state=[state])]


def _seconds(act: Callable[[], Any]) -> float:
    began = time.perf_counter()
    act()
    return time.perf_counter() - began
