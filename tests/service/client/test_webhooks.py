"""What makes a receiver sure of a webhook's message: its signature, compared in constant time, and its age."""

from __future__ import annotations

import hashlib
import hmac
import json
import time
from typing import Any

import pytest

from service.client import ServiceError, check_webhook
from tests.service.client.driving import job

SECRET = "whs_" + "5a" * 32
BODY = json.dumps(
    {"event": "job.ended", "at": "2026-01-01T00:00:00+00:00", "job": job("succeeded", result={})}
).encode()


def header(at: int, secret: str = SECRET, body: bytes = BODY) -> str:
    """As docs/SERVICE.md says it, in other words than the client's."""
    digest = hmac.new(secret.encode(), str(at).encode() + b"." + body, hashlib.sha256).hexdigest()
    return f"t={at},v1={digest}"


def now() -> int:
    return int(time.time())


def test_a_message_says_which_job_ended() -> None:
    event = check_webhook(SECRET, header(now()), BODY)
    assert (event.event, event.at) == ("job.ended", "2026-01-01T00:00:00+00:00")
    assert (event.job.id, event.job.state, event.job.ended) == ("job_1", "succeeded", True)


@pytest.mark.parametrize(
    ("secret", "body"),
    [(SECRET[:-1] + "b", BODY), ("", BODY), (SECRET, BODY + b" "), (SECRET, BODY[:-1]), (SECRET, b"")],
)
def test_another_secret_or_body(secret: str, body: bytes) -> None:
    with pytest.raises(ServiceError, match="untrusted: the message is not signed"):
        check_webhook(secret, header(now()), body)


@pytest.mark.parametrize("seconds", [-301, 302, -86400])
def test_a_message_of_another_time_is_a_repetition(seconds: int) -> None:
    with pytest.raises(ServiceError, match="untrusted: the message was sent"):
        check_webhook(SECRET, header(now() + seconds), BODY)


def test_the_window_is_the_receivers_to_set() -> None:
    check_webhook(SECRET, header(now() - 290), BODY)
    check_webhook(SECRET, header(now() - 500), BODY, 600)
    with pytest.raises(ServiceError, match="untrusted"):
        check_webhook(SECRET, header(now() - 20), BODY, tolerance=10)


def test_the_time_is_signed() -> None:
    _, _, digest = header(now() - 900).partition(",")
    with pytest.raises(ServiceError, match="not signed"):
        check_webhook(SECRET, f"t={now()},{digest}", BODY)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda good: "",
        lambda good: good.upper(),
        lambda good: good.replace("t=", "t=0"),
        lambda good: good + "0",
        lambda good: good + "\n",
        lambda good: good.replace("v1=", "v0="),
        lambda good: good[:-1] + "é",
        lambda good: good.replace("t=", "t=-"),
        lambda good: f"{good},v1={'0' * 64}",
        lambda good: "t=" + "9" * 400 + good[good.index(",") :],
    ],
)
def test_headers_that_are_none(wrong: Any) -> None:
    with pytest.raises(ServiceError, match="untrusted"):
        check_webhook(SECRET, wrong(header(now())), BODY)


def test_digests_are_compared_in_constant_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody learns from how long a refusal takes how much of a guess was right."""
    compared = []
    real = hmac.compare_digest
    monkeypatch.setattr(hmac, "compare_digest", lambda a, b: compared.append((a, b)) or real(a, b))
    good = header(now())
    check_webhook(SECRET, good, BODY)
    assert compared == [(good, good)]
