"""What handlers get: the service, the caller (and whether it may), and the page of a list."""

from collections.abc import Callable
from typing import Annotated, Any, Generic, Self, TypeVar

import sqlalchemy as sa
from fastapi import Depends, Query, Request
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from pydantic import BaseModel

from service.core import Service
from service.db import missing, own, page
from service.problems import Problem
from service.trust.api_keys import OPERATOR, Caller, check

_bearer = HTTPBearer(auto_error=False, scheme_name="apiKey", description="API key: mk_<id>_<secret>")


def service_of(request: Request) -> Service:
    """The service that this app serves."""
    service: Service = request.app.state.service
    return service


Core = Annotated[Service, Depends(service_of)]


async def check_address(request: Request) -> None:
    """invalid-request for a path or query with a NUL: no text of a database holds one, so nothing has such a name."""
    if "\0" in request.scope["path"] or "%00" in request.scope["query_string"].decode("latin-1"):
        raise Problem("invalid-request", "an address must not hold NUL characters (%00)")


def identify(service: Service, token: str | None) -> Caller:
    """The caller of a request, by its API key; unauthorized without a valid one."""
    if token is None:
        raise Problem("unauthorized", "send the header 'Authorization: Bearer mk_...'")
    return check(service.db, service.master, token)


def _caller(core: Core, credentials: Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)]) -> Caller:
    return identify(core, None if credentials is None else credentials.credentials)


def may(*scopes: str) -> Callable[..., Caller]:
    """Dependency: a caller whose key has one of these scopes (admin has all but the operator's)."""

    def allowed(caller: Annotated[Caller, Depends(_caller)]) -> Caller:
        if not caller.may(*scopes):
            raise Problem("forbidden", f"this API key lacks the scope {' or '.join(map(repr, scopes))}")
        return caller

    return allowed


Anyone = Annotated[Caller, Depends(_caller)]
Reader = Annotated[Caller, Depends(may("read"))]
Embedder = Annotated[Caller, Depends(may("embed"))]
Verifier = Annotated[Caller, Depends(may("verify"))]
Uploader = Annotated[Caller, Depends(may("embed", "verify"))]
Follower = Annotated[Caller, Depends(may("read", "embed", "verify", OPERATOR))]
"""Sees results of jobs: without `read`, of those that this very key requested (`visible`)."""
OriginalsReader = Annotated[Caller, Depends(may("originals"))]
Admin = Annotated[Caller, Depends(may("admin"))]
Operator = Annotated[Caller, Depends(may(OPERATOR))]
Disputer = Annotated[Caller, Depends(may("verify", OPERATOR))]
Party = Annotated[Caller, Depends(may("read", OPERATOR))]


def visible(core: Service, caller: Caller, table: sa.Table, row_id: str) -> Any:
    """The row of a job, of its result or of an acquisition, if a caller without `read` requested it; else not-found."""
    row = own(core.db, table, caller.tenant, row_id)
    if not caller.may("read"):
        asked = row if "api_key" in table.c else core.jobs.get(caller.tenant, row.job)
        if asked is None or asked.api_key != caller.key_id:
            raise missing(table, row_id)
    return row


Limit = Annotated[int, Query(ge=1, le=100, description="Entries per page.")]
NO_ZERO = r"^[^\x00]*$"
"""`check_address`, as the API's description says it of a parameter."""
Words = Annotated[str, Query(max_length=200, pattern=NO_ZERO)]
"""What is looked for in a list."""
After = Annotated[str, Query(max_length=64, description="`next` of the page before.")]

T = TypeVar("T")


class Listed(BaseModel, Generic[T]):
    """A page of a list."""

    items: list[T]
    next: str | None

    @classmethod
    def of(cls, core: Service, table: sa.Table, tenant: str, limit: int, after: str, **narrowed: Any) -> Self:
        """The page of a table's rows that follows the cursor `after`; `narrowed`: see `service.db.page`."""
        with core.db.read() as connection:
            rows, following = page(connection, table, tenant, limit, after, **narrowed)
        return cls.model_validate({"items": rows, "next": following})
