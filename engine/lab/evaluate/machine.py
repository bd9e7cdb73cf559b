"""What a measurement ran on: every benchmark stores this with its numbers."""

import os
import platform
import sys
from importlib import metadata
from pathlib import Path

from engine.kernels.thread_crew import usable_cores

__all__ = ["load_per_core", "machine_info", "peak_memory_mb"]

_PACKAGES = ("numpy", "numba", "scipy", "opencv-python-headless", "torch", "gsplat")


def machine_info() -> dict[str, object]:
    """Describe the machine and the packages that decide speed, without importing any of them; JSON-ready.

    `cpu` (model name), `cores` (all logical cores), `cores_usable` (those this process may run on), `memory_gb`
    (physical, None where the system does not say), `platform`, `python`, and under `packages` the versions of those
    installed.
    """
    versions: dict[str, str] = {}
    for name in _PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return {
        "cpu": _key_values(Path("/proc/cpuinfo")).get("model name") or platform.processor() or platform.machine(),
        "cores": os.cpu_count() or 1,
        "cores_usable": usable_cores(),
        "memory_gb": _memory_gb(),
        "platform": platform.platform(),
        "python": platform.python_version(),
        "packages": versions,
    }


def peak_memory_mb() -> float:
    """Largest resident memory of this process so far, in MiB; NaN where the system does not say.

    It never falls by more than the system's rounding (a MiB or so): to compare two stages, run each in a
    process of its own.
    """
    # VmHWM starts afresh with every program; getrusage would hand a child its parent's peak across fork.
    fields = _key_values(Path("/proc/self/status"))
    if "VmHWM" in fields:
        return float(fields["VmHWM"].split()[0]) / 1024.0
    try:
        import resource
    except ImportError:  # Windows
        return float("nan")
    peak = float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10  # bytes there, KiB elsewhere


def load_per_core() -> float | None:
    """Programs that wanted to run during the last minute, per usable core; None where the system does not say.

    A measurement on all cores brings it to 1 by itself; well above, its times are too long.
    """
    try:
        return os.getloadavg()[0] / usable_cores()
    except (AttributeError, OSError):  # Windows has none
        return None


def _memory_gb() -> float | None:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    except (AttributeError, OSError, ValueError):  # not a POSIX system, or it keeps this to itself
        return None


def _key_values(file: Path) -> dict[str, str]:
    """First value of every `key: value` line; nothing where there is no such file."""
    fields: dict[str, str] = {}
    try:
        text = file.read_text()
    except OSError:
        return fields
    for line in text.splitlines():
        key, colon, value = line.partition(":")
        if colon:
            fields.setdefault(key.strip(), value.strip())
    return fields
