"""Who may start a dispute between two assets: the operator, or both owners.

A consent is an entry of the audit log. It reveals nothing about whether another tenant's asset exists.
"""

import sqlalchemy as sa

from service.core import Service
from service.db.schema import assets
from service.problems import Problem
from service.trust import audit
from service.trust.api_keys import OPERATOR, Caller

CONSENTED = "dispute.consented"


def agreed(service: Service, caller: Caller, pair: tuple[str, str]) -> None:
    """Note the caller's consent to a dispute about two assets; "conflict" while that of the other owner lacks.

    "not-found" where neither asset is the caller's; a "conflict", too, where both are one.
    """
    if pair[0] == pair[1]:
        raise Problem("conflict", "a dispute is about two assets")
    owners = _owners(service, pair)
    if OPERATOR in caller.scopes:
        if len(owners) < 2:
            raise Problem("not-found", "there are no two such assets")
        return
    if caller.tenant not in owners.values():
        raise Problem("not-found", "neither asset is yours")
    with service.db.exclusive() as connection:
        _consent(connection, caller.tenant, pair)
        tenants = set(owners.values()) if len(owners) == 2 else {caller.tenant, None}
        waiting = [each for each in tenants if each is None or not _has_consented(connection, each, pair)]
    if waiting:
        text = "your consent is noted; the dispute begins when the owner of the other asset asks for it, too"
        raise Problem("conflict", text)


def _owners(service: Service, pair: tuple[str, str]) -> dict[str, str]:
    """Tenant of each of the assets that exist."""
    rows = service.db.query(sa.select(assets.c.id, assets.c.tenant).where(assets.c.id.in_(pair))).all()
    return {row.id: row.tenant for row in rows}


def _consent(connection: sa.Connection, tenant: str, pair: tuple[str, str]) -> None:
    if not _has_consented(connection, tenant, pair):
        payload = {"assets": sorted(pair)}
        audit.append(connection, tenant, CONSENTED, payload, _subject(tenant, pair))


def _has_consented(connection: sa.Connection, tenant: str, pair: tuple[str, str]) -> bool:
    return audit.find(connection, CONSENTED, _subject(tenant, pair)) is not None


def _subject(tenant: str, pair: tuple[str, str]) -> str:
    return " ".join((tenant, *sorted(pair)))
