"""A method under test: what it must offer (`Extractor`), how one is found by name, ours and the runnable baselines."""

import hashlib
import importlib
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Protocol

import numpy as np

from engine.errors import InputError
from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import profile
from engine.flows.records.opened_record import open_record
from engine.flows.verify.search import Verification, VerifyConfig, verify_images, verify_model
from engine.flows.views.camera_rig import make_rig
from engine.formats import read_model
from engine.lab.evaluate.baselines.methods import METHODS
from engine.lab.evaluate.marked_scene import bench_key
from engine.lab.evaluate.study import Options
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.watermark.keys import POSE, uniform
from engine.watermark.messages import Signs, derive_message, message_signs
from engine.watermark.rates import MADE_FIRST

__all__ = [
    "BITS",
    "LEAST_MATCHES",
    "OURS",
    "Extractor",
    "Found",
    "Subject",
    "find_method",
    "mark_subject",
    "scenes_and_methods",
]

BITS = 32
LEAST_MATCHES = 26
"""Of 32 bits: what the field's usual test at 1e-3 requires, if wrong keys read fair and independent bits."""
OURS = "ours"
BASELINE_DB = 47.0
"""PSNR of the worst view, at which the baselines mark; ours is planned to the same."""


@dataclass(frozen=True, eq=False)
class Found:
    """What a method reads from one suspect."""

    bits: Signs  # (B,) +1 and -1
    claimed: bool | None = None  # the method's own decision; None: whether `LEAST_MATCHES` bits are right
    z: float | None = None  # its own score, where it has one


class Extractor(Protocol):
    """A method: a class that is called without arguments. An instance marks one model, then reads suspects."""

    name: str  # in tables
    informed: bool  # whether reading uses the unmarked original or a record that holds it; False: blind

    def embed(self, model: GaussianModel, message: Signs, seed: int) -> GaussianModel:
        """The model, marked with a message, (B,) int8 of +1 and -1, under an owner's key that the seed draws.

        What reading needs is kept in the instance.
        """
        ...

    def read_model(self, suspect: GaussianModel) -> Found | None:
        """What a suspect model says; None for a method that reads no models."""
        ...

    def read_picture(self, picture: Float32, camera: Camera | None) -> Found | None:
        """What one picture (H, W, 3) in 0..1 says; None for a method that reads no pictures.

        The camera is in the frame of the model that was marked, or unknown (None); blind methods ignore it.
        """
        ...


class Ours:
    """This program: profile `fast`, and the claim that `verify` makes at 1 in 10^9."""

    name, informed = OURS, True

    def embed(self, model: GaussianModel, message: Signs, seed: int) -> GaussianModel:
        """See `Extractor`."""
        key, digest = bench_key(seed), hashlib.sha256(model.sh.tobytes()).hexdigest()
        made = embed(model, key, original_sha256=digest, message=message, config=profile("fast"))
        self._opened = open_record(made.record.to_bytes(key), key, MADE_FIRST)
        return made.model

    def read_model(self, suspect: GaussianModel) -> Found:
        """See `Extractor`; evidence from the Gaussians."""
        return self._found(verify_model(suspect, self._opened, VerifyConfig(route="model")))

    def read_picture(self, picture: Float32, camera: Camera | None) -> Found:
        """See `Extractor`."""
        cameras = None if camera is None else [camera]
        return self._found(verify_images([picture], self._opened, VerifyConfig(), cameras=cameras))

    def _found(self, result: Verification) -> Found:
        claim = result.claim
        return Found(message_signs(claim.message), claim.verdict.value == "marked", claim.z)


class Baseline:
    """A method of `engine.lab.evaluate.baselines`, as strong as ours may be: `BASELINE_DB` in views drawn alike."""

    def __init__(self, short: str) -> None:
        self._method = METHODS[short]
        self.name, self.informed = self._method.name, self._method.informed

    def embed(self, model: GaussianModel, message: Signs, seed: int) -> GaussianModel:
        """See `Extractor`."""
        key, config = bench_key(seed), profile("fast")
        jitter = uniform(key.derive(POSE, b"baseline"), 4 * config.views).reshape(config.views, 4)
        views = make_rig(model, config.views, config.view_size, config.view_size, jitter=jitter)
        marked, self._kept = self._method.embed(model, key, message, BASELINE_DB, views)
        return marked

    def read_model(self, suspect: GaussianModel) -> Found | None:
        """See `Extractor`."""
        return _signs_of(self._method.read_model(suspect, self._kept))

    def read_picture(self, picture: Float32, camera: Camera | None) -> Found | None:
        """See `Extractor`."""
        return _signs_of(self._method.read_picture(picture, self._kept))


def _signs_of(scores: Float64 | None) -> Found | None:
    return None if scores is None else Found(np.where(scores >= 0, 1, -1).astype(np.int8))


KNOWN: dict[str, Callable[[], Extractor]] = {OURS: Ours, **{short: partial(Baseline, short) for short in METHODS}}
"""By the name that `--method` takes."""
OFFERED = ("name", "informed", "embed", "read_model", "read_picture")


def find_method(name: str) -> Extractor:
    """A new instance of a known method, or of a class of one's own, ``module:Class``.

    The module is imported as Python does, from the current folder, too. InputError where it cannot be imported, has no
    such class, the class cannot be called without arguments, or lacks a part of `Extractor`.
    """
    if name in KNOWN:
        return KNOWN[name]()
    module_name, _, class_name = name.partition(":")
    if not module_name or not class_name:
        raise InputError(f"no method is called {name!r}: name {', '.join(KNOWN)}, or a class as module:Class")
    if "" not in sys.path:
        sys.path.insert(0, "")
    try:
        module = importlib.import_module(module_name)
    except Exception as error:  # whatever somebody's module raises
        raise InputError(
            f"method {name!r}: the module {module_name!r} cannot be imported: {type(error).__name__}: {error}"
        ) from error
    made = getattr(module, class_name, None)
    if not isinstance(made, type):
        raise InputError(f"method {name!r}: the module {module_name!r} has no class {class_name!r}")
    try:
        method: Extractor = made()
    except Exception as error:
        raise InputError(
            f"method {name!r}: the class cannot be called without arguments: {type(error).__name__}: {error}"
        ) from error
    if lacking := [part for part in OFFERED if not hasattr(method, part)]:
        raise InputError(f"method {name!r}: the class has no {', '.join(lacking)}; see docs/BENCHMARK.md")
    return method


@dataclass(frozen=True, eq=False)
class Subject:
    """A model that a method has marked, and the method's instance, which reads it."""

    method: Extractor
    original: GaussianModel
    marked: GaussianModel
    message: Signs
    seconds: float  # that marking took

    def read_model(self, suspect: GaussianModel) -> tuple[int, bool, float | None] | None:
        """Bits read right, whether that is a claim, z; None where the method reads no models."""
        return self._judged(self.method.read_model(suspect))

    def read_picture(self, picture: Float32, camera: Camera | None) -> tuple[int, bool, float | None] | None:
        """The same of a picture (H, W, 3)."""
        return self._judged(self.method.read_picture(picture, camera))

    def _judged(self, found: Found | None) -> tuple[int, bool, float | None] | None:
        if found is None:
            return None
        bits = np.asarray(found.bits)
        if bits.shape != self.message.shape or not np.isin(bits, (-1, 1)).all():
            raise InputError(f"the method {self.method.name!r} read {bits!r}, expected {BITS} bits of +1 and -1")
        right = int((bits == self.message).sum())
        return right, right >= LEAST_MATCHES if found.claimed is None else found.claimed, found.z


@lru_cache(maxsize=1)
def mark_subject(name: str, path: str, seed: int) -> Subject:
    """A scene marked by a new instance of the method, with the message and key of a seed; kept for the next cell.

    InputError where the method gives back something else than a model.
    """
    method, message = find_method(name), derive_message(bench_key(seed), BITS, b"benchmark")
    original = read_model(path).model
    began = time.perf_counter()
    marked = method.embed(original, message, seed)
    if not isinstance(marked, GaussianModel):
        raise InputError(f"the method {method.name!r} marked a model and gave a {type(marked).__name__} back")
    return Subject(method, original, marked, message, time.perf_counter() - began)


def scenes_and_methods(options: Options) -> Iterator[tuple[str, dict[str, str]]]:
    """Of each scene and method, what names a cell, and the arguments of its function."""
    for number, path in enumerate(options.scenes):
        for place, method in enumerate(options.methods or (OURS,)):
            yield f"{number}-{place}", {"path": path, "method": method}
