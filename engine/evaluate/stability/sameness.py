"""The same claim each time: twice, by one thread or two, on a plainer processor, from float64, under other seeds.

Numba fixes the number of its threads and the processor it compiles for when it is loaded, so children do the work.
"""

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from engine.evaluate.bench.attacks import to_8_bit
from engine.evaluate.marked_scene import mark_scene
from engine.evaluate.stability.stressing import claim_digest
from engine.evaluate.stability.subjects import config_of, subjects
from engine.evaluate.study import Row
from engine.formats import encode_model, read_model
from engine.model import Float32, GaussianModel
from engine.pipeline.verification import VerifyConfig, verify_images, verify_model
from engine.raster import render
from engine.sim.suite import Trial, apply_chain

__all__ = ["compare_machines", "compare_precision", "write_claims"]

STOLEN = Trial("stolen", (("crop", 0.5), ("similarity", 3.0), ("shuffle", 1.0), ("noise_all", 0.02)), "own")
"""What the suspect went through: enough for every stage of the verification to have work."""
PLAIN = {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": "", "OPENBLAS_CORETYPE": "Prescott"}
"""A processor without AVX, played by the compiler and by OpenBLAS."""
CLOSE = 1e-3
"""Relative difference of z between processors that still counts as the same answer."""


def write_claims(path: str, quick: bool, seed: int, out: str) -> None:
    """Mark, steal, verify by model and by picture; write what came out, to the last digit, to a JSON file."""
    scene = mark_scene(path, config_of(quick), seed=seed)
    model = verify_model(apply_chain(scene.marked, STOLEN, seed), scene.opened, VerifyConfig(route="model")).claim
    camera = scene.opened.cameras[0].resized(400, 400)
    picture = to_8_bit(render(scene.marked, camera))
    image = verify_images([picture], scene.opened, cameras=[camera]).claim
    marked = hashlib.sha256(scene.marked.sh.tobytes()).hexdigest()[:16]
    said = {
        "marked_digest": marked,
        "record": scene.opened.header.record_id[:16],
        "model_digest": claim_digest(model),
        "image_digest": claim_digest(image),
        "z_model": model.z,
        "z_image": image.z,
        "bits_model": model.message,
        "bits_image": image.message,
        "verdicts": [model.verdict.value, image.verdict.value],
    }
    Path(out).write_text(json.dumps(said))


def compare_machines(path: str, quick: bool, seed: int) -> list[Row]:
    """The whole way in child processes: one thread, two, and (not in a quick run) a processor without AVX.

    Every child marks anew, so that records and marked models are compared, too.
    """
    one = {"NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    settings: dict[str, dict[str, str]] = {"one thread": one, "two threads": {**one, "NUMBA_NUM_THREADS": "2"}}
    if not quick:
        settings["two threads, and two of BLAS"] = {"NUMBA_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2"}
        settings["processor without AVX"] = {**one, **PLAIN}
    rows: list[Row] = []
    for name, variables in settings.items():
        said = _in_child(path, quick, seed, variables)
        first = rows[0] if rows else said
        exact = all(first[key] == value for key, value in said.items() if key.endswith("digest"))
        close = first["verdicts"] == said["verdicts"] and all(
            first[f"bits_{route}"] == said[f"bits_{route}"]
            and abs(first[f"z_{route}"] - said[f"z_{route}"]) <= CLOSE * abs(first[f"z_{route}"])
            for route in ("model", "image")
        )
        rows.append({"what": "same", "how": name, "exact": exact, "close": close, **said})
    return rows


def _in_child(path: str, quick: bool, seed: int, variables: dict[str, str]) -> Row:
    with tempfile.TemporaryDirectory() as folder:
        out = str(Path(folder) / "claims.json")
        code = (
            "import sys, json; from engine.evaluate.stability.sameness import write_claims; "
            "write_claims(*json.loads(sys.argv[1]))"
        )
        own = {"NUMBA_CACHE_DIR": str(Path(folder) / "numba")} if "NUMBA_CPU_NAME" in variables else {}
        subprocess.run(
            [sys.executable, "-c", code, json.dumps([path, quick, seed, out])],
            check=True,
            env={**os.environ, **variables, **own},
        )
        said: Row = json.loads(Path(out).read_text())
        return said


def compare_precision(path: str, quick: bool, seed: int) -> list[Row]:
    """Verified again, from a float64 file, one rounding step off in every number, and under other seeds."""
    scene = subjects(path, 1, quick, seed).trials[0]
    stolen: GaussianModel = apply_chain(scene.marked, STOLEN, seed)
    rng = np.random.default_rng(seed)
    plain = read_model(encode_model(stolen, "ply"), name="stolen.ply").model
    variants: dict[str, tuple[GaussianModel, int]] = {
        "the first time": (plain, 0),
        "again": (plain, 0),
        "from a float64 file": (read_model(double_ply(stolen), name="double.ply").model, 0),
        "every number one float32 step off": (_nudged(plain, rng), 0),
        **{f"seed {k} of the registration": (plain, k) for k in range(1, 2 if quick else 5)},
    }
    rows: list[Row] = []
    first: str | None = None
    for name, (suspect, number) in variants.items():
        claim = verify_model(suspect, scene.opened, VerifyConfig(route="model", seed=number)).claim
        digest = claim_digest(claim)
        first = first or digest
        z = rows[0]["z_model"] if rows else claim.z
        alike = not rows or (rows[0]["bits_model"], rows[0]["verdicts"]) == (claim.message, [claim.verdict.value])
        rows.append(
            {
                "what": "same",
                "how": name,
                "exact": digest == first,
                "model_digest": digest,
                "close": alike and abs(claim.z - z) <= CLOSE * abs(z),
                "z_model": claim.z,
                "bits_model": claim.message,
                "verdicts": [claim.verdict.value],
            }
        )
    return rows


def _nudged(model: GaussianModel, rng: np.random.Generator) -> GaussianModel:
    def nudge(array: Float32) -> Float32:
        toward = np.where(rng.random(array.shape) < 0.5, -np.inf, np.inf).astype(np.float32)
        return np.nextafter(array, toward).astype(np.float32)

    names = ("means", "log_scales", "quats", "opacity_logits", "sh")
    return model.with_(**{name: nudge(getattr(model, name)) for name in names})


def double_ply(model: GaussianModel) -> bytes:
    """A PLY of the model whose properties are all float64, as some trainers write."""
    rest = model.sh[:, 1:].transpose(0, 2, 1).reshape(len(model), -1)  # channel-major
    columns = [model.means, model.sh[:, 0], rest, model.opacity_logits[:, None], model.log_scales, model.quats]
    names = [
        "x",
        "y",
        "z",
        "f_dc_0",
        "f_dc_1",
        "f_dc_2",
        *(f"f_rest_{k}" for k in range(rest.shape[1])),
        "opacity",
        "scale_0",
        "scale_1",
        "scale_2",
        "rot_0",
        "rot_1",
        "rot_2",
        "rot_3",
    ]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(model)}"]
    header += [*(f"property double {name}" for name in names), "end_header", ""]
    return "\n".join(header).encode() + np.concatenate(columns, axis=1).astype("<f8").tobytes()
