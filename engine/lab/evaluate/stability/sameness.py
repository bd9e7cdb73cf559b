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

from engine.flows.verify.search import VerifyConfig, verify_images, verify_model
from engine.formats import encode_model, read_model
from engine.lab.evaluate.marked_subjects import fast_mark
from engine.lab.evaluate.stability.odd_inputs import claim_digest
from engine.lab.evaluate.stability.sweeps import picture_at_key_view
from engine.lab.evaluate.study import Row
from engine.lab.sim.suite import Trial, apply_chain
from engine.model import Float32, GaussianModel

__all__ = ["compare_machines", "compare_precision", "write_claims"]

STOLEN = Trial("stolen", (("crop", 0.5), ("similarity", 3.0), ("shuffle", 1.0), ("noise_all", 0.02)), "own")
"""What the suspect went through: enough for every stage of the verification to have work."""
PLAIN = {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": "", "OPENBLAS_CORETYPE": "Prescott"}
"""A processor without AVX, played by the compiler and by OpenBLAS."""
CLOSE = 1e-3
"""Relative difference of z between processors that still counts as the same answer."""


def write_claims(path: str, quick: bool, seed: int, out: str) -> None:
    """Mark, steal, verify by model and by picture; write what came out, to the last digit, to a JSON file."""
    scene = fast_mark(path, quick, seed)
    model = verify_model(apply_chain(scene.marked, STOLEN, seed), scene.opened, VerifyConfig(route="model")).claim
    camera, picture = picture_at_key_view(scene)
    image = verify_images([picture], scene.opened, cameras=[camera]).claim
    said = {
        "marked_digest": hashlib.sha256(scene.marked.sh.tobytes()).hexdigest()[:16],
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
    settings = {"one thread": one, "two threads": {**one, "NUMBA_NUM_THREADS": "2"}}
    if not quick:
        settings["two threads, and two of BLAS"] = {"NUMBA_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2"}
        settings["processor without AVX"] = {**one, **PLAIN}
    return _compared({name: _in_child(path, quick, seed, variables) for name, variables in settings.items()})


def _compared(answers: dict[str, Row]) -> list[Row]:
    """Each compared with the first: the same bytes; or the same verdict and bits, and nearly the same z."""
    first = next(iter(answers.values()))
    rows: list[Row] = []
    for name, said in answers.items():
        exact = all(first[key] == value for key, value in said.items() if key.endswith("digest"))
        same = all(first[key] == value for key, value in said.items() if key.startswith(("verdicts", "bits")))
        near = all(abs(first[k] - z) <= CLOSE * abs(first[k]) for k, z in said.items() if k.startswith("z_"))
        rows.append({"what": "same", "how": name, "exact": exact, "close": same and near, **said})
    return rows


def _in_child(path: str, quick: bool, seed: int, variables: dict[str, str]) -> Row:
    code = f"import sys, json; from {__name__} import write_claims; write_claims(*json.loads(sys.argv[1]))"
    with tempfile.TemporaryDirectory() as folder:
        out = str(Path(folder) / "claims.json")
        own = {"NUMBA_CACHE_DIR": str(Path(folder) / "numba")} if "NUMBA_CPU_NAME" in variables else {}
        child = [sys.executable, "-c", code, json.dumps([path, quick, seed, out])]
        subprocess.run(child, check=True, env={**os.environ, **variables, **own})
        said: Row = json.loads(Path(out).read_text())
        return said


def compare_precision(path: str, quick: bool, seed: int) -> list[Row]:
    """Verified again, from a float64 file, one rounding step off in every number, and under other seeds."""
    scene = fast_mark(path, quick, seed)
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
    answers: dict[str, Row] = {}
    for name, (suspect, number) in variants.items():
        claim = verify_model(suspect, scene.opened, VerifyConfig(route="model", seed=number)).claim
        answers[name] = {"model_digest": claim_digest(claim), "z_model": claim.z, "bits_model": claim.message}
        answers[name]["verdicts"] = [claim.verdict.value]
    return _compared(answers)


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
    rotations, scales = (f"rot_{k}" for k in range(4)), (f"scale_{k}" for k in range(3))
    colors = [*(f"f_dc_{k}" for k in range(3)), *(f"f_rest_{k}" for k in range(rest.shape[1]))]
    names = ["x", "y", "z", *colors, "opacity", *scales, *rotations]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(model)}"]
    header += [*(f"property double {name}" for name in names), "end_header", ""]
    return "\n".join(header).encode() + np.concatenate(columns, axis=1).astype("<f8").tobytes()
