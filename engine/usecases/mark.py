"""Mark a scene: a file or folder in, for each recipient a marked file and the record that proves it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from engine.errors import InputError
from engine.numerics.plain import Report
from engine.usecases.files import check_output, check_target, refuse_same, whole_file, whole_output, write_secret
from engine.usecases.read_ahead import ahead

if TYPE_CHECKING:
    from engine.flows.embed.embedding import Embedding, EmbedReport
    from engine.flows.embed.terms import MarkTerms
    from engine.flows.progress import Progress
    from engine.formats import Repair
    from engine.scenes.scene_files import Loaded, Scene
    from engine.watermark.keys import OwnerKey

__all__ = ["MarkAnswer", "MarkOutput", "MarkReport", "MarkRequest", "mark", "settings_note"]


_EXACT = ("ply", "glb")
"""Formats that keep all of a model to float32's rounding at least: not worth a picture."""


@dataclass(frozen=True)
class MarkOutput:
    """Where one recipient's files go; InputError where both have one name."""

    model: Path  # marked model; a folder where the format is one
    record: Path

    def __post_init__(self) -> None:
        if self.model.absolute() == self.record.absolute():
            raise InputError("the marked model and the record need different names")


@dataclass(frozen=True, eq=False, kw_only=True)
class MarkRequest:
    """What is to be marked, and how; InputError where a value is out of range."""

    model: Path  # model, clip or codebook folder
    key: OwnerKey
    outputs: Mapping[str, MarkOutput]  # by name of the recipient, "" for none; at least one
    terms: MarkTerms  # of every copy; see `flows.embed.profiles.compose` for its settings
    profile: str = "auto"  # what the report calls the settings
    format: str | None = None  # of the marked model; default: the original's own, where that is written
    name: str | None = None  # what errors call the model; default: its path
    spz_frame: str = "auto"  # axes of .spz input: "auto", "spec" or "ply"
    overwrite: bool = False  # whether records may be replaced

    def __post_init__(self) -> None:
        if not self.outputs:
            raise InputError("no recipient was given")

    def check_files(self) -> None:
        """Refuse outputs that cannot be written, before any work is done for them."""
        for each in self.outputs.values():
            refuse_same(self.model, each.model)
            check_output(each.model, self.format or "")
            check_target(each.record, overwrite=self.overwrite)


@dataclass(frozen=True, eq=False)
class MarkReport(Report):
    """Measurements of one copy: of the embedding, and of its files."""

    inlined = "embedding"

    embedding: EmbedReport
    bytes_in: int
    bytes_out: int
    record_bytes: int
    format_in: str
    format_out: str
    profile: str
    repairs: tuple[Repair, ...]  # what was mended on loading
    psnr_as_written: float
    """dB of the file read back, against the original, in the key view of `psnr_total_worst_view`; where the file
    holds every bit of the marked model, that value."""
    notes: list[str]  # what the owner should know of the file
    seconds: float
    seconds_by_stage: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class MarkAnswer:
    """One recipient's copy."""

    output: MarkOutput  # written
    scene: Scene  # marked, of the original's kind
    embedding: Embedding
    loaded: Loaded  # the original
    report: MarkReport


def mark(
    request: MarkRequest, progress: Progress, prepare: Callable[[Loaded], None] | None = None
) -> Iterator[MarkAnswer]:
    """Mark a scene for one recipient after another; an answer comes when its files are written, each whole or not at
    all.

    Raises the errors of reading and of `flows.embed.embedding.embed`, and InputError where a file cannot be written.

    Parameters
    ----------
    prepare : callable, optional
        Called with the original once it is read, before the work on it.
    """
    began = time.perf_counter()
    request.check_files()
    from engine.model import GaussianModel
    from engine.scenes.carried import left_out_note, without
    from engine.scenes.scene_files import notes_of, output_of, read_scene, write_scene, written_as

    reading = ahead(read_scene, request.model, name=request.name, spz_frame=request.spz_frame)
    from engine.flows.embed.profiles import delivered_as
    from engine.scenes.scene_marking import embed_scene  # while the file is read

    progress("read", 0.0)
    loaded = reading.result()
    kind = written_as(loaded, request.format or output_of(loaded))
    stages = {"read": time.perf_counter() - began}
    if prepare is not None:
        prepare(loaded)
    revealed = _revealed(loaded, kind)
    terms = replace(request.terms, config=delivered_as(request.terms.config, kind))
    marks = embed_scene(loaded, request.key, list(request.outputs), terms, progress)
    for (marked, made), output in zip(marks, request.outputs.values(), strict=True):
        scene = without(marked, revealed) if isinstance(marked, GaussianModel) else marked
        started = time.perf_counter()
        progress("write", 0.0)
        sealed = made.record.to_bytes(request.key)
        # The record comes first: a record without its model is harmless, a marked model without it is lost.
        with whole_output(output.model, kind) as model_part:
            bytes_out = write_scene(scene, model_part, kind)
            as_written = _psnr_as_written(scene, made, kind, model_part)
            with whole_file(output.record, overwrite=request.overwrite) as record_part:
                write_secret(record_part, sealed)
        ended = time.perf_counter()
        report = MarkReport(
            embedding=made.report,
            bytes_in=loaded.source_bytes,
            bytes_out=bytes_out,
            record_bytes=len(sealed),
            format_in=loaded.format,
            format_out=kind,
            profile=request.profile,
            repairs=loaded.noticed,
            psnr_as_written=as_written,
            notes=[
                *settings_note(terms, made),
                *device_note(terms, made),
                *notes_of(scene, kind),
                *left_out_note(revealed),
            ],
            seconds=ended - began,
            seconds_by_stage=stages | made.report.seconds_by_stage | {"write": ended - started},
        )
        yield MarkAnswer(output, scene, made, loaded, report)
        began, stages = time.perf_counter(), {}


def device_note(terms: MarkTerms, made: Embedding) -> list[str]:
    """What became of a GPU that was asked for."""
    from engine.flows.embed.profiles import Auto

    wanted = terms.config.start if isinstance(terms.config, Auto) else terms.config
    if wanted is None or wanted.device == "cpu":
        return []
    if made.report.device == "cuda":
        return ["fitted on a GPU, which never gives the same file twice: mark all copies in one command"]
    return [
        "the GPU was not used: it fits what --budget leaves or a profile refines, of models without discs that are not "
        "antialiased, seen by cameras without skew"
    ]


def settings_note(terms: MarkTerms, made: Embedding) -> list[str]:
    """Where settings were left open, and an earlier copy's were taken."""
    from engine.flows.embed.profiles import Auto

    if terms.earlier is None or not isinstance(terms.config, Auto) or made.report.choice is not None:
        return []
    name = f" ({terms.earlier.copy!r})" if terms.earlier.copy else ""
    return [f"the settings are those of the earlier copy{name}: all copies of a model share them"]


def _revealed(loaded: Loaded, kind: str) -> list[str]:
    """What a file of the marked model must not carry from the original's."""
    from engine.model import GaussianModel
    from engine.scenes.carried import revealing

    return revealing(loaded.scene) if kind == "ply" and isinstance(loaded.scene, GaussianModel) else []


def _psnr_as_written(scene: Scene, made: Embedding, kind: str, file: Path) -> float:
    """See `MarkReport.psnr_as_written`: a format that rounds is read back, and drawn once."""
    from engine.formats import read_model
    from engine.model import GaussianModel

    if not isinstance(scene, GaussianModel) or kind in _EXACT:
        return made.report.psnr_total_worst_view
    return made.worst_view.psnr_of(read_model(file).model)
