"""Issuing a claim: one transaction logs, signs and stores it. Twice for one job is once."""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from engine.present.reading import reading_of
from engine.records.timestamps import stamp
from service.claims.document import Registered, build_document, document_reading, no_pack
from service.claims.schema import ClaimDocument, Document
from service.clock import now
from service.core import Service
from service.db import Database, take_write_lock
from service.db.schema import acquisitions, assets, claims
from service.jobs.port import Job
from service.problems import Problem
from service.settings import Settings
from service.trust import audit
from service.trust.api_keys import display_name
from service.trust.canonical import canonical
from service.trust.commitments import ACQUISITION_MADE, acquisition_facts, commit_claim, registration_of
from service.trust.master import MasterKey
from service.trust.signing import sign


@dataclass(frozen=True)
class IssuedClaim:
    """A claim as it is stored: `document` is the signed payload, `jws` the signature with it."""

    id: str
    document: Document
    jws: str


def issue(service: Service, job: Job, reply: Mapping[str, Any]) -> Mapping[str, Any]:
    """The claim of a verify job (`reply`: what was found), issued and, where a time-stamping service is set, stamped.

    Returns the job's result.
    """
    issuer = {"name": service.settings.issuer_name, "address": service.public_url()}
    with service.db.write() as connection:
        claim = issue_claim(connection, service.master, job, reply, issuer)
    result: dict[str, Any] = {
        **document_reading(claim.document),
        "claim_id": claim.id,
        "asset_id": claim.document["asset"],
        "checks": claim.document["checks"],
        "others": _others(service.db, job.tenant, reply.get("others", ())),
        "links": links_of(claim.document, service.settings),
    }
    url = service.settings.tsa_url
    if url and (failure := stamp_claim(service.db, url, claim)):
        result["timestamp_failure"] = failure
    return result


def links_of(document: Document, settings: Settings) -> dict[str, str]:
    """Where a claim and what belongs to it are, as paths of the API; a pack where there are packs."""
    claim = f"/v1/claims/{document['claim_id']}"
    links = {"claim": claim, "jws": f"{claim}.jws", "report": f"{claim}/report", "annex": f"{claim}/annex"}
    links |= {"asset": f"/v1/assets/{document['asset']}"} if document["asset"] else {}
    packed = settings.has_router("packs") and not no_pack(document)
    return links | ({"pack": f"{claim}/pack"} if packed else {})


def _others(db: Database, tenant: str, claims: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Readings of further assets of the tenant."""
    mine = (assets.c.tenant == tenant) & assets.c.id.in_([each["asset"] for each in claims])
    rows = {row.id: row for row in db.query(sa.select(assets.c.id, assets.c.copy, assets.c.message).where(mine))}
    there = [(rows[each["asset"]], each["claim"]) for each in claims if each["asset"] in rows]
    return [
        reading_of(claim, row.message).to_json() | {"asset_id": row.id, "copy_name": row.copy} for row, claim in there
    ]


def issue_claim(
    connection: sa.Connection,
    master: MasterKey,
    job: Job,
    reply: Mapping[str, Any],
    issuer: Mapping[str, str] | None = None,
) -> IssuedClaim:
    """Log, sign and store the claim of a verification, in a transaction; a job that has a claim keeps it.

    `reply` is of `service.claims.document.of_what_was_found`; `issuer` names this service.
    "conflict" where the acquisition was deleted meanwhile,
    "internal" where the reply names an asset that the tenant or the log does not have.
    """
    take_write_lock(connection)
    query = sa.select(claims.c.id, claims.c.document, claims.c.jws).where(claims.c.job == job.id)
    if (row := connection.execute(query).one_or_none()) is not None:
        return IssuedClaim(row.id, json.loads(row.document), row.jws)
    tenant, request = job.tenant, job.request
    registered = _registered(connection, tenant, reply["asset"])
    acquired = entry = None
    if (acquisition := request.get("acquisition_id")) is not None:
        acquired = _acquired(connection, tenant, acquisition)
        entry = audit.find(connection, ACQUISITION_MADE, acquisition)
    claim_id, created_at = "cl_" + job.id.removeprefix("job_"), now()
    document = build_document(
        reply,
        [request["model"]] if request["model"] else request["images"],
        registered,
        claim_id=claim_id,
        created_at=created_at,
        issuer=issuer,
        owner=display_name(connection, tenant),
        acquisition=acquired,
    )
    document["audit"] = commit_claim(connection, tenant, document, registered.registration, registered.first, entry)
    payload = canonical(ClaimDocument.model_validate(document).model_dump(by_alias=True))
    jws = sign(connection, master, payload)
    names = request.get("names", ())  # jobs of earlier versions have none
    values = {"id": claim_id, "tenant": tenant, "job": job.id, "asset": document["asset"], "created_at": created_at}
    values |= {"document": payload.decode(), "jws": jws, "pictures": canonical(reply["kept"]).decode()}
    values |= {"verdict": document["verdict"], "names": "\n".join(" ".join(name.split()) for name in names)}
    connection.execute(claims.insert().values(values))
    return IssuedClaim(claim_id, json.loads(payload), jws)


def stamp_claim(db: Database, url: str, claim: IssuedClaim) -> str:
    """Request a time stamp and keep it with the claim. Returns why there is none, or "" if there is one.

    A claim that has a stamp keeps it. Never raises for the time-stamping service's sake.
    """
    with db.read() as connection:
        query = sa.select(claims.c.timestamp).where(claims.c.id == claim.id)
        if connection.execute(query).scalar_one() is not None:
            return ""
    stamped = stamp(url, claim.jws.encode())
    if stamped.token is None:
        return stamped.failure
    with db.write() as connection:
        this = sa.and_(claims.c.id == claim.id, claims.c.timestamp.is_(None))
        connection.execute(claims.update().where(this).values(timestamp=stamped.token))
    return ""


def _acquired(connection: sa.Connection, tenant: str, acquisition: str) -> dict[str, str | None]:
    """An acquisition as a claim has it."""
    mine = (acquisitions.c.tenant == tenant) & (acquisitions.c.id == acquisition)
    row = connection.execute(acquisitions.select().where(mine)).one_or_none()
    if row is None:
        raise Problem("conflict", f"the acquisition {acquisition!r} was deleted")
    stamped = base64.b64encode(row.timestamp).decode() if row.timestamp is not None else None
    return acquisition_facts(row._asdict()) | {"timestamp": stamped}


def _registered(connection: sa.Connection, tenant: str, asset_id: str | None) -> Registered:
    if asset_id is None:
        return Registered()
    mine = assets.c.tenant == tenant
    row = connection.execute(assets.select().where(mine, assets.c.id == asset_id)).one_or_none()
    if row is None:
        raise Problem("conflict", "the asset in question was deleted, or is not this tenant's")
    same = sa.select(assets.c.id).where(mine, assets.c.original_sha256 == row.original_sha256)
    entries = [registration_of(connection, name) for name in connection.execute(same).scalars()]
    first = min(entries, key=lambda entry: entry.index)
    own = next(entry for entry in entries if entry.subject == asset_id)
    return Registered(row._asdict(), own, first)
