"""A job ends in a worker of its own, and its tenant's receiver knows it to be true."""

from __future__ import annotations

import time
from pathlib import Path

from service.client import Client, check_webhook
from tests.service import serving
from tests.service.api.conftest import SMALL
from tests.service.webhooks.conftest import Receivers, receivers

__all__ = ["receivers"]


def test_a_receiver_is_told(tmp_path: Path, receivers: Receivers) -> None:
    receiver = receivers()
    served = serving.start(tmp_path, lean=True, WEBHOOKS_PRIVATE="1")
    try:
        with Client(served.address, served.api_key) as client:
            hook = client.add_webhook(f"http://127.0.0.1:{receiver.port}/")
            job = client.submit_verify(SMALL.read_bytes())  # against nothing: it fails at once
            until = time.monotonic() + 60
            while not (receiver.got and client.webhooks()[0].last_status) and time.monotonic() < until:
                time.sleep(0.2)
            (output,) = client.webhooks()
            ended = client.job(job.id)
    finally:
        served.stop()
    ((_, headers, body),) = receiver.got
    event = check_webhook(hook.secret or "", headers["mark3dgs-signature"], body)
    assert (event.job, event.job.state) == (ended, "failed")
    assert (output.last_status, output.last_outcome, output.waiting) == (204, "delivered", 0)
