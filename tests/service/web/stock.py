"""Something in the service to look at, put there by its API."""

from __future__ import annotations

import io
import json
import time
import urllib.request
from typing import TYPE_CHECKING, Any

from PIL import Image

from tests.scenes import sparse_plant
from tests.service.web.journey import PLANT

if TYPE_CHECKING:
    from tests.service.serving import Served


def ask(served: Served, path: str, method: str = "GET", body: Any = None, **headers: str) -> Any:
    """JSON of the API."""
    data = body if isinstance(body, bytes) or body is None else json.dumps(body).encode()
    kind = {"Content-Type": "application/json"} if not isinstance(body, bytes) else {}
    request = urllib.request.Request(
        served.address + path,
        data,
        method=method,
        headers={"Authorization": f"Bearer {served.api_key}", **kind, **headers},
    )
    with urllib.request.urlopen(request, timeout=120) as response:
        return json.loads(response.read() or b"null")


def done(served: Served, path: str, body: dict[str, Any]) -> dict[str, Any]:
    """Result of a job."""
    job = ask(served, path, "POST", body)
    while job["state"] in ("queued", "running"):
        time.sleep(0.2)
        job = ask(served, f"/v1/jobs/{job['id']}")
    assert job["state"] == "succeeded", job
    return dict(job["result"])


def upload(served: Served, name: str, data: bytes) -> str:
    """Bring a file; id of the upload."""
    slot = ask(served, "/v1/uploads", "POST", {"name": name, "size": len(data)})["id"]
    ask(served, f"/v1/uploads/{slot}", "PUT", data)
    return str(slot)


def png(number: int) -> bytes:
    """A small picture, each number's another."""
    file = io.BytesIO()
    Image.new("RGB", (64, 48), (number, 100, 100)).save(file, "PNG")
    return file.getvalue()


def stock(served: Served) -> tuple[str, str]:
    """An asset of its own and a claim about it, whatever other tests put there: their ids."""
    ours = f"/v1/assets?q={PLANT.name}"
    if not ask(served, ours)["items"]:
        brought = upload(served, PLANT.name, sparse_plant())
        key = ask(served, "/v1/keys", "POST", {"label": "Views"})["id"]
        asset = done(served, "/v1/embed", {"upload_id": brought, "key_id": key, "profile": "fast", "label": PLANT.name})
        done(served, "/v1/verify", {"upload_id": brought, "asset_id": asset["asset_id"]})
    (found,) = ask(served, ours)["items"]
    return found["id"], ask(served, f"/v1/claims?asset={found['id']}")["items"][-1]["id"]
