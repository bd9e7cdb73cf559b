"""Models that no training gives and some user will upload: each is to be marked and verified, or refused in words.

They go the whole way, from a file: mark, open the record, verify twice; and as suspects of a sound record. Each either
answers the same each time or is refused in words; a `RuntimeWarning` counts as a fault.
"""

import hashlib
import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from engine.errors import Mark3DGSError
from engine.flows.embed.embedding import embed
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.flows.verify.search import VerifyConfig, verify_model
from engine.formats import encode_model, read_model
from engine.lab.evaluate.marked_scene import bench_key
from engine.lab.evaluate.marked_subjects import fast_config, fast_mark
from engine.lab.evaluate.study import Row
from engine.lab.sim.attacks import model_attack
from engine.model import Float32, GaussianModel
from engine.watermark.claim import Claim
from engine.watermark.rates import MADE_FIRST

__all__ = ["ODD", "QUICK", "claim_digest", "stress"]

Make = Callable[[GaussianModel], GaussianModel]

FEW = (1, 2, 10, 63, 64, 100)
"""Numbers of Gaussians, about the least that a mark needs (64)."""
LARGEST = float(np.finfo(np.float32).max)
DENORMAL = np.float32(1e-42)
PIECE = 0.2
"""Connected share of the scene that odd inputs are made of."""
BITS = 16


def _few(count: int) -> Make:
    return lambda model: model.take(np.linspace(0, len(model) - 1, count).astype(np.int64))


def _moved(field: str, by: float) -> Make:
    return lambda model: model.with_(**{field: getattr(model, field) + np.float32(by)})


def _opacities(logit: float) -> Make:
    return lambda model: model.with_(opacity_logits=np.full(len(model), logit, dtype=np.float32))


def _changed(field: str, change: Callable[[Float32], None]) -> Make:
    def make(model: GaussianModel) -> GaussianModel:
        array = getattr(model, field).copy()
        change(array)
        return model.with_(**{field: array})

    return make


def _extremes(field: str, high: float = LARGEST, low: float = -LARGEST, step: int = 100) -> Make:
    """The two numbers alternate with a hundred sound ones, or less."""

    def change(array: Float32) -> None:
        array[::step] = high
        array[1::100] = low

    return _changed(field, change)


def _needles(log_scales: Float32) -> None:
    log_scales[:, 1:] = log_scales[:, :1] - np.float32(12.0)


def _discs(log_scales: Float32) -> None:
    log_scales[:, 2] = log_scales[:, :2].min(axis=1) - np.float32(12.0)


def _on_a_line(means: Float32) -> None:
    means[:, 1:] = 0.0


def _one_color(sh: Float32) -> None:
    sh[:] = 0.0
    sh[:, 0] = 0.3


ODD: dict[str, Make] = {
    **{f"{count} Gaussians": _few(count) for count in FEW},
    "all identical": lambda model: model.take(np.zeros(5_000, dtype=np.int64)),
    "all transparent": _opacities(-20.0),
    "all opaque": _opacities(80.0),
    "scales x 1e4": _moved("log_scales", 9.2),
    "scales x 1e-8": _moved("log_scales", -18.4),
    "needles": _changed("log_scales", _needles),
    "discs": _changed("log_scales", _discs),
    "coincident centres": lambda m: m.with_(means=np.broadcast_to(np.median(m.means, axis=0), m.means.shape)),
    "every Gaussian twice": lambda model: model.take(np.repeat(np.arange(len(model)), 2)),
    "centres on a line": _changed("means", _on_a_line),
    "1e3 from the origin": _moved("means", 1e3),
    "1e6 from the origin": _moved("means", 1e6),
    "1e30 from the origin": _moved("means", 1e30),
    "one colour": _changed("sh", _one_color),
    "no SH above DC": lambda model: model.with_(sh=model.sh[:, :1]),
    "float32 extremes: scales": _extremes("log_scales", 88.0, -100.0),  # exp(88) is close to float32's largest number
    "float32 extremes: centres": _extremes("means"),
    "float32 extremes: colours": _extremes("sh"),
    "float32 extremes: opacities": _extremes("opacity_logits", step=2),
    "float32 extremes: denormals": lambda model: model.with_(
        means=model.means * DENORMAL, log_scales=model.log_scales - np.float32(96.0)
    ),
}
"""Name of each odd input, and how it is made of a real piece of a scene."""

QUICK = ("10 Gaussians", "100 Gaussians", "all transparent", "coincident centres", "1e6 from the origin")
"""Those of a quick run."""


def claim_digest(claim: Claim) -> str:
    """Of everything a claim says, to the last digit."""
    return hashlib.sha256(json.dumps(claim.to_json(), sort_keys=True).encode()).hexdigest()[:16]


def stress(path: str, names: list[str], quick: bool, seed: int) -> list[Row]:
    """One row for each odd input marked, one for each as a suspect, and two for an empty crop and one key view."""
    piece = model_attack("crop").apply(read_model(path).model, PIECE, rng=seed)
    sound = fast_mark(path, True, seed)

    def as_marked(make: Make) -> Row:
        return _mark_and_verify(make(piece), 3, seed)

    def as_suspect(make: Make) -> Row:
        return _verify_twice(_filed(make(sound.marked)), sound.opened)

    rows = []
    for name in names:
        rows.append(_row("marked", name, partial(as_marked, ODD[name])))
        rows.append(_row("suspect", name, partial(as_suspect, ODD[name])))
    if not quick:
        rows.append(_row("marked", "one key view", partial(_mark_and_verify, piece, 1, seed)))
    empty = sound.marked.take(np.zeros(0, dtype=np.int64))
    rows.append(_row("suspect", "empty crop", partial(_verify_twice, empty, sound.opened)))
    return rows


def _row(role: str, name: str, work: Callable[[], Row]) -> Row:
    about = {"what": "stress", "role": role, "input": name}
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            return {**about, **work()}
        except Mark3DGSError as refusal:
            return {**about, "outcome": "refused", "words": str(refusal)}
        except Exception as fault:  # a study reports what a program should not do
            return {**about, "outcome": "fault", "words": f"{type(fault).__name__}: {fault}"}


def _filed(model: GaussianModel) -> GaussianModel:
    """What reading a file of it gives: repaired where that is harmless."""
    return read_model(encode_model(model, "ply"), name="odd.ply").model


def _mark_and_verify(model: GaussianModel, views: int, seed: int) -> Row:
    key, config = bench_key(seed), replace(fast_config(True), views=views)
    result = embed(_filed(model), key, original_sha256="00" * 32, bits=BITS, config=config)
    opened = open_record(result.record.to_bytes(key), key, MADE_FIRST)
    row = _verify_twice(_filed(result.model), opened)
    unmarked = verify_model(_filed(model), opened, VerifyConfig(route="model")).claim
    row["unmarked_verdict"] = unmarked.verdict.value
    sound = row["verdict"] == "marked" and unmarked.verdict.value != "marked"
    if row["outcome"] == "same" and not sound:
        row |= {"outcome": "fault", "words": f"own mark: {row['verdict']}, without: {row['unmarked_verdict']}"}
    return row


def _verify_twice(suspect: GaussianModel, opened: OpenedRecord) -> Row:
    first, second = (verify_model(suspect, opened, VerifyConfig(route="model")).claim for _ in range(2))
    same = claim_digest(first) == claim_digest(second)
    return {
        "outcome": "same" if same else "fault",
        "words": "" if same else "two claims differ",
        "verdict": first.verdict.value,
        "z": first.z,
        "bits": first.bit_accuracy,
        "derived_fraction": first.derived_fraction,
    }
