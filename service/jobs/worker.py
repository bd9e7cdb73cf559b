"""A worker: a process that takes jobs one at a time, says that it lives, and takes over from those that do not."""

import logging
import os
import re
import secrets
import shutil
import signal
import socket
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from service.jobs import dbos_setup
from service.jobs.child import COMMAND, Children, Limits
from service.jobs.durable import DurableJobs
from service.jobs.port import Flow
from service.jobs.running import Runner
from service.settings import Settings

BEAT_SECONDS = 2.0
"""Between two signs of life; `worker_silence_seconds` is several of them."""

_LAST_WORDS_SECONDS = 2.0

_log = logging.getLogger(__name__)


class Worker:
    """One worker process; with `die_with_parent` it ends when standard input does. `command` starts a task's process.

    A worker that comes back under its `name` (letters, digits, dots and dashes) takes up its jobs at once; at most one
    process may use a name. Without one, a fresh name is made.
    """

    def __init__(
        self,
        settings: Settings,
        flows: Mapping[str, Flow],
        jobs: DurableJobs,
        *,
        name: str = "",
        die_with_parent: bool = False,
        command: Sequence[str] = COMMAND,
    ) -> None:
        self.name = name or _fresh_name()
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9.-]{0,99}", self.name):
            raise ValueError(f"no name of a worker: {self.name!r}")
        self._settings, self._jobs, self._die_with_parent = settings, jobs, die_with_parent
        self._stopping = threading.Event()
        self._idle: set[str] = set()
        self._children = Children(Limits.of(settings), command)
        scratch = _scratch(settings, self.name)
        self._runner = Runner(jobs, flows, self._children, scratch, self.name, self._stopping)

    def run(self) -> NoReturn:
        """Work until SIGTERM, SIGINT or the end of standard input; ends the process."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: self._stopping.set())
        if self._die_with_parent:
            threading.Thread(target=self._outlive_nobody, daemon=True).start()
        self._children.prepare()
        shutil.rmtree(_scratch(self._settings, self.name), ignore_errors=True)
        self._until_it_works(lambda: self._jobs.presence.beat(self.name))
        threading.Thread(target=self._beat, daemon=True).start()
        self._until_it_works(self._launch)
        while not self._stopping.wait(BEAT_SECONDS):
            self._watch()
        self._end()

    def _launch(self) -> None:
        """Start DBOS in this process; jobs begin to run. Those of an earlier process of our name go first."""
        from dbos import DBOS

        self._jobs.requeue(self.name, self._jobs.held(self.name))
        DBOS(config=dbos_setup.configuration(self._jobs.url, self.name))

        @DBOS.workflow(name=dbos_setup.WORKFLOW, max_recovery_attempts=None)  # we count, by step
        def job(job_id: str) -> None:
            self._runner.run(job_id)

        try:
            DBOS.launch()
            DBOS.register_queue(
                dbos_setup.QUEUE,
                worker_concurrency=1,
                polling_interval_sec=dbos_setup.SECONDS_BETWEEN_POLLS,
                on_conflict="always_update",
            )
        except Exception:
            DBOS.destroy(destroy_registry=True)
            raise
        _log.info("worker %s is ready", self.name)

    def _until_it_works(self, call: Callable[[], Any]) -> None:
        """The database may start later than we do."""
        while not self._stopping.is_set():
            try:
                call()
                return
            except Exception as error:
                _log.warning("worker %s cannot start yet: %s", self.name, error)
            self._stopping.wait(BEAT_SECONDS)
        self._end()

    def _beat(self) -> None:
        # A thread of its own, so that taking over a hundred jobs does not make us look dead.
        well = True
        while not self._stopping.wait(BEAT_SECONDS):
            try:
                self._jobs.presence.beat(self.name)
                well = True
            except Exception as error:
                if well:
                    _log.warning("worker %s cannot say that it lives: %s", self.name, error)
                well = False

    def _watch(self) -> None:
        try:
            for silent in self._jobs.recover(self._settings.worker_silence_seconds, self.name):
                _log.warning("worker %s is silent; its jobs are taken over", silent)
                shutil.rmtree(_scratch(self._settings, silent), ignore_errors=True)
            self._jobs.reconcile()
            # A job taken from the queue in the moment the database went away may be ours and yet not run.
            idle = self._jobs.held(self.name) - self._runner.active
            self._jobs.requeue(self.name, idle & self._idle)
            self._idle = idle
        except Exception as error:
            _log.warning("worker %s cannot watch over the others: %s", self.name, error)

    def _outlive_nobody(self) -> None:
        while os.read(0, 1 << 12):
            pass
        self._stopping.set()

    def _end(self) -> NoReturn:
        """End as a killed worker would, but with a word: whoever lives takes up our job at its last finished step."""
        self._children.stop()
        last_words = threading.Thread(target=self._leave, daemon=True)
        last_words.start()
        last_words.join(_LAST_WORDS_SECONDS)
        shutil.rmtree(_scratch(self._settings, self.name), ignore_errors=True)
        _log.info("worker %s ends", self.name)
        logging.shutdown()
        os._exit(0)

    def _leave(self) -> None:
        try:
            self._jobs.handed_back(self.name)
            self._jobs.presence.leave(self.name)
        except Exception as error:
            _log.warning("worker %s ends without a word: %s", self.name, error)


def _scratch(settings: Settings, worker: str) -> Path:
    return (settings.scratch / "work" / worker).absolute()


def _fresh_name() -> str:
    host = re.sub(r"[^A-Za-z0-9]", "-", socket.gethostname()).strip("-")[:60] or "host"
    return f"{host}-{os.getpid()}-{secrets.token_hex(3)}"
