"""Time this checkout and another in turn and print what each part takes here, there, and the ratio."""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import llvmlite.binding as llvm

from engine.lab.evaluate.machine import machine_info
from tests.speed.programs import COMMANDS, COMPILE, IMPORTS, RASTER

HERE = Path(__file__).parents[2]


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.speed", description=__doc__)
    parser.add_argument("other", type=Path, help="the other checkout, for instance of the first version")
    parser.add_argument("parts", nargs="*", help="raster, compile, imports, commands (default: all)")
    parser.add_argument("--scene", type=Path, required=True)
    parser.add_argument("--rounds", type=int, default=3, help="each checkout takes its turn this often (3)")
    parser.add_argument("--repeats", type=int, default=15, help="raster: timed runs in each round (15)")
    parser.add_argument("--avx2", action="store_true", help="compile for a processor without AVX-512")
    given = parser.parse_args()
    scene = str(given.scene.absolute())
    programs = {
        "raster": (RASTER, [scene, str(given.repeats)]),
        "compile": (COMPILE, []),
        "imports": (IMPORTS, []),
        "commands": (COMMANDS, [scene]),
    }
    processor = without_avx512() if given.avx2 else {}
    tell(json.dumps({"machine": machine_info()["cpu"], "compiled for": processor.get("NUMBA_CPU_NAME", "it")}))
    tell(f"{'':32}{'here':>10}{'there':>10}{'ratio':>8}   ratios of the rounds")
    for part in given.parts or programs:
        program, arguments = programs[part]
        if part != "compile":  # so that neither compiles while it is timed
            for checkout in (HERE, given.other):
                run(checkout, program, arguments, processor)
        rounds = []
        for number in range(given.rounds):
            found: dict[Path, dict[str, float]] = {}
            turns = (HERE, given.other) if number % 2 == 0 else (given.other, HERE)  # who comes first is slower here
            for checkout in turns:
                with tempfile.TemporaryDirectory() as empty:
                    place = {"NUMBA_CACHE_DIR": empty} if part == "compile" else {}
                    found[checkout] = run(checkout, program, arguments, {**processor, **place})
            rounds.append([found[HERE], found[given.other]])
        for name in rounds[0][0]:
            if not rounds[0][1].get(name):  # a stage that the other does not have, or takes no time for
                continue
            here, there = ([pair[side][name] for pair in rounds] for side in (0, 1))
            ratios = [a / b for a, b in zip(here, there, strict=True)]
            medians = (statistics.median(here), statistics.median(there), statistics.median(ratios))
            each = " ".join(f"{ratio:.2f}" for ratio in ratios)
            tell(f"{name:32}{medians[0]:10.4g}{medians[1]:10.4g}{medians[2]:8.2f}   {each}")


def tell(line: str) -> None:
    """One line, at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def without_avx512() -> dict[str, str]:
    """Numba's variables for this processor as one of AVX2 alone; the name by itself would leave the features."""
    features = llvm.get_host_cpu_features()
    for name in features:
        features[name] = features[name] and not name.startswith(("avx512", "evex", "avx10"))
    return {"NUMBA_CPU_NAME": "znver3", "NUMBA_CPU_FEATURES": features.flatten()}


def run(checkout: Path, program: str, arguments: list[str], variables: dict[str, str]) -> dict[str, float]:
    """The numbers that a program printed, run by a checkout's modules."""
    environment = {**os.environ, **variables, "PYTHONPATH": str(checkout)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # who installs a package has its byte code
    command = [sys.executable, "-c", program, *arguments]
    ended = subprocess.run(command, cwd=checkout, env=environment, stdout=subprocess.PIPE, check=True)
    numbers: dict[str, float] = json.loads(ended.stdout.splitlines()[-1])
    return numbers


if __name__ == "__main__":
    main()
