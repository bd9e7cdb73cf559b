"""What an uploader can tell of another owner's mark in what it has marked.

Services in each of which another owner has one asset: the uploads carry its mark; or they derive from its original, and
carry no mark of its owner's; or they have nothing to do with it (the known leak; `--kinds` leaves it out). The same
uploads go to all of them, in blocks, since what one upload leaves to do the next one may wait for. The uploader deletes
its assets after each block, as one would who wants clear answers: each asset of its own makes the next answer later.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import numpy.typing as npt

from engine.formats import encode_model, read_model
from engine.watermark.keys import OwnerKey
from service.client import Client
from service.work.tasks import TASKS
from tests.service import serving
from tests.service.flow.commands import token_of
from tests.service.measuring import FINAL, PLANT

BLOCK = 5
COPIES = 4
POLL_S = 0.1  # a job's own times are exact, to the microsecond
FIDELITY = ("psnr_worst_view", "psnr_as_written", "ssim_worst_view")
KINDS = ("marked", "original", "unrelated")
"""What the uploads are to the other owner's asset, by service."""
SCENE, STRANGE = serving.ROOT / "tests" / "data" / "train_1000.ply", PLANT
Float64 = npt.NDArray[np.float64]


def oracle(folder: Path, args: argparse.Namespace) -> dict[str, Any]:
    """Area under the ROC curve of marked against each of the others: of each thing that the uploader sees, and of a
    linear classifier on all of them, blocks left out in turn."""
    kinds = [name for name in KINDS if name in args.kinds.split(",")]
    limits = dict.fromkeys(("EMBEDS_PER_HOUR", "SUBJECT_EMBEDS_PER_DAY", "QUEUED_JOBS"), "10000")
    limits["MASTER_KEY"] = os.environ["MARK3DGS_MASTER_KEY"] = "ab" * 32  # for commands beside them, too
    limits["WEBHOOKS_PRIVATE"] = "true"
    owner_keys = [OwnerKey.generate().secret.hex() for _ in range(3)]
    services, owners, lines = [], [], []
    try:
        for name in kinds:
            (data := folder / name).mkdir()
            services.append(serving.start(data, workers=1, **limits))
            owner, uploader = (Client(services[-1].address, token_of(services[-1], who)) for who in ("owner", "up"))
            owner.call("POST", "/v1/keys", json={"key": owner_keys[name == "original"]})
            uploader.call("POST", "/v1/keys", json={"key": owner_keys[2]})
            uploader.add_webhook("http://127.0.0.1:9/nobody-listens")
            made = owner.embed(_splat(STRANGE if name == "unrelated" else SCENE), profile="fast")
            if name == "marked":
                model = owner.download(made.asset_id, folder / "marked.splat").read_bytes()
            owners.append(owner)
            headers = {"Authorization": f"Bearer {token_of(services[-1], 'up')}"}
            lines.append(httpx.Client(base_url=services[-1].address, headers=headers, timeout=600))
        random, seen, labels, blocks = np.random.default_rng(args.seed), [], [], []
        until = time.monotonic() + 60 * args.minutes
        for block in range(args.questions // BLOCK):
            if time.monotonic() > until:
                break
            sys.stderr.write(f"{block * BLOCK} of {args.questions} questions\n")
            uploads = [_changed(model, random) for _ in range(BLOCK)]
            for which in random.permutation(len(kinds)):
                for data in uploads:
                    seen.append(_question(lines[which], data))
                    labels.append(which)
                    blocks.append(block)
                for asset in lines[which].get("/v1/assets", params={"limit": 100}).json()["items"]:
                    lines[which].delete(f"/v1/assets/{asset['id']}").raise_for_status()
        notices = [len(owner.notices()) for owner in owners]
    finally:
        for served in services:
            served.stop()
    names = list(seen[0])
    table, label = np.array([[row[name] for name in names] for row in seen]), np.array(labels)
    asked = labels.count(0)
    found: dict[str, Any] = {"questions": asked, "notices": dict(zip(kinds, notices, strict=True))}
    for which in range(1, len(kinds)):
        chosen = (label == 0) | (label == which)
        one, marked, block_of = table[chosen], (label[chosen] == 0).astype(int), np.array(blocks)[chosen]
        single = {name: _auc(one[:, k], marked) for k, name in enumerate(names)}
        all_of_it = _auc(_cross_validated(one, marked, block_of), marked)
        found[f"marked against {kinds[which]}"] = {"auc_of_all": all_of_it, "auc_of_each": single}
    found["chance"] = float(np.sqrt((2 * asked + 1) / 12)) / asked  # standard deviation around 0.5
    medians = {
        name: [float(np.median(table[label == k, n])) for k in range(len(kinds))] for n, name in enumerate(names)
    }
    return found | {"medians": medians}


def looking(folder: Path, args: argparse.Namespace) -> dict[str, Any]:
    """Processor time of looking for another owner's mark, as the job that follows an embed does, by whether the upload
    has it: what a queue could reveal at most. Steady on a busy machine, where times by the clock are not."""
    original, random = folder / "scene.splat", np.random.default_rng(args.seed)
    original.write_bytes(_splat(SCENE))
    sought = {name: _copies(original, folder / name, random.bytes(32).hex()) for name in KINDS[:2]}
    model = Path(sought["marked"][0]["model"]).read_bytes()
    return {f"{count} copies": _looked(folder, sought, model, count, args) for count in (1, COPIES)}


def _copies(original: Path, folder: Path, key: str) -> list[dict[str, str]]:
    """Candidates: copies of one original under one key."""
    made = list[dict[str, str]]()
    for number in range(COPIES):
        (home := folder / str(number)).mkdir(parents=True)
        request = {"model": str(original), "message": None, "profile": "fast", "format": "splat", "key": key}
        request |= {"copy": f"copy {number}", "earlier": made[0]["record"] if made else ""}
        files = TASKS["embed"](request, home, _silent)["files"]
        paths = {name: str(home / files[name]) for name in ("model", "record")}
        made.append({"asset": str(number), "original": "scene", "key": key, **paths})
    return made


def _looked(
    folder: Path, sought: dict[str, list[dict[str, str]]], model: bytes, count: int, args: argparse.Namespace
) -> dict[str, Any]:
    random, upload = np.random.default_rng(args.seed), folder / "upload.splat"
    seconds: list[list[float]] = [[], []]
    found = [0, 0]
    for number in range(-3, args.questions):  # the first compile
        upload.write_bytes(_changed(model, random))
        for which in random.permutation(2):
            began = time.process_time()
            request = {"model": str(upload), "candidates": sought[KINDS[which]][:count]}
            carried = TASKS["marks"](request, folder, _silent)["carries"]
            if number >= 0:
                seconds[which].append(time.process_time() - began)
                found[which] += len(carried)
    times = np.array(seconds)
    differences = times[0] - times[1]
    return {
        "uploads": args.questions,
        "marks_found": dict(zip(KINDS, found, strict=False)),
        "median_cpu_s": dict(zip(KINDS, map(float, np.median(times, axis=1)), strict=False)),
        "mean_difference_s": float(differences.mean()),
        "standard_error_s": float(differences.std() / np.sqrt(len(differences))),
        "auc": _auc(times.ravel(), np.repeat([1, 0], times.shape[1])),
    }


def _silent(stage: str, fraction: float) -> None:
    """Progress of a task that nobody follows."""


def _splat(path: Path) -> bytes:
    """As many Gaussians of a model as the uploads have."""
    model = read_model(path).model
    return encode_model(model.take(np.arange(1000)), "splat")


def _changed(data: bytes, random: np.random.Generator) -> bytes:
    """A few colors of a `.splat` (32 bytes a Gaussian), one step up or down."""
    changed = bytearray(data)
    for row in random.integers(0, len(data) // 32, 20):
        changed[32 * row + 24] ^= 1
    return bytes(changed)


def _question(line: httpx.Client, data: bytes) -> dict[str, float]:
    """Numbers of all that is seen of one embed."""
    began = time.perf_counter()
    answer = line.post("/v1/embed", files={"model": ("m.splat", data)}, data={"profile": "fast"})
    job = answer.json()
    taken, looks, states = time.perf_counter() - began, 0, set[str]()
    places = [job.get("position") or 0]
    while job["state"] not in FINAL:
        time.sleep(POLL_S)
        job, looks = line.get(f"/v1/jobs/{job['id']}").json(), looks + 1
        states.add(f"{job['state']} {job['stage']}")
        places.append(job.get("position") or 0)
    at = [time.mktime(time.strptime(job[f"{name}_at"][:19], "%Y-%m-%dT%H:%M:%S")) for name in ("created", "finished")]
    exact = [float(job[f"{name}_at"][17:26]) for name in ("created", "started", "finished")]
    result = job["result"] or {}
    numbers = {name: float(result.get(name, -1)) for name in (*FIDELITY, "gaussians")}
    asset = line.get(f"/v1/assets/{result.get('asset_id')}")
    (webhook,) = line.get("/v1/webhooks").json()["items"]
    return numbers | {
        "status": float(answer.status_code),
        "succeeded": float(job["state"] == "succeeded"),
        "size": float(len(json.dumps(job)) - len(str(result.get("seconds"))) - sum(map(len, _floats(result)))),
        "members": float(len(result)),
        "asset_members": float(len(asset.json())),
        "messages": float(webhook["waiting"]),
        "place": float(max(places, default=0)),
        "stages": float(len(states)),
        "looks": float(looks),
        "answer_s": taken,
        "queued_s": (exact[1] - exact[0]) % 60.0,
        "running_s": (exact[2] - exact[1]) % 60.0,
        "whole_s": time.perf_counter() - began,
        "whole_by_clock_s": at[1] - at[0],
        "engine_s": float(result.get("seconds", -1)),
    }


def _floats(result: dict[str, Any]) -> list[str]:
    return [str(result[name]) for name in FIDELITY if name in result]


def _cross_validated(table: Float64, label: npt.NDArray[np.int_], blocks: npt.NDArray[np.int_]) -> Float64:
    """Scores by Fisher's linear discriminant, each block by what the others say."""
    spread = table.std(0)
    table = (table - table.mean(0)) / np.where(spread > 0, spread, 1.0)
    scores = np.zeros(len(table))
    for block in np.unique(blocks):
        train = blocks != block
        x, y = table[train], label[train]
        within = np.cov(x[y == 1].T) + np.cov(x[y == 0].T) + 0.1 * np.eye(x.shape[1])
        weights = np.linalg.solve(within, x[y == 1].mean(0) - x[y == 0].mean(0))
        scores[~train] = table[~train] @ weights
    return scores


def _auc(scores: Float64, label: npt.NDArray[np.int_]) -> float:
    """Area under the ROC curve; ties count half."""
    yes, no = scores[label == 1][:, None], scores[label == 0][None, :]
    return float(((yes > no) + 0.5 * (yes == no)).mean())
