"""/v1/api-keys: API keys of the tenant, made with chosen scopes, and revoked."""

from typing import Annotated, Literal

from fastapi import APIRouter, Response
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, JsonValue

from service.db import own, schema
from service.http.access import Admin, After, Core, Limit, Listed
from service.http.error_responses import OF_LIST, responses
from service.http.forms import RequestBody
from service.http.results import Time, TimeOrNot
from service.problems import Problem
from service.trust import api_keys
from service.trust.api_keys import OPERATOR

router = APIRouter(prefix="/v1/api-keys", tags=["keys"])
Scope = Literal["embed", "verify", "read", "originals", "admin", "operator"]
_EXAMPLE: JsonValue = {"label": "Build server", "scopes": ["embed", "read"]}


class NewApiKey(RequestBody):
    """An API key to make."""

    model_config = ConfigDict(json_schema_extra={"examples": [_EXAMPLE]})
    label: str = Field("", max_length=200, description="For display.")
    scopes: list[Scope] = Field(min_length=1, max_length=6, description="What the key may do.")


class ApiKeyView(BaseModel):
    """An API key; never its secret."""

    model_config = ConfigDict(from_attributes=True)
    id: str
    label: str
    scopes: Annotated[list[Scope], BeforeValidator(str.split)]
    created_at: Time
    revoked_at: TimeOrNot


class MadeApiKey(ApiKeyView):
    """An API key just made."""

    token: str = Field(description="The key itself. It is never shown again.")


class ApiKeyList(Listed[ApiKeyView]):
    """A page of API keys, newest first."""


@router.post(
    "",
    status_code=201,
    operation_id="createApiKey",
    responses=responses("malformed-request", "unauthorized", "forbidden", "invalid-request", "too-large"),
)
def create_api_key(body: NewApiKey, core: Core, caller: Admin, response: Response) -> MadeApiKey:
    """Make an API key of this tenant. Only a key of scope `operator` makes another of that scope."""
    if OPERATOR in body.scopes and not caller.may(OPERATOR):
        raise Problem("forbidden", "this API key lacks the scope 'operator', and so cannot give it")
    token = api_keys.issue(core.db, core.master, caller.tenant, body.scopes, body.label)
    made = own(core.db, schema.api_keys, caller.tenant, token.split("_")[1])
    response.headers["Cache-Control"] = "no-store"
    return MadeApiKey.model_validate(made._asdict() | {"token": token})


@router.get("", operation_id="listApiKeys", responses=OF_LIST)
def list_api_keys(core: Core, caller: Admin, limit: Limit = 20, after: After = "") -> ApiKeyList:
    """API keys of this tenant, newest first; revoked ones, too."""
    return ApiKeyList.of(core, schema.api_keys, caller.tenant, limit, after)


@router.delete(
    "/{api_key_id}",
    status_code=204,
    operation_id="revokeApiKey",
    responses=responses("unauthorized", "forbidden", "not-found", "conflict"),
)
def revoke_api_key(api_key_id: str, core: Core, caller: Admin) -> None:
    """Revoke an API key of this tenant for good. What it made stays. A key cannot revoke itself."""
    if api_key_id == caller.key_id:
        raise Problem("conflict", "a key cannot revoke itself: use another one")
    api_keys.revoke(core.db, caller.tenant, api_key_id)
