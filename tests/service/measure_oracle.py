"""Whether an uploader can tell that another owner's mark is in what it has marked.

Two services with the same keys: in both, the owner has an asset that the uploads resemble; only in one is its mark in
them. The same uploads go to both, in blocks, since what one upload leaves to do the next one may wait for.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import numpy.typing as npt

from engine.formats import encode_model, read_model
from engine.watermark.keys import OwnerKey
from service.client import Client
from tests.service import serving
from tests.service.flow.commands import token_of
from tests.service.measuring import FINAL

BLOCK = 5
SCENE = serving.ROOT / "tests" / "data" / "train_1000.ply"
Float64 = npt.NDArray[np.float64]


def oracle(folder: Path, args: argparse.Namespace) -> dict[str, Any]:
    """Area under the ROC curve of a linear classifier on all that the uploader sees, blocks left out in turn."""
    limits = dict.fromkeys(("EMBEDS_PER_HOUR", "SUBJECT_EMBEDS_PER_DAY", "QUEUED_JOBS"), "10000")
    limits["MASTER_KEY"] = os.environ["MARK3DGS_MASTER_KEY"] = "ab" * 32  # for commands beside them, too
    owner_keys = [OwnerKey.generate().secret.hex() for _ in range(3)]
    services = []
    try:
        for name in ("with", "without"):
            (data := folder / name).mkdir()
            services.append(serving.start(data, workers=1, **limits))
        tokens = [{who: token_of(served, who) for who in ("owner", "uploader")} for served in services]
        model = folder / "marked.splat"
        for number, (served, token) in enumerate(zip(services, tokens, strict=True)):
            owner = Client(served.address, token["owner"])
            owner.call("POST", "/v1/keys", json={"key": owner_keys[number]})
            made = owner.embed(encode_model(read_model(SCENE).model, "splat"), profile="fast")
            Client(served.address, token["uploader"]).call("POST", "/v1/keys", json={"key": owner_keys[2]})
            if number == 0:
                owner.download(made.asset_id, model)
        lines = [
            httpx.Client(base_url=served.address, headers={"Authorization": f"Bearer {token['uploader']}"}, timeout=600)
            for served, token in zip(services, tokens, strict=True)
        ]
        random, seen, labels, blocks = np.random.default_rng(args.seed), [], [], []
        for block in range(args.questions // (2 * BLOCK)):
            uploads = [_changed(model.read_bytes(), random) for _ in range(BLOCK)]
            for which in random.permutation(2):
                for data in uploads:
                    seen.append(_question(lines[which], data))
                    labels.append(int(which == 0))
                    blocks.append(block)
        told = [len(Client(s.address, t["owner"]).notices()) for s, t in zip(services, tokens, strict=True)]
    finally:
        for served in services:
            served.stop()
    names = list(seen[0])
    table, label = np.array([[row[name] for name in names] for row in seen]), np.array(labels)
    scores = _cross_validated(table, label, np.array(blocks))
    single = {name: _auc(table[:, k], label) for k, name in enumerate(names)}
    return {"questions": len(seen), "auc": _auc(scores, label), "auc_of_each": single, "notices": told}


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
    while job["state"] not in FINAL:
        time.sleep(0.02)
        job, looks = line.get(f"/v1/jobs/{job['id']}").json(), looks + 1
        states.add(f"{job['state']} {job['stage']}")
    at = [time.mktime(time.strptime(job[f"{name}_at"][:19], "%Y-%m-%dT%H:%M:%S")) for name in ("created", "finished")]
    exact = [float(job[f"{name}_at"][17:26]) for name in ("created", "started", "finished")]
    result = job["result"] or {}
    numbers = {name: float(result.get(name, -1)) for name in ("psnr_worst_view", "ssim_worst_view", "gaussians")}
    asset = line.get(f"/v1/assets/{result.get('asset_id')}")
    return numbers | {
        "status": float(answer.status_code),
        "succeeded": float(job["state"] == "succeeded"),
        "size": float(len(json.dumps(job)) - len(str(result.get("seconds"))) - sum(map(len, _floats(result)))),
        "members": float(len(result)),
        "asset_size": float(len(json.loads(asset.text))),
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
    return [str(result[name]) for name in ("psnr_worst_view", "ssim_worst_view") if name in result]


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
