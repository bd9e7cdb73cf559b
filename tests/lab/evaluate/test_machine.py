"""What benchmarks store about the machine."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np

from engine.lab.evaluate.machine import machine_info, peak_memory_mb


def test_machine_info_is_complete_and_json_ready() -> None:
    info = json.loads(json.dumps(machine_info()))
    assert set(info) == {"cpu", "cores", "cores_usable", "memory_gb", "platform", "python", "packages"}
    assert info["cpu"]
    assert 1 <= info["cores_usable"] <= info["cores"]
    assert info["memory_gb"] is None or info["memory_gb"] > 0.1
    assert info["python"] == ".".join(map(str, sys.version_info[:3]))
    assert info["packages"]["numpy"] == np.__version__


def test_machine_info_imports_nothing_it_describes() -> None:
    code = (
        "import sys\nfrom engine.lab.evaluate.machine import machine_info\nmachine_info()\n"
        "assert not {'torch', 'numba', 'cv2', 'scipy'} & set(sys.modules), sorted(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_peak_memory_sees_an_allocation_and_never_falls() -> None:
    slack = 4.0  # the kernel sums its page counters lazily: MiB
    before = peak_memory_mb()
    block = np.ones((160, 2**20), dtype=np.uint8)  # 160 MiB, touched
    during = peak_memory_mb()
    assert 10 < before < 100_000
    # The pages may come out of an earlier, freed peak; so the bound is on what is resident now.
    assert during >= before - slack
    assert during >= block.nbytes / 2**20
    del block
    assert peak_memory_mb() >= during - slack
