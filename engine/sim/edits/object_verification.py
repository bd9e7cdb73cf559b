"""Which records a file of many objects carries, and where: nothing but the flat file is needed."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from engine.errors import InputError
from engine.model import Float64, GaussianModel, Int32, Int64
from engine.numerics.umeyama import Similarity
from engine.pipeline.judging import VerifyConfig, judge
from engine.pipeline.reading import read_gaussians
from engine.pipeline.sealing import OpenedRecord
from engine.pipeline.searching import count_tries
from engine.registration.index import ReferenceIndex
from engine.registration.registering import Registration, register
from engine.sim.edits.objects import FlatScene
from engine.sim.edits.pieces import LEAST_PIECE, RIGID, check_route
from engine.watermark.claim import Claim

__all__ = ["ObjectFinding", "verify_objects"]


@dataclass(frozen=True, eq=False)
class ObjectFinding:
    """One record, looked for in a file: found or not, marked or not, and where."""

    record: str
    instance: int  # 0 for the first place at which the record's asset was found, then 1, ...
    claim: Claim
    rows: Int64  # (n,) Gaussians of the file that are the asset's; empty if nothing of it was found
    file_share: float  # n over the file's Gaussians
    asset_share: float  # share of the asset's Gaussians found
    placement: Similarity | None  # x_file = scale * R @ x_asset + t
    low: Float64 | None  # (3,) corners of the box of the 1 % to 99 % quantiles of the matched centres
    high: Float64 | None
    # with a known scene: its objects that hold those Gaussians, and their shares of them, largest first
    objects: tuple[tuple[str, float], ...]


def verify_objects(
    suspect: GaussianModel | FlatScene,
    records: Mapping[str, OpenedRecord],
    config: VerifyConfig | None = None,
    *,
    instances: int = 1,
) -> list[ObjectFinding]:
    """Look for every record in a file that may hold many objects, moved, turned and scaled each in its own way.

    Parameters
    ----------
    suspect : GaussianModel or FlatScene
        A FlatScene adds which of its objects the finds lie in; the search is the same.
    config : VerifyConfig, optional
        Route "auto" or "model": pieces of a file are read by their Gaussians.
    instances : int
        Times one asset is looked for in the file; a search that finds nothing ends the record's list.

    Returns
    -------
    list of ObjectFinding
        In the order of the records; one for every record at least. Every claim counts
        len(records) * instances tries.
    """
    config = config or VerifyConfig()
    model = suspect.model if isinstance(suspect, FlatScene) else suspect
    if not len(model):
        raise InputError("the suspect model is empty")
    if not records:
        raise InputError("no record was given")
    check_route(config, "file; objects are")
    if instances < 1:
        raise InputError(f"an asset is looked for at least once, got instances {instances}")
    tries = count_tries(len(records), ("model",), config, places=instances)
    findings = []
    for name, opened in records.items():
        index = ReferenceIndex(opened.reference)
        left = np.arange(len(model), dtype=np.int64)
        for instance in range(instances):
            # What earlier instances matched is set aside by geometry and unmarked looks alone: no chip enters.
            part = model.take(left) if instance else model
            found = register(index, part, seed=config.seed, config=RIGID)
            if instance and not found.found:
                break
            claim = judge(read_gaussians(part, opened, found), opened, "model", tries, config, found)
            rows = left[found.matches >= 0]
            finding = _finding(name, instance, claim, found, rows, model)
            if isinstance(suspect, FlatScene):
                finding = replace(finding, objects=_shares(suspect.owner[rows], suspect.names))
            findings.append(finding)
            left = left[found.matches < 0]
            if not found.found or len(left) < LEAST_PIECE:
                break
    return findings


def _finding(
    name: str, instance: int, claim: Claim, found: Registration, rows: Int64, model: GaussianModel
) -> ObjectFinding:
    if not len(rows):
        return ObjectFinding(name, instance, claim, rows, 0.0, 0.0, None, None, None, ())
    low, high = np.quantile(model.means[rows].astype(np.float64), [0.01, 0.99], axis=0)
    shares = len(rows) / len(model), found.derived_fraction
    return ObjectFinding(name, instance, claim, rows, *shares, found.similarity.inverse(), low, high, ())


def _shares(owner: Int32, names: tuple[str, ...]) -> tuple[tuple[str, float], ...]:
    counts = np.bincount(owner, minlength=len(names))
    order = np.argsort(-counts, kind="stable")
    return tuple((names[k], float(counts[k] / counts.sum())) for k in order if counts[k])
