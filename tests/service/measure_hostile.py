"""Every file that the readers refuse in tests/formats, sent to a running service.

`python -m tests.service.measure_hostile`

Each must be answered with a 4xx within 5 s, and the service must be alive afterwards, no larger than before.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from tests.service import serving
from tests.service.measuring import client_of, resident_mb
from tests.service.serving import ROOT

AT_ONCE = 2


def main() -> None:
    """Collect, send, and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--most", type=int, default=0, help="send a random sample of so many; 0: all")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="mark3dgs-hostile-"))
    corpus = folder / "corpus"
    corpus.mkdir()
    subprocess.run(
        [sys.executable, "-m", "pytest", "tests/formats", "-m", "not docker", "-p", "tests.service.refused_inputs"],
        cwd=ROOT,
        env={**os.environ, "MARK3DGS_REFUSED_DIR": str(corpus)},
        check=True,
        stdout=sys.stderr,
    )
    files = sorted(corpus.iterdir())
    collected = len(files)
    if args.most and collected > args.most:
        files = sorted(random.Random(args.seed).sample(files, args.most))
    served = serving.start(folder, workers=0)
    try:
        with client_of(served) as client:
            before = resident_mb(served.process.pid)

            def send(path: Path) -> tuple[int, float]:
                data = path.read_bytes()
                began = time.perf_counter()
                slot = client.post("/v1/uploads", json={"size": len(data)}).json()["id"]
                status = client.put(f"/v1/uploads/{slot}", content=data).status_code
                return status, time.perf_counter() - began

            with ThreadPoolExecutor(AT_ONCE) as pool:
                answers = list(pool.map(send, files))
            alive = client.get("/healthz").status_code == 200
        peak = resident_mb(served.process.pid, peak=True)
    finally:
        served.stop()
        shutil.rmtree(folder, ignore_errors=True)
    seconds = np.array([taken for _, taken in answers])
    odd = [path.name for path, (status, _) in zip(files, answers, strict=True) if not 400 <= status < 500]
    found = {
        "collected": collected,
        "files": len(files),
        "answers": dict(Counter(status for status, _ in answers)),
        "not_4xx": odd,
        "seconds_median": float(np.median(seconds)),
        "seconds_max": float(seconds.max()),
        "alive": alive,
        "api_mb_before": before,
        "api_mb_peak": peak,
    }
    sys.stdout.write(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
