"""Mark scenes, take pictures of them in real viewers, read them: how many claim, by what was done to them.

    python -m tests.viewers.measure --scenes plant.splat tarot.splat --pictures 20 --seed 0 --out out/viewers

Cameras, focal lengths, backgrounds, tone curves, rolls and files are drawn from the seed. Writes every picture's row
and the sums as JSON, and a contact sheet of what was not claimed. Needs Chromium, ffmpeg, and once npm for the viewers.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from PIL import Image, ImageDraw

from engine.flows.embed.profiles import profile
from engine.flows.verify.search import VerifyConfig, verify_images
from engine.formats import write_model
from engine.lab.evaluate.intervals import share_interval
from engine.lab.evaluate.marked_scene import MarkedScene, mark_scene
from engine.model import Float32
from tests.viewers.shooting import VIEWERS, fetch_viewers, studio
from tests.viewers.taking import COUNTS, Taken, take

THUMBNAIL, ACROSS = 240, 6
"""Pixels of a picture on the contact sheet, and pictures in a row of it."""
FOREIGN = 3
"""Every so many pictures are held against another scene's record, too."""
TOGETHER = 3
"""Pictures that are read together."""


def main() -> None:
    """Take, read, sum."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", type=Path, required=True)
    parser.add_argument("--pictures", type=int, default=20, help="of each scene (default 20)")
    parser.add_argument("--viewer", choices=[name for name in VIEWERS if name != "three"], default="supersplat")
    parser.add_argument("--counting", action="store_true", help="only pictures that count")
    files = "every picture as each of these files, e.g. png 'jpeg 80' 'small, jpeg 70'; the first is the yardstick"
    parser.add_argument("--files", nargs="+", default=[], help=files)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True, help="folder for results.json and failures.png")
    options = parser.parse_args()
    if not fetch_viewers():
        raise SystemExit("the viewers could not be fetched: is there npm, and a registry?")
    options.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    failures: list[tuple[str, Float32]] = []
    before: MarkedScene | None = None
    for scene in options.scenes:
        marked = mark_scene(scene, profile("fast"))
        file = f"{scene.name.split('.')[0]}.ply"
        write_model(marked.marked, options.out / file)
        taken: list[Taken] = []
        with studio(options.out) as booth:
            for number in range(options.pictures):
                least = {"least": COUNTS} if options.counting else {}
                shown = take(booth, marked.marked, file, drawn(options.seed, scene, number), options.viewer, **least)
                for kind in options.files or [shown.tags["file"]]:
                    each = shown.as_file(kind)
                    row = {"scene": scene.name, "picture": number, **_told(each), **_read(marked, [each.picture])}
                    if before is not None and number % FOREIGN == 0:  # the picture of another scene
                        row["foreign"] = _read(before, [each.picture])
                    rows.append(row)
                    sys.stdout.write(json.dumps(row) + "\n")
                    if not row["marked"]:
                        name = f"{scene.name} {number} z {row['z']:.1f}{'' if row['counts'] else ' (small)'}"
                        failures.append((name, each.picture))
                    if not options.files:
                        taken.append(each)
        counting = [each.picture for each in taken if each.counts]
        for first in range(0, len(counting) - TOGETHER + 1, TOGETHER):
            three = _read(marked, counting[first : first + TOGETHER])
            rows.append({"scene": scene.name, "together": TOGETHER, **three})
        before = marked
    (options.out / "results.json").write_text(json.dumps({"sums": sums(rows), "rows": rows}, indent=1))
    _contact_sheet(failures, options.out / "failures.png")
    sys.stdout.write(json.dumps(sums(rows), indent=1) + "\n")


def drawn(seed: int, scene: Path, number: int) -> tuple[int, ...]:
    """The seed of a scene's picture: of no two scenes the same views, backgrounds and files."""
    return seed, crc32(scene.name.encode()), number


def _told(taken: Taken) -> dict[str, Any]:
    return {**taken.tags, "seen": round(taken.seen, 3), "filled": round(taken.filled, 3), "counts": taken.counts}


def _read(scene: MarkedScene, pictures: Sequence[Float32]) -> dict[str, Any]:
    started = time.perf_counter()
    claim = verify_images(pictures, scene.opened, VerifyConfig()).claim
    seconds = round(time.perf_counter() - started, 2)
    recognised = bool(claim.derivation.derived)
    return {"marked": claim.verdict.value == "marked", "z": claim.z, "recognised": recognised, "seconds": seconds}


def sums(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Claims of pictures that count, of all, by each way they differ, of three together, and of foreign pictures."""
    single = [row for row in rows if "together" not in row]
    counting = [row for row in single if row["counts"]]
    result: dict[str, Any] = {"counting": _share(counting), "all": _share(single)}
    for tag in ("scene", "background", "tone", "roll", "hand", "file", "interface", "size", "antialiasing", "viewer"):
        values = sorted({row[tag] for row in counting})
        result[tag] = {value: _share([row for row in counting if row[tag] == value]) for value in values}
    if len(single) > len({(row["scene"], row["picture"]) for row in single}):  # several files of each picture
        result["kept"] = {file: _kept(counting, file) for file in result["file"]}
    result["three together"] = _share([row for row in rows if "together" in row])
    foreign = [row["foreign"] for row in single if "foreign" in row]
    result["foreign"] = _share(foreign) | {"recognised": sum(row["recognised"] for row in foreign)}
    spent = [row["seconds"] for row in single]
    result["seconds"] = {"median": float(np.median(spent)), "largest": float(max(spent))}
    return result


def _kept(rows: Sequence[dict[str, Any]], file: str) -> float:
    """Median share of the first file's z that this kind of file of the same pictures keeps."""
    first: dict[tuple[Any, ...], float] = {}
    for row in rows:
        first.setdefault((row["scene"], row["picture"]), row["z"])
    shown = [(row["z"], first[row["scene"], row["picture"]]) for row in rows if row["file"] == file]
    own = [z / whole for z, whole in shown if whole > 0] or [0.0]
    return round(float(np.median(own)), 3)


def _share(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    claimed = sum(row["marked"] for row in rows)
    low, high = share_interval(claimed, len(rows)) if rows else (0.0, 1.0)
    return {"claims": claimed, "of": len(rows), "95 %": [round(low, 3), round(high, 3)]}


def _contact_sheet(pictures: Sequence[tuple[str, Float32]], path: Path) -> None:
    if not pictures:
        return
    cell = THUMBNAIL + 16
    sheet = Image.new("RGB", (ACROSS * THUMBNAIL, -(-len(pictures) // ACROSS) * cell), (60, 60, 60))
    draw = ImageDraw.Draw(sheet)
    for number, (name, picture) in enumerate(pictures):
        x, y = number % ACROSS * THUMBNAIL, number // ACROSS * cell
        small = Image.fromarray(np.round(255.0 * picture).astype(np.uint8))
        small.thumbnail((THUMBNAIL - 4, THUMBNAIL - 4))
        sheet.paste(small, (x, y + 14))
        draw.text((x, y), name, fill=(255, 255, 255))
    sheet.save(path)


if __name__ == "__main__":
    main()
