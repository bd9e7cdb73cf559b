"""A database server that is away when a process starts is waited for; one that refuses the settings is not."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import psycopg
import pytest

from service.settings import Settings
from tests.service import serving
from tests.service.cli.conftest import Mark3dgs
from tests.service.postgres import Postgres

MASTER = "ab" * 32


@pytest.fixture(scope="module")
def server(postgres: Postgres) -> Iterator[Postgres]:
    """One to stop; the session's is for all. Skips where there is none."""
    made = Postgres()
    yield made
    made.close()


def test_serve_and_its_worker_wait_for_the_database(server: Postgres, tmp_path: Path) -> None:
    url = server.new_database("waited")
    server.stop()
    environment = {k: v for k, v in os.environ.items() if not k.startswith("MARK3DGS_")}
    environment |= {"MARK3DGS_DATA_DIR": str(tmp_path / "data"), "MARK3DGS_DATABASE_URL": url}
    environment |= {"MARK3DGS_MASTER_KEY": MASTER}
    log, port = tmp_path / "log.txt", serving.free_port()
    started = list[subprocess.Popen[bytes]]()

    def start(*arguments: str) -> None:
        command = [sys.executable, "-m", "service.cli", *arguments]
        with log.open("ab") as out:
            started.append(
                subprocess.Popen(command, cwd=serving.ROOT, env=environment, stdin=-1, stdout=out, stderr=out)
            )

    def waiting(count: int) -> None:
        for _ in range(600):
            if log.read_text().count(f"127.0.0.1:{server.port} does not answer: start it") >= count:
                return
            assert started[-1].poll() is None, log.read_text()
            time.sleep(0.1)
        pytest.fail(log.read_text())

    try:
        start("serve", "--port", str(port), "--workers", "0")
        waiting(2)
        server.start()
        serving.wait_until_up(started[0], f"http://127.0.0.1:{port}", log)
        server.stop()
        log.write_text("")
        start("worker", "--die-with-parent")
        waiting(2)
        server.start()
        for _ in range(600):
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{port}/readyz", timeout=30) as answer:
                    assert answer.status == 200
                    break
            except urllib.error.HTTPError:
                assert started[1].poll() is None, log.read_text()
                time.sleep(0.1)
        else:
            pytest.fail(log.read_text())
        server.stop()
        log.write_text("")
        start("worker", "--die-with-parent")
        waiting(1)
        _, _, orphan = started
        assert orphan.stdin is not None
        orphan.stdin.close()
        assert orphan.wait(20) == 0, "its parent has ended"
    finally:
        for process in started:
            process.kill()
            process.wait()
        server.start()


def test_the_wait_ends(server: Postgres, mark3dgs: Mark3dgs, caplog: pytest.LogCaptureFixture) -> None:
    server.stop()
    try:
        for command in (["worker"], ["serve", "--port", "0", "--workers", "0"]):
            caplog.clear()
            settings = {"DATABASE_URL": server.url("x"), "MASTER_KEY": MASTER, "DATABASE_WAIT_SECONDS": "4"}
            code, _, err = mark3dgs(*command, **settings)
            assert code == 1
            assert f"127.0.0.1:{server.port} does not answer" in err
            assert "MARK3DGS_DATABASE_URL (waited for 4 s)" in err
            pauses = [float(each) for each in re.findall(r"follows in ([\d.]+) s", caplog.text)]
            assert pauses == [0.5, 1.0, 2.0][: len(pauses)]
            assert len(pauses) > 1
    finally:
        server.start()


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        ("name", 'database "nowhere" does not exist'),
        ("password", "password authentication failed for user"),
        ("schema", "a later version of this program has changed this database"),
    ],
)
@pytest.mark.parametrize("command", [["worker"], ["serve", "--port", "0", "--workers", "0"]], ids=["worker", "serve"])
def test_what_waiting_cannot_mend_ends_at_once(
    server: Postgres, mark3dgs: Mark3dgs, caplog: pytest.LogCaptureFixture, command: list[str], fault: str, text: str
) -> None:
    name = f"{fault}_{command[0]}"
    url = server.new_database(name)
    if fault == "name":
        url = server.url("nowhere")
    elif fault == "password":
        with psycopg.connect(url, autocommit=True) as connection:
            connection.execute(f"CREATE ROLE {name} LOGIN PASSWORD 'right'".encode())
            path = server.folder / "data" / "pg_hba.conf"
            path.write_text(f"host all {name} 127.0.0.1/32 scram-sha-256\n{path.read_text()}")
            connection.execute("SELECT pg_reload_conf()")
        url = url.replace("postgres@", f"{name}:not-the-right-one@")
    else:
        assert mark3dgs("init", DATABASE_URL=url, MASTER_KEY=MASTER)[0] == 0
        with psycopg.connect(url, autocommit=True) as connection:
            connection.execute("UPDATE alembic_version SET version_num = '9999'")
    began = time.monotonic()
    code, _, err = mark3dgs(*command, DATABASE_URL=url, MASTER_KEY=MASTER)
    assert (code, text in err) == (2, True), err
    assert "not-the-right-one" not in err + caplog.text
    assert "follows in" not in caplog.text
    assert time.monotonic() - began < Settings().database_wait_seconds / 10
