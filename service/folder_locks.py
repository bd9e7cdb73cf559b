"""What only one process at a time may do in a data folder: `serve` with workers, and work under one name.

API processes without workers, and workers of other names, share the folder. The locks are the operating system's, so
that they end with their process, however it dies; what stands in their files is for people.
"""

import fcntl
import logging
import os
import secrets
import socket
import time
from pathlib import Path
from typing import IO

from engine.errors import InputError
from service.clock import now

POLL_SECONDS = 0.1
_log = logging.getLogger(__name__)


def hold(data_dir: Path, name: str, patience: float = 0.0) -> IO[str]:
    """The file that locks `name`, for as long as it is open; InputError says who has it after `patience` seconds."""
    folder = data_dir / "locks"
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    file = (folder / name).open("a+")
    until = time.monotonic() + patience
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() < until:
                time.sleep(POLL_SECONDS)
                continue
            file.seek(0)
            holder = file.read().strip() or "another process"
            file.close()
            text = (
                f"{name!r} is already at work in {data_dir}: {holder}. Stop it first; 'serve --workers 0', and 'worker'"
            )
            raise InputError(f"{text} under another name, can run as well") from None
        except OSError as error:
            _log.warning("%s cannot be locked (%s): run no second 'mark3dgs serve' in it", data_dir, error.strerror)
        file.truncate(0)
        file.write(f"process {os.getpid()} on {socket.gethostname()}, since {now()}\n")
        file.flush()
        return file


def crew_names(data_dir: Path, count: int) -> list[str]:
    """Names of the workers that `serve` starts: the same at the next start, and others in every other data folder."""
    path = data_dir / "locks" / "id"
    if not path.exists():
        path.write_text(secrets.token_hex(4))
    return [f"local-{path.read_text()}-{number}" for number in range(1, count + 1)]
