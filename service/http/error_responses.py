"""Every error leaves as problem+json with the request's id."""

import errno
import json
import logging
from collections.abc import Mapping
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.routing import Match, Route

from service.problems import KINDS, MEDIA_TYPE, Problem

log = logging.getLogger("mark3dgs.http")

_BY_STATUS = {status: kind for kind, (status, _) in reversed(KINDS.items())}
"""The first kind of each status: what the framework's own errors mean."""


def answer(problem: Problem, request: Request) -> Response:
    """The response of a problem."""
    body = problem.to_json(request.scope.get("request_id", ""))
    headers = dict(problem.headers)
    if problem.status == 401:
        headers["WWW-Authenticate"] = 'Bearer realm="mark3dgs"'
    return Response(json.dumps(body), problem.status, headers, MEDIA_TYPE)


def install(app: FastAPI) -> None:
    """Hand every kind of error to `answer`."""

    @app.exception_handler(Problem)
    def on_problem(request: Request, error: Problem) -> Response:
        return answer(error, request)

    @app.exception_handler(HTTPException)
    def on_http(request: Request, error: HTTPException) -> Response:
        kind = _BY_STATUS.get(error.status_code, "internal" if error.status_code >= 500 else "malformed-request")
        headers = dict(error.headers or {})
        if error.status_code == 405:
            headers["Allow"] = ", ".join(sorted(_methods(app, request)))
        return answer(Problem(kind, str(error.detail), headers=headers), request)

    @app.exception_handler(RequestValidationError)
    def on_invalid(request: Request, error: RequestValidationError) -> Response:
        return answer(invalid(list(error.errors())), request)

    @app.exception_handler(ClientDisconnect)
    def on_leaving(request: Request, error: ClientDisconnect) -> Response:
        return answer(Problem("malformed-request", "the body is incomplete"), request)  # to a client that is gone

    @app.exception_handler(OSError)
    @app.exception_handler(Exception)
    def on_bug(request: Request, error: Exception) -> Response:
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return answer(Problem("storage-full", "the disk is full; nothing was kept of this request"), request)
        log.exception("request %s failed", request.scope.get("request_id"), exc_info=error)
        return answer(Problem("internal", "internal server error; quote request_id when reporting it"), request)


def _methods(app: FastAPI, request: Request) -> set[str]:
    """Methods of all routes at the request's address: the framework names those of the first only, or none."""
    routers = [getattr(route, "original_router", None) for route in app.routes]
    routes = (*app.routes, *(route for router in routers if router is not None for route in router.routes))
    here = [each for each in routes if isinstance(each, Route) and each.matches(request.scope)[0] is not Match.NONE]
    # The first is the address that is meant: `{claim_id}` fits `{claim_id}.jws`, too.
    found = {method for each in here if each.path == here[0].path for method in each.methods or ()}
    return found | {"HEAD"} if "GET" in found else found


_TEXTS = {"model_attributes_type": "send a JSON object, with the header Content-Type: application/json"}
"""In place of the framework's own, by type of error."""


def invalid(errors: list[Any]) -> Problem:
    """A problem of what a validation found; each entry names the place and what is wrong there."""
    broken = any(entry["type"] in ("json_invalid", "model_attributes_type") for entry in errors)
    places = [
        {
            "place": ".".join(str(part) for part in entry["loc"]),
            "text": _TEXTS.get(entry["type"], f"{entry['msg']}{_not(entry)}"),
        }
        for entry in errors[:20]
    ]
    detail = "; ".join(f"{entry['place']}: {entry['text']}" for entry in places[:3])
    return Problem("malformed-request" if broken else "invalid-request", detail, errors=places)


def _not(entry: Mapping[str, Any]) -> str:
    """The offending number or text, short, where the message does not name it; never a key."""
    value, kind = entry.get("input"), str(entry["type"])
    named = kind in ("missing", "extra_forbidden", "value_error") or "key" in entry["loc"]
    return "" if named or not isinstance(value, int | float | str) else f", not {str(value)[:40]!r}"


Responses = dict[int | str, dict[str, Any]]
"""OpenAPI of the answers of a route, by status, as FastAPI takes it."""


def responses(*kinds: str) -> Responses:
    """OpenAPI of the problems that a route may answer with; those that any route can are added."""
    found: dict[int, list[str]] = {}
    slow = ("too-slow",) if "malformed-request" in kinds else ()  # it has a body
    for kind in dict.fromkeys((*kinds, *slow, "invalid-request", "internal", "unavailable", "storage-full")):
        found.setdefault(KINDS[kind][0], []).append(KINDS[kind][1])
    schema = {"$ref": "#/components/schemas/Problem"}
    return {
        status: {"description": "; ".join(titles), "content": {MEDIA_TYPE: {"schema": schema}}}
        for status, titles in sorted(found.items())
    }


OF_LIST = responses("unauthorized", "forbidden", "invalid-request")
OF_OWN = responses("unauthorized", "forbidden", "not-found")
"""Of a list, and of one thing of the caller's."""
