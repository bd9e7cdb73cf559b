"""What `verify --regions` writes and says: where on the asset the mark is, and each piece of it in the suspect."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from engine.usecases.files import whole_folder

if TYPE_CHECKING:
    from engine.flows.records.opened_record import OpenedRecord
    from engine.flows.regions.region_search import RegionReport
    from engine.flows.verify.search import Suspect, Verification


def write_regions(
    folder: Path, report: RegionReport, suspect: Suspect, opened: OpenedRecord, found: Verification
) -> None:
    """The map, the numbers and the indices, in a new folder.

    `regions.npz`: of each Gaussian of the suspect model, in its order, `piece` and `region` (-1: nothing of the asset)
    and `state`; of each of the asset's, in its record's order, `asset_state`; `states` names what the numbers mean.
    """
    import numpy as np

    from engine.flows.regions.region_search import describe
    from engine.present.region_maps import draw_report
    from engine.watermark.regions import State

    with whole_folder(folder) as part:
        draw_report(report, suspect, opened, found).save(part / "regions.png")
        (part / "regions.json").write_text(json.dumps(describe(report, opened), indent=1))
        piece, region, state = report.of_suspect
        names = np.array([each.name.lower() for each in State])
        rows = {"piece": piece, "region": region, "state": state, "asset_state": report.states, "states": names}
        np.savez_compressed(part / "regions.npz", allow_pickle=False, **rows)


def region_lines(report: RegionReport, folder: str) -> Iterator[str]:
    """For people."""
    summary = report.summary()
    yield ""
    wrong = f" (at most {100 * report.false_discoveries:.2g} % of them expected not to be)" if summary["marked"] else ""
    others = ", ".join(f"{summary[name]} {name}" for name in ("altered", "unclear", "unseen"))
    yield f"Regions: {summary['marked']} marked{wrong}, {others}"
    for number, piece in enumerate(report.pieces):
        placed = piece.registration
        if placed is None:
            continue
        moved = ", ".join(f"{x:.4g}" for x in placed.t)
        hand = ", mirrored" if placed.mirrored else ""
        yield (
            f"  piece {number + 1}  {placed.derived_fraction:.0%} of the asset, {len(piece.rows[0]):,} Gaussians of the"
            f" suspect, z = {piece.z:.1f}, scale {placed.scale:.4g}, moved by ({moved}){hand}"
        )
    if not report.claimed:
        yield "  The claim is not made: regions are no proof by themselves."
    yield f"  {folder}/regions.png, regions.json, regions.npz"
