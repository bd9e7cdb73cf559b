"""Checking messages of a webhook, for their receivers.

A message is signed in the header `Mark3DGS-Signature: t=SECONDS,v1=HEX`, HEX being the HMAC-SHA256 of "SECONDS.BODY"
under the webhook's secret, SECONDS when it was sent (Unix time).
"""

import hmac
import json
import re
import time

from service.client.answers import Event, Job, Notice, read
from service.client.errors import ServiceError

HEADER = "Mark3DGS-Signature"
TOLERANCE = 300.0
"""Seconds that a message may have been on its way; an older one may be a replay."""


def signature(secret: str, at: int, body: bytes) -> str:
    """The header of a message that is sent at a time (Unix, seconds)."""
    return f"t={at},v1={hmac.digest(secret.encode(), b'%d.%s' % (at, body), 'sha256').hex()}"


def check_webhook(secret: str, header: str, body: bytes, tolerance: float = TOLERANCE) -> Event:
    """The content of a message, if it is the service's and new; ServiceError "untrusted" otherwise.

    Parameters
    ----------
    secret : str
        whs_..., as `add_webhook` showed it.
    header : str
        Mark3DGS-Signature of the request.
    body : bytes
        As it came, before any parsing.
    tolerance : float
        Seconds by which the message's time may differ from this machine's clock. Within it a message may come twice,
        as it may after a broken connection: `job.id` or `notice.id` tells.
    """
    found = re.fullmatch(r"t=(\d{1,15}),v1=[0-9a-f]{64}", header, re.ASCII)
    if found is None or not hmac.compare_digest(signature(secret, int(found[1]), body), header):
        raise ServiceError("untrusted", "the message is not signed with this webhook's secret")
    if abs(time.time() - int(found[1])) > tolerance:
        raise ServiceError("untrusted", f"the message was sent {time.time() - int(found[1]):.0f} s ago")
    plain = json.loads(body)
    job = read(Job, plain["job"]) if "job" in plain else None
    notice = read(Notice, plain["notice"]) if "notice" in plain else None
    return Event(plain["event"], plain["at"], job, notice)
