"""Several processes in one data folder: those that would disturb each other are refused, the others are not."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from engine.errors import InputError
from service.core import Service
from service.folder_locks import crew_names, hold
from service.jobs import runner
from service.settings import Settings
from tests.service import serving
from tests.service.cli.conftest import Mark3dgs


def test_a_second_serve_is_refused_until_the_first_is_gone(tmp_path: Path, mark3dgs: Mark3dgs) -> None:
    first = serving.start(tmp_path)
    try:
        code, _, said = mark3dgs("serve", "--port", "0")
        assert code == 2
        assert f"process {first.process.pid} on " in said
        beside = serving.start(tmp_path, workers=0, api_key=first.api_key)
        beside.stop()
    finally:
        first.process.send_signal(signal.SIGKILL)
        first.process.wait()
    again = serving.start(tmp_path, api_key=first.api_key)
    try:
        ready = f"{again.address}/readyz"
        for _ in range(200):  # its worker waits for the one that the first left
            probe = subprocess.run([sys.executable, "-c", _ASK, ready], capture_output=True, text=True, check=False)
            if probe.stdout.strip() == "200":
                break
            time.sleep(0.1)
        assert probe.stdout.strip() == "200", again.log()
        assert "ended with status" not in again.log(), "its worker starts once"
    finally:
        again.stop()


_ASK = """import sys, urllib.request
try: print(urllib.request.urlopen(sys.argv[1]).status)
except OSError as error: print(error)"""


def test_a_taken_port_is_refused_with_what_to_do(mark3dgs: Mark3dgs) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        code, _, said = mark3dgs("serve", "--port", str(port))
    assert code == 2
    assert f"127.0.0.1:{port}" in said
    assert "--port" in said


def test_a_lock_names_its_holder_and_ends_with_it(tmp_path: Path) -> None:
    held = hold(tmp_path, "worker-a")
    with pytest.raises(InputError, match=r"'worker-a' is already at work in .*: process \d+ on \S+, since 20"):
        hold(tmp_path, "worker-a", patience=0.3)
    hold(tmp_path, "worker-b").close()
    held.close()
    hold(tmp_path, "worker-a").close()


def test_a_dead_holder_blocks_nobody(tmp_path: Path) -> None:
    script = (
        f"from service.folder_locks import hold; from pathlib import Path; f = hold(Path({str(tmp_path)!r}), 'serve')"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", f"{script}; print('held', flush=True); input()"], stdout=-1, stdin=-1
    )
    assert process.stdout is not None
    process.stdout.readline()
    with pytest.raises(InputError, match=f"process {process.pid} "):
        hold(tmp_path, "serve")
    process.kill()
    process.wait()
    hold(tmp_path, "serve").close()


def test_workers_of_two_folders_have_different_names(tmp_path: Path) -> None:
    """Those of two machines share a database; a worker that comes back under its name goes on at once."""
    for name in ("a", "b"):
        hold(tmp_path / name, "serve")
    first, second = (crew_names(tmp_path / name, 2) for name in ("a", "b"))
    assert len({*first, *second}) == 4
    assert crew_names(tmp_path / "a", 2) == first


def test_two_workers_never_have_one_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each would take the other's jobs for its own, and delete its scratch."""
    monkeypatch.setattr(runner, "PREDECESSOR_SECONDS", 0.1)
    service = Service.open(Settings(data_dir=tmp_path))
    first = runner.Worker(service.settings, {}, service.jobs, name="a")
    with pytest.raises(InputError, match="'worker-a' is already at work"):
        runner.Worker(service.settings, {}, service.jobs, name="a")
    assert runner.Worker(service.settings, {}, service.jobs, name="b").name != first.name
    service.close()
