"""Files of compiled kernels: where they lie, how they are named, and when they are removed.

A file is named by a digest of all that its content depends on, so nothing out of date is ever found, and several
versions of this program can share a folder. What was not used for `UNUSED_DAYS` is removed.
"""

import hashlib
import json
import logging
import os
import shutil
import stat
import tempfile
import time
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path

from engine.kernels.machine_code import Code, processor

UNUSED_DAYS = 30.0
"""After which a file is removed. Use is noted in its date, at most once a day."""

_DAY = 86400.0
_ENGINE = Path(__file__).parents[1]


@cache
def folders() -> tuple[Path, ...]:
    """Where files are looked for: in NUMBA_CACHE_DIR alone if that is set; else in this package and in the user's
    cache, and where neither can be written, in a folder of this user's own among the temporary files."""
    if given := os.environ.get("NUMBA_CACHE_DIR"):
        return (Path(given) / "kernels",)
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path(os.path.expanduser("~"), ".cache"))
    places = [_ENGINE / "__pycache__" / "kernels"]
    places += [user / "mark3dgs" / "kernels"] if user.is_absolute() else []  # it is not where there is no home
    if not any(map(_can_write, places)) and hasattr(os, "getuid"):
        temporary = Path(tempfile.gettempdir()) / f"mark3dgs-{os.getuid()}"
        with suppress(OSError):
            temporary.mkdir(mode=0o700, exist_ok=True)
            facts = temporary.lstat()
            # Code from a folder that another user made, or can write to, would run as this user.
            if facts.st_uid == os.getuid() and facts.st_mode & 0o170077 == stat.S_IFDIR:
                places.append(temporary)
    return tuple(places)


@cache
def folder() -> Path | None:
    """The first of `folders` that can be written; None where none can."""
    return next(filter(_can_write, folders()), None)


def _can_write(place: Path) -> bool:
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(place, os.W_OK | os.X_OK)


def warn_once(topic: str, text: str) -> None:
    """A line on standard error (the log `engine.kernels`), once for this process and all that it starts."""
    if (name := f"MARK3DGS_WARNED_{topic}") not in os.environ:
        os.environ[name] = text
        logging.getLogger("engine.kernels").warning(text)


@cache
def compiler() -> list[str]:
    """By what kernels are compiled, with which options, and in what form."""
    sources = [Path(__file__).with_name(name) for name in ("machine_code.py", "compiler.py")]
    return [version("numba"), version("llvmlite"), *(hashlib.sha256(each.read_bytes()).hexdigest() for each in sources)]


def path_of(label: str, suffix: str, *facts: str) -> str:
    """Name of the file whose content depends on these facts, the compiler and the processor."""
    digest = hashlib.sha256("\0".join([*compiler(), *processor(), label, *facts]).encode()).hexdigest()
    return f"{label}-{digest[:32]}.{suffix}"


def read(name: str) -> bytes | None:
    """Content of a file, which counts as a use; None where there is none."""
    for place in folders():
        with suppress(OSError):
            content = (place / name).read_bytes()
            note_use(place / name)
            return content
    return None


def note_use(path: Path) -> None:
    """Put off the day on which it is removed."""
    with suppress(OSError):  # a folder that is read only
        if time.time() - path.stat().st_mtime > _DAY:
            os.utime(path)


def write(name: str, content: bytes) -> None:
    """Write a file whole or not at all. Where no folder can be written, say so."""
    place = folder()
    try:
        if place is None:
            raise OSError
        handle, part = tempfile.mkstemp(dir=place, suffix=".part")
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        os.chmod(part, 0o644)  # other users may load what was compiled when this program was installed
        os.replace(part, place / name)
        remove_unused()
    except OSError:
        tried = ", ".join(map(str, folders()))
        warn_once(
            "CACHE", f"compiled kernels cannot be kept in {tried}: set NUMBA_CACHE_DIR to a folder that can be written"
        )


@cache
def remove_unused() -> None:
    """Remove what was not used for `UNUSED_DAYS`; once a process. A process that has it open keeps it; another compiles
    it again."""
    for path in (folder() or _ENGINE / "none").glob("*-*.*"):
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > UNUSED_DAYS * _DAY:
                shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink()


def find(label: str, text: str, kinds: str) -> Code | None:
    """The code kept of a kernel: its name, a digest of its text, the kinds of its arguments."""
    head, _, machine = (read(path_of(label, "kernel", text, kinds)) or b"").partition(b"\n")
    try:
        fields = json.loads(head)
        digest = fields.pop("digest")
        return Code(**fields, machine=machine) if digest == hashlib.sha256(machine).hexdigest() else None
    except (ValueError, KeyError, TypeError):
        return None


def keep(label: str, text: str, kinds: str, code: Code) -> None:
    """Keep it for later runs."""
    fields = code._asdict() | {"digest": hashlib.sha256(code.machine).hexdigest()}
    machine = fields.pop("machine")
    write(path_of(label, "kernel", text, kinds), json.dumps(fields).encode() + b"\n" + machine)


def numba_folder(label: str, text: str) -> Path | None:
    """Where numba itself may keep a kernel, of any arguments; None where it can keep nothing."""
    place = folder()
    if place is None:
        return None
    note_use(place / path_of(label, "numba", text))
    return place / path_of(label, "numba", text)
