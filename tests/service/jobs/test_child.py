"""A task in a process of its own: the protocol, the limits, the ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from service.problems import Problem
from service.processes import SECONDS_BETWEEN_LOOKS, Cancelled, Children, Limits, Stopped
from tests.service.jobs.toy_worker import CHILD

LIMITS = Limits(memory_bytes=1 << 30, cpu_seconds=1, file_bytes=1 << 20)


@pytest.fixture
def children() -> Iterator[Children]:
    made = Children(LIMITS, CHILD)
    yield made
    made.stop()


def alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except (FileNotFoundError, ProcessLookupError):  # it ended before the file was opened, or before it was read
        return False
    return state != "Z"


def gone_within(pid: int, seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    while alive(pid) and time.monotonic() < deadline:
        time.sleep(0.01)
    return not alive(pid)


def pid_in(file: Path) -> int:
    deadline = time.monotonic() + 10
    while not (file.exists() and file.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return int(file.read_text())


def test_a_reply(children: Children, tmp_path: Path) -> None:
    request = {"text": "ä\nb", "numbers": [1, 2.5, None]}
    reply = children.run("echo", request, tmp_path)
    assert reply["request"] == request
    assert (tmp_path / "file").read_text() == "made"
    assert reply["nice"] >= 5


def test_every_task_has_a_fresh_process_forked_of_the_one_that_stands_ready(children: Children, tmp_path: Path) -> None:
    children.prepare()
    spare = children._spare
    assert spare is not None
    while spare.lines.empty():  # until then it is done by that process itself
        time.sleep(0.01)
    replies = [children.run("echo", {}, tmp_path) for _ in range(3)]
    assert {reply["parent"] for reply in replies} == {spare.popen.pid}
    assert len({reply["pid"] for reply in replies}) == 3
    assert not any(alive(reply["pid"]) for reply in replies)
    assert children._spare is spare
    children.stop()
    assert gone_within(spare.popen.pid, 10.0)


def test_a_fork_that_died_takes_the_ready_process_with_it(children: Children, tmp_path: Path) -> None:
    """What it started lives in their group, and is killed with it."""
    children.prepare()
    spare = children._spare
    assert spare is not None
    with pytest.raises(Problem, match="SIGSEGV"):
        children.run("die", {"signal": "SIGSEGV"}, tmp_path)
    assert gone_within(spare.popen.pid, 10.0)
    assert children._spare is not spare


def test_a_spare_that_died_is_replaced(children: Children, tmp_path: Path) -> None:
    children.prepare()
    spare = children._spare
    assert spare is not None
    os.kill(spare.popen.pid, signal.SIGKILL)
    spare.popen.wait()
    assert children.run("echo", {"n": 1}, tmp_path)["request"] == {"n": 1}


def test_a_large_request(children: Children, tmp_path: Path) -> None:
    request = {"candidates": ["x" * 1000] * 2000}
    assert children.run("echo", request, tmp_path)["request"] == request


def test_a_task_may_ask_who_runs_it(children: Children, tmp_path: Path) -> None:
    calls: list[str] = []

    def answer(question: str) -> str:
        calls.append(question)
        return question.upper()

    request = {"questions": ["one", "two" * 50_000]}
    reply = children.run("ask", request, tmp_path, answer=answer)
    assert reply == {"answers": ["ONE", "TWO" * 50_000]}
    assert calls == request["questions"]
    with pytest.raises(Problem, match="no answers"):
        children.run("ask", request, tmp_path)

    def refuse(question: str) -> str:
        raise Problem("no-time-stamp", "closed today")

    with pytest.raises(Problem, match="closed today"):
        children.run("ask", request, tmp_path, answer=refuse)
    assert children.run("echo", {"n": 1}, tmp_path)["request"] == {"n": 1}, "goes on with the next"


def test_stray_prints_do_not_break_the_protocol(
    children: Children, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert children.run("chat", {}, tmp_path) == {"said": "the right thing"}
    assert "a line of a library in C" in capfd.readouterr().err


def test_secrets_of_the_service_stay_with_it(
    children: Children, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MARK3DGS_MASTER_KEY", "ab" * 32)
    monkeypatch.setenv("MARK3DGS_DATABASE_URL", "postgresql://user:password@host/db")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    seen = children.run("environment", {}, tmp_path)
    assert not [name for name in seen if name.startswith(("MARK3DGS", "AWS"))]
    assert seen["NUMBA_NUM_THREADS"] == "2"
    assert seen["TMPDIR"] == str(tmp_path), "temporary files of libraries go with the step's folder"


def test_progress_comes_with_stage_and_fraction(children: Children, tmp_path: Path) -> None:
    heard: list[tuple[str, float]] = []

    def go_on(stage: str, fraction: float) -> bool:
        heard.append((stage, fraction))
        return True

    children.run("nap", {"pid_file": str(tmp_path / "pid"), "seconds": 1.2}, tmp_path, go_on)
    assert 2 <= len(heard) <= 1.2 / SECONDS_BETWEEN_LOOKS + 2, "about three times a second, also in silence"


def test_cancelling_kills_within_a_second(children: Children, tmp_path: Path) -> None:
    """At the next look, that is: on a busy machine a second is none."""
    file = tmp_path / "pid"
    cancelled = threading.Event()
    found: list[BaseException] = []
    refused: list[str] = []

    def go_on(stage: str, fraction: float) -> bool:
        if cancelled.is_set():
            refused.append(stage)
        return not cancelled.is_set()

    def work() -> None:
        try:
            children.run("nap", {"pid_file": str(file)}, tmp_path, go_on)
        except BaseException as error:
            found.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    pid = pid_in(file)
    cancelled.set()
    assert gone_within(pid, 10.0)
    thread.join()
    assert isinstance(found[0], Cancelled)
    assert len(refused) == 1
    assert SECONDS_BETWEEN_LOOKS < 0.5


def test_stopping_kills_the_task_and_the_spare(tmp_path: Path) -> None:
    children = Children(LIMITS, CHILD)
    file = tmp_path / "pid"
    threading.Timer(0.5, children.stop).start()
    with pytest.raises(Stopped):
        children.run("nap", {"pid_file": str(file)}, tmp_path)
    assert gone_within(int(file.read_text()), 10.0)
    assert children._spare is None
    with pytest.raises(Stopped):
        children.run("echo", {}, tmp_path)


@pytest.mark.parametrize(
    ("task", "request_", "says"),
    [
        ("allocate", {"bytes": 2 << 30}, "memory"),
        ("spin", {}, "1 s of CPU time"),
        ("write", {"bytes": 2 << 20}, "larger file"),
        ("die", {"signal": "SIGSEGV"}, "SIGSEGV"),
        ("die", {"signal": "SIGKILL"}, "SIGKILL; the machine may be out of memory"),
    ],
)
def test_limits_and_deaths_are_told_apart(
    children: Children, tmp_path: Path, task: str, request_: dict[str, Any], says: str
) -> None:
    with pytest.raises(Problem, match=says) as caught:
        children.run(task, request_, tmp_path)
    assert caught.value.kind == "engine-limit"
    assert children.run("echo", {}, tmp_path), "the next task is not touched by it"


def test_a_task_that_hangs_is_ended_by_the_clock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Limits, "seconds", 1)
    children = Children(LIMITS, CHILD)
    with pytest.raises(Problem, match="no result within 1 s") as caught:
        children.run("nap", {"pid_file": str(tmp_path / "pid")}, tmp_path)
    children.stop()
    assert caught.value.kind == "engine-limit"
    assert gone_within(int((tmp_path / "pid").read_text()), 1.0)


@pytest.mark.parametrize("command", [("true",), (sys.executable, "-c", "input(); print('nonsense')")])
def test_a_process_that_does_not_answer_is_a_fault_of_ours(command: tuple[str, ...], tmp_path: Path) -> None:
    children = Children(LIMITS, command)
    with pytest.raises(Problem) as caught:
        children.run("echo", {}, tmp_path)
    children.stop()
    assert caught.value.kind == "internal"


def test_leaving_without_an_answer_is_a_fault_of_ours(children: Children, tmp_path: Path) -> None:
    with pytest.raises(Problem, match="without an answer"):
        children.run("leave", {}, tmp_path)


@pytest.mark.parametrize("task", ["nap", "echo"])
def test_the_processes_die_with_their_parent(task: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """While a task runs, and while one is waited for; in silence."""
    file, ready = tmp_path / "pid", tmp_path / "ready"
    code = f"""
import time
from pathlib import Path
from service.processes import Children, Limits
from tests.service.jobs.toy_worker import CHILD
children = Children(Limits(1 << 30, 60, 1 << 20), CHILD)
children.prepare()
while children._spare.lines.empty():
    time.sleep(0.01)
Path({str(ready)!r}).write_text(str(children._spare.popen.pid))
children.run({task!r}, {{"pid_file": {str(file)!r}}}, Path({str(tmp_path)!r}))
Path({str(file)!r}).write_text("0")
time.sleep(60)
"""
    parent = subprocess.Popen([sys.executable, "-c", code], cwd=Path(__file__).parents[3])
    pid = pid_in(file)
    parent.kill()
    parent.wait()
    assert not pid or gone_within(pid, 1.0)
    assert gone_within(pid_in(ready), 10.0)
    assert not capfd.readouterr().err
