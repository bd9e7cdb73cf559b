"""/v1/webhooks: addresses that receive a message when a tenant's jobs end, or a mark of it is found."""

from typing import Annotated, Any, Literal

import sqlalchemy as sa
from fastapi import APIRouter, Response
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, HttpUrl, JsonValue

from service.claims.schema import Url
from service.core import Service
from service.db.schema import deliveries, webhooks
from service.http.access import Admin, Core
from service.http.error_responses import OF_OWN, responses
from service.http.forms import RequestBody
from service.http.results import Time
from service.open_network import is_public
from service.problems import Problem
from service.trust import webhook_secrets as registry

router = APIRouter(prefix="/v1/webhooks", tags=["webhooks"])
Events = Annotated[list[Literal["job.ended", "mark.found"]], Field(min_length=1, max_length=2)]
_EXAMPLE: JsonValue = {"url": "https://studio.example/mark3dgs", "events": ["job.ended", "mark.found"]}


class NewWebhook(RequestBody):
    """An address that receives messages."""

    model_config = ConfigDict(json_schema_extra={"examples": [_EXAMPLE]})
    url: Url = Field(description="https, on the open network.")
    events: Events = Field(["job.ended", "mark.found"])


class WebhookView(BaseModel):
    """A webhook, and the outcome of its last message; never its secret."""

    model_config = ConfigDict(from_attributes=True)
    id: str
    url: str
    events: Annotated[Events, BeforeValidator(lambda text: text.split() if isinstance(text, str) else text)]
    created_at: Time
    waiting: int = Field(0, description="Messages that are still to be delivered.")
    last_at: Time | None = Field(description="Time of the last delivery attempt.")
    last_status: int | None = Field(description="HTTP status; null where no answer came.")
    last_outcome: str | None = Field(description="Outcome of that attempt, in words.")


class MadeWebhook(WebhookView):
    """A webhook just made."""

    secret: str = Field(description="What its messages are signed with. It is never shown again.")


class WebhookList(BaseModel):
    """All webhooks of the tenant, oldest first."""

    items: list[WebhookView]


@router.post(
    "",
    status_code=201,
    operation_id="createWebhook",
    responses=responses("malformed-request", "unauthorized", "forbidden", "invalid-request", "budget-exceeded"),
)
def create_webhook(body: NewWebhook, core: Core, caller: Admin, response: Response) -> MadeWebhook:
    """Send a signed message (POST) to an address at the end of every job of this tenant, and when a mark of yours is
    found in another account's upload.

    The body is `{"event": "job.ended", "at": time, "job": the job}`, or `{"event": "mark.found", "at": time,
    "notice": the notice}`; the header `Mark3DGS-Signature: t=SECONDS,v1=HEX`
    with the HMAC-SHA256 of `SECONDS.BODY`. A 2xx answer confirms receipt; otherwise delivery is repeated, at most eight
    attempts in 21 hours. The same message may come twice.
    """
    host = _host(core, body.url)
    most, events = core.settings.webhooks, " ".join(dict.fromkeys(body.events))
    secret, row = registry.add(core.db, core.master, caller.tenant, str(body.url), host, most, events)
    response.headers["Cache-Control"] = "no-store"
    return MadeWebhook.model_validate(row._asdict() | {"secret": secret})


@router.get("", operation_id="listWebhooks", responses=responses("unauthorized", "forbidden"))
def list_webhooks(core: Core, caller: Admin) -> WebhookList:
    """Webhooks of this tenant, with the outcome of the last message to each."""
    waiting = sa.select(sa.func.count()).where(deliveries.c.webhook == webhooks.c.id).scalar_subquery()
    query = sa.select(webhooks, waiting.label("waiting")).where(webhooks.c.tenant == caller.tenant)
    rows: list[Any] = list(core.db.query(query.order_by(webhooks.c.created_at, webhooks.c.id)))
    return WebhookList(items=[WebhookView.model_validate(row._asdict()) for row in rows])


@router.delete("/{webhook_id}", status_code=204, operation_id="deleteWebhook", responses=OF_OWN)
def delete_webhook(webhook_id: str, core: Core, caller: Admin) -> None:
    """Delete a webhook; messages that are still to be sent to it are dropped."""
    registry.delete(core.db, caller.tenant, webhook_id)


def _host(service: Service, url: HttpUrl) -> str:
    """Name or address in a URL that messages may go to, as far as can be said before they go."""
    host = str(url.host)
    if service.settings.webhooks_private:
        return host
    if url.scheme != "https":
        raise Problem("invalid-request", f"body.url: messages go by https, not by {url.scheme}")
    try:
        public = is_public(host.strip("[]"))
    except ValueError:  # a name: it is looked up when a message goes
        public = host.rstrip(".").lower() != "localhost"
    if not public:
        raise Problem("invalid-request", f"body.url: {host} is no address of the open network")
    return host
