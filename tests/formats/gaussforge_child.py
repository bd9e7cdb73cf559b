"""GaussForge as an oracle. It aborts on some inputs, so it only ever runs in a child process.

Run as a script, it reads a pickled list of calls from its input and writes the pickled results.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
from typing import Any


def gaussforge(*calls: tuple[str, dict[str, Any]]) -> list[Any]:
    """Results of methods of GaussForge, each a name and its arguments."""
    child = subprocess.run(
        [sys.executable, __file__], input=pickle.dumps(calls), capture_output=True, timeout=120, check=True
    )
    results = pickle.loads(child.stdout[child.stdout.index(b"PICKLE") + 6 :])
    for result in results:
        assert "error" not in result, result
    return [result["data"] for result in results]


if __name__ == "__main__":
    from gaussforge import GaussForge

    forge = GaussForge()
    answers = [getattr(forge, name)(**arguments) for name, arguments in pickle.load(sys.stdin.buffer)]
    sys.stdout.flush()
    sys.stdout.buffer.write(b"PICKLE" + pickle.dumps(answers))
