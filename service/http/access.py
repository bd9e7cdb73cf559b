"""What handlers are handed: the service, who is asking (and whether they may), and the page of a list."""

from collections.abc import Callable
from typing import Annotated

from fastapi import Depends, Query, Request
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from service.core import Service
from service.problems import Problem
from service.trust.api_keys import Caller, check

_bearer = HTTPBearer(auto_error=False, scheme_name="apiKey", description="API key: mk_<id>_<secret>")


def service_of(request: Request) -> Service:
    """The service that this app serves."""
    service: Service = request.app.state.service
    return service


Core = Annotated[Service, Depends(service_of)]


def _caller(core: Core, credentials: Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)]) -> Caller:
    if credentials is None:
        raise Problem("unauthorized", "send the header 'Authorization: Bearer mk_...'")
    return check(core.db, core.master, credentials.credentials)


def may(scope: str) -> Callable[..., Caller]:
    """Dependency: a caller whose key has this scope (admin has all)."""

    def allowed(caller: Annotated[Caller, Depends(_caller)]) -> Caller:
        if scope not in caller.scopes and "admin" not in caller.scopes:
            raise Problem("forbidden", f"this API key lacks the scope {scope!r}")
        return caller

    return allowed


Reader = Annotated[Caller, Depends(may("read"))]
Embedder = Annotated[Caller, Depends(may("embed"))]
Verifier = Annotated[Caller, Depends(may("verify"))]
Admin = Annotated[Caller, Depends(may("admin"))]


Limit = Annotated[int, Query(ge=1, le=100, description="Entries a page.")]
After = Annotated[str, Query(max_length=64, description="`next` of the page before.")]


def _uploader(caller: Annotated[Caller, Depends(_caller)]) -> Caller:
    if not {"embed", "verify", "admin"} & set(caller.scopes):
        raise Problem("forbidden", "this API key may neither embed nor verify, so it may not upload")
    return caller


Uploader = Annotated[Caller, Depends(_uploader)]
