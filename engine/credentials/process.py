"""The process that reads a manifest: one JSON object on standard input, one on standard output (`native.parse`)."""

import json
import math
import sys
from pathlib import Path

from engine.credentials.native import parse
from engine.errors import InputError

SECONDS = 60.0
"""By the clock, and of CPU time; one of ours takes a tenth of a second."""
MEMORY_BYTES = 4 << 30


def main() -> None:
    """Answer one request, within limits on memory, time and files."""
    import resource  # not everywhere; without it no manifest is read

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))  # it writes nothing
    for kind, most in ((resource.RLIMIT_AS, MEMORY_BYTES), (resource.RLIMIT_CPU, math.ceil(SECONDS))):
        ceiling = resource.getrlimit(kind)[1]
        if ceiling != resource.RLIM_INFINITY:
            most = min(most, ceiling)
        resource.setrlimit(kind, (most, most))
    request = json.load(sys.stdin)
    try:
        store = bytes.fromhex(request["store"])
        found = parse(Path(request["model"]), request["media_type"], store, request["anchors"])
    except InputError as error:
        found = {"reason": str(error)}
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main()
