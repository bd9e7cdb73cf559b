"""`mark3dgs demo`: the main job on a real scene, step by step."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from engine.cli.console import Console, Progress, claim_lines
from engine.cli.embed import size
from engine.cli.kernel_progress import prepare_kernels
from engine.cli.options import Json
from engine.errors import InputError, WrongKeyError
from engine.lab.cli.shared import shipped_scene
from engine.usecases.files import check_target, whole_file, write_picture, write_secret
from engine.usecases.verify import VerifyReport

if TYPE_CHECKING:
    from engine.flows.embed.embedding import Embedding
    from engine.flows.records.opened_record import OpenedRecord
    from engine.flows.verify.search import Verification
    from engine.model import Camera, Float32, GaussianModel
    from engine.present.wording import Words
    from engine.watermark.keys import OwnerKey


SEED = 1
SCREENSHOT_SIZE = (800, 600)
SCREENSHOT_QUALITY = 80
VIEW, ZOOM = 5, 0.8  # view of the rig in the picture, and how much of its focal length: room around the subject

STOLEN = "stolen-piece.spz"


@dataclass(frozen=True)
class _Work:
    """What the steps share."""

    console: Console
    progress: Progress
    folder: Path
    owner: OwnerKey


def demo(
    model: Annotated[
        Path | None, typer.Argument(metavar="MODEL", help="Model to mark (default: the scene of the repository).")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder for all files.")] = Path("demo-out"),
    json: Json = False,
) -> int:
    """Mark a real captured scene, attack it in several ways, verify every suspect.

    About a minute on two cores, once the kernels are compiled. All files go
    to one folder: key, marked model, record, stolen copies and a picture.

    Example:

      mark3dgs demo --out demo-out
    """
    from engine.present.numerals import PLAIN
    from engine.present.wording import words_of

    console = Console(json)
    began = time.perf_counter()
    scene = model if model is not None else shipped_scene()
    if out.exists() and not out.is_dir():
        raise InputError(f"{str(out)!r} is no folder")
    out.mkdir(parents=True, exist_ok=True)
    check_target(out / "demo.png")
    with console.progress() as progress:
        prepare_kernels(console, progress, "main")
        work = _Work(console, progress, out, _owner_key(console, out / "owner.key"))
        original, made, opened = _mark(work, scene)
        outcomes = _trials(work, original, made.model, opened)
        outcomes["another key"] = _wrong_key(work)
        progress("picture", 0.0)
        words = words_of(outcomes["piece"], PLAIN, suspect=STOLEN)
        _picture(out / "demo.png", scene.name, original, made, words)
    expected = {
        "moved": "marked",
        "piece": "marked",
        "screenshot": "marked",
        "unmarked": "not_marked",
        "another key": "wrong_key",
    }
    found = {name: outcome["verdict"] for name, outcome in outcomes.items()}
    console.say("")
    for line in claim_lines(words):
        console.say(line)
    console.say("")
    console.say(f"{time.perf_counter() - began:.0f} s in all. Look at {out / 'demo.png'}; try it yourself:")
    console.say(f"  mark3dgs verify {out / STOLEN} --record {out / 'scene.record'} --key {out / 'owner.key'}")
    console.emit(
        {
            "scene": str(scene),
            "embedding": made.report,
            "outcomes": outcomes,
            "as_expected": found == expected,
            "picture": str(out / "demo.png"),
            "seconds": time.perf_counter() - began,
        }
    )
    return 0 if found == expected else 4


def _owner_key(console: Console, path: Path) -> OwnerKey:
    from engine.watermark.keys import OwnerKey

    if path.exists():  # a key is never overwritten, not even here
        owner = OwnerKey.read(path)
        console.say(f"1. The owner's key: {owner.fingerprint}, from an earlier demo ({path}).")
    else:
        owner = OwnerKey.generate()
        owner.write(path)
        console.say(f"1. The owner makes a key: {owner.fingerprint} ({path}).")
    return owner


def _mark(work: _Work, scene: Path) -> tuple[GaussianModel, Embedding, OpenedRecord]:
    from engine.flows.embed.embedding import embed
    from engine.flows.embed.profiles import profile
    from engine.flows.records.opened_record import open_record
    from engine.formats import read_model, write_model

    work.progress("read", 0.0)
    loaded = read_model(scene)
    work.console.say(
        f"2. {scene.name}: a captured scene of {len(loaded.model):,} Gaussians, {size(loaded.source_bytes)}."
    )
    made = embed(
        loaded.model,
        work.owner,
        original_sha256=loaded.sha256,
        config=profile("fast"),
        copy="demo",
        progress=work.progress,
    )
    sealed = made.record.to_bytes(work.owner)
    with whole_file(work.folder / "scene.record") as part:
        write_secret(part, sealed)
    with whole_file(work.folder / "marked.ply") as part:
        write_model(made.model, part, "ply")
    report = made.report
    work.console.say(
        f"3. Marked in {report['seconds']:.1f} s with {report['bits']} bits ({report['message']});"
        f" the mark is invisible: {report['psnr_worst_view']:.1f} dB in the worst view."
    )
    return loaded.model, made, open_record(sealed, work.owner)


def _trials(
    work: _Work, original: GaussianModel, marked: GaussianModel, opened: OpenedRecord
) -> dict[str, Mapping[str, Any]]:
    """Steal the marked model in three ways, and try the unmarked original."""
    import numpy as np

    from engine.flows.verify.search import VerifyConfig, verify_images, verify_model
    from engine.formats import read_model, write_model
    from engine.formats.image_files import read_picture
    from engine.lab.evaluate.bench.attacks import random_view
    from engine.lab.sim.attacks import model_attack
    from engine.raster import render

    config = VerifyConfig()

    def attacked(*chain: tuple[str, float | str]) -> GaussianModel:
        suspect = marked
        for step, (name, strength) in enumerate(chain):
            suspect = model_attack(name).apply(suspect, strength, rng=np.random.default_rng((SEED, step)))
        return suspect

    def stored(suspect: GaussianModel, name: str, kind: str) -> GaussianModel:
        """Through a file, as it would be passed on."""
        path = work.folder / name
        with whole_file(path) as part:
            write_model(suspect, part, kind)
        return read_model(path).model

    def moved() -> Verification:
        suspect = attacked(("rotate", 77.0), ("scale", 2.5), ("shuffle", 1.0))
        return verify_model(stored(suspect, "stolen-moved.ply", "ply"), opened, config, work.progress)

    def piece() -> Verification:
        suspect = attacked(("crop", 0.25), ("similarity", 4.0), ("shuffle", 1.0))
        return verify_model(stored(suspect, STOLEN, "spz"), opened, config, work.progress)

    def screenshot() -> Verification:
        camera = random_view(marked, np.random.default_rng(SEED), *SCREENSHOT_SIZE)
        work.progress("render", 0.0)
        picture = render(marked, camera)
        path = work.folder / "stolen-screenshot.jpg"
        with whole_file(path) as part:
            write_picture(picture, part, path, SCREENSHOT_QUALITY)
        return verify_images([read_picture(path)], opened, config, None, work.progress)

    work.console.say("4. Copies are stolen, and the owner verifies what is found:")
    steps: dict[str, tuple[str, Callable[[], Verification]]] = {
        "moved": ("turned by 77 degrees, scaled by 2.5, shuffled", moved),
        "piece": ("cropped to 25 %, moved, converted to .spz", piece),
        "screenshot": (f"one JPEG {SCREENSHOT_QUALITY} screenshot, camera unknown", screenshot),
        "unmarked": (
            "the original, which carries no mark",
            lambda: verify_model(original, opened, config, work.progress),
        ),
    }
    outcomes: dict[str, Mapping[str, Any]] = {}
    for name, (text, check) in steps.items():
        report = VerifyReport.of(check(), opened)
        outcomes[name] = report
        work.console.say(f"   {text:<50} {_summary(report)}")
    return outcomes


def _summary(report: Mapping[str, Any]) -> str:
    from engine.present.numerals import PLAIN, surely
    from engine.present.wording import HEADLINES

    found = HEADLINES[report["verdict"]]
    bits = f"{report['matching_bits']}/{report['bits']} bits"
    if report["verdict"] == "marked":
        chance = PLAIN.odds(report["log10_false_claim"])
        return f"{found}: {bits}, false claim {chance}, {report['seconds']:.1f} s"
    return f"{found}: {bits}, as by chance; a worn mark would show: {surely(report['power'])} sure"


def _wrong_key(work: _Work) -> dict[str, str]:
    """What another key finds with this record: nothing, with the reason."""
    from engine.flows.records.opened_record import open_record
    from engine.watermark.keys import OwnerKey

    try:
        open_record((work.folder / "scene.record").read_bytes(), OwnerKey.generate())
    except WrongKeyError as error:
        work.console.say(f"   {'the record opened with another key':<50} refused: this key did not make this record")
        return {"verdict": "wrong_key", "message": str(error)}
    return {"verdict": "opened", "message": "another key opened the record"}


def _wider(camera: Camera) -> Camera:
    K = camera.K.copy()
    K[0, 0], K[1, 1] = ZOOM * K[0, 0], ZOOM * K[1, 1]
    return replace(camera, K=K)


def _picture(path: Path, name: str, original: GaussianModel, made: Embedding, words: Words) -> None:
    """Original, marked, their difference, the stolen piece and the claim, in one picture."""
    import numpy as np

    from engine.flows.views.camera_rig import make_rig
    from engine.formats import read_model
    from engine.raster import render

    camera = _wider(make_rig(original, 24, SIDE, SIDE)[VIEW])
    before, after = (np.clip(render(each, camera), 0.0, 1.0) for each in (original, made.model))
    found = read_model(path.parent / STOLEN).model
    piece = np.clip(render(found, _wider(make_rig(found, 24, *SUSPECT_SIZE)[VIEW])), 0.0, 1.0)
    report = made.report
    fidelity = f"{report['bits']} bits hidden, worst view {report['psnr_worst_view']:.1f} dB"
    with whole_file(path) as part:
        draw_demo(
            part,
            Panel("Original", f"{name}, {len(original):,} Gaussians", before),
            Panel("Marked", fidelity, after),
            Panel("Stolen", f"{len(found):,} Gaussians, cropped, moved, as .spz", piece),
            words.headline,
            claim_lines(words, headline=False, parts=("says", "does_not_say")),
        )


GAIN = 20
SIDE = 720  # pixels of the three square panels' pictures
SUSPECT_SIZE = (720, 540)

_INK, _FAINT, _ACCENT, _PAPER = "#1b1f24", "#5c6672", "#0a7d52", "#ffffff"
_INCHES = (12.0, 8.0)
_LEFT, _GAP, _WIDTH = 0.0225, 0.0125, 0.31


@dataclass(frozen=True, eq=False)
class Panel:
    """One image (H, W, 3) float32 in 0..1, its title and a word next to it."""

    title: str
    caption: str
    image: Float32


def draw_demo(path: Path, original: Panel, marked: Panel, suspect: Panel, headline: str, lines: Sequence[str]) -> None:
    """Write the picture as PNG.

    Parameters
    ----------
    original, marked : Panel
        The same view; their difference is drawn next to them.
    suspect : Panel
        What turned up.
    headline : str
        The verdict in one sentence.
    lines : sequence of str
        The claim, in a fixed-width layout.
    """
    import numpy as np
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    # Mid-grey is no change: both signs of the mark can be seen.
    change = np.clip(0.5 + GAIN * (marked.image - original.image), 0.0, 1.0)
    difference = Panel(f"Difference x{GAIN}", "grey: no change", change.astype(np.float32))
    figure = Figure(figsize=_INCHES, dpi=100, facecolor=_PAPER)
    FigureCanvasAgg(figure)

    def place(panel: Panel, column: int, top: float) -> None:
        height = _WIDTH * panel.image.shape[0] / panel.image.shape[1] * _INCHES[0] / _INCHES[1]
        x = _LEFT + column * (_WIDTH + _GAP)
        axes = figure.add_axes((x, top - height, _WIDTH, height))
        axes.imshow(panel.image, interpolation="antialiased")
        axes.set_axis_off()
        figure.text(x, top + 0.014, panel.title, fontsize=14, fontweight="bold", color=_INK)
        figure.text(x + _WIDTH, top + 0.015, panel.caption, fontsize=8.5, color=_FAINT, ha="right")

    for column, panel in enumerate((original, marked, difference)):
        place(panel, column, 0.94)
    place(suspect, 2, 0.40)
    figure.text(_LEFT, 0.422, headline, fontsize=14, fontweight="bold", color=_ACCENT, va="top")
    text = "\n".join(lines)
    figure.text(_LEFT, 0.376, text, fontsize=8.7, color=_INK, va="top", family="monospace", linespacing=1.3)
    figure.savefig(path, format="png", facecolor=_PAPER, bbox_inches="tight", pad_inches=0.25)  # however long the claim
