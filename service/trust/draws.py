"""Time stamps that draw a part of a record's plan (`engine.flows.records.draw`): requested once each, and kept.

An operator could try records out by repeated requests, which claims count; without a request nothing decides what is
drawn.
"""

import base64
from hashlib import sha256
from pathlib import Path

import sqlalchemy as sa
from cryptography.x509 import load_pem_x509_certificates

from engine.errors import InputError
from engine.records.timestamps import TimestampFault, check_stamp, stamp
from service.clock import now
from service.db import Database
from service.db.schema import draws
from service.problems import Problem
from service.settings import Settings


def vouching(settings: Settings) -> str:
    """Certificates (PEM) that vouch for the time-stamping service; "" where there are none and nothing is drawn.

    InputError where the file has none.
    """
    name = settings.tsa_certificates
    if not name:
        return ""
    try:
        text = Path(name).read_bytes()
        load_pem_x509_certificates(text)
        return text.decode("ascii")
    except (OSError, ValueError) as error:
        raise InputError(
            f"MARK3DGS_TSA_CERTIFICATES: {name!r} cannot be read as certificates in PEM: {error}"
        ) from None


def draws_for(settings: Settings) -> bool:
    """Whether records made here are drawn for by a time-stamping service."""
    return bool(settings.tsa_url and vouching(settings))


def stamp_to_draw(db: Database, settings: Settings, question: str) -> str:
    """The time stamp (reply, base64) of what is to be stamped for a plan (hexadecimal): the one that is kept, also
    where another job requested it at the same time, so that copies share what was drawn.

    no-time-stamp where the service gives none that holds.
    """
    request = bytes.fromhex(question)
    this = draws.c.request == sha256(request).hexdigest()
    kept = sa.select(draws.c.token).where(this)
    token: bytes | None = db.query(kept).scalar()
    if token is None:
        given = _ask(settings, request)
        with db.exclusive() as connection:
            token = connection.execute(kept).scalar()
            if token is None:
                values = {"request": sha256(request).hexdigest(), "token": given, "created_at": now()}
                connection.execute(draws.insert().values(values))
                token = given
    return base64.b64encode(token).decode()


def _ask(settings: Settings, request: bytes) -> bytes:
    stamped = stamp(settings.tsa_url, request)
    if stamped.token is None:
        raise Problem("no-time-stamp", f"{stamped.failure}: nothing was marked, try again later")
    try:
        check_stamp(stamped.token, request, load_pem_x509_certificates(vouching(settings).encode()))
    except TimestampFault as fault:
        raise Problem("no-time-stamp", f"{fault}: nothing was marked; the operator must look at it") from None
    return stamped.token
