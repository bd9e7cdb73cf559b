"""/v1/notices: uploads of other accounts in which a mark of this tenant was found."""

from typing import Annotated

import sqlalchemy as sa
from fastapi import APIRouter, Query

from service.db import page
from service.db.schema import notices
from service.http.access import NO_ZERO, After, Core, Limit, Listed, Reader
from service.http.error_responses import OF_LIST
from service.http.results import Notice, notice_of

router = APIRouter(prefix="/v1/notices", tags=["notices"])


class NoticeList(Listed[Notice]):
    """A page of notices, newest first."""


@router.get("", operation_id="listNotices", responses=OF_LIST)
def list_notices(
    core: Core,
    caller: Reader,
    limit: Limit = 20,
    after: After = "",
    asset: Annotated[str, Query(max_length=64, pattern=NO_ZERO, description="About the asset of this id.")] = "",
) -> NoticeList:
    """Uploads of other accounts that carry a mark of yours, newest first. The uploader is neither notified nor named;
    the operator of the service can start a dispute between the two assets."""
    where = notices.c.asset == asset if asset else sa.true()
    with core.db.read() as connection:
        rows, following = page(connection, notices, caller.tenant, limit, after, where=where)
    return NoticeList(items=[notice_of(row) for row in rows], next=following)
