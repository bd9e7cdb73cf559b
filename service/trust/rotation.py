"""Another master key: every secret is sealed anew, in one transaction, and nothing that was handed out changes.

1. The new key is written next to the old one.    2. All secrets are sealed under it, and it is logged.
3. It takes the old one's place. After a crash between 2 and 3 the next start does 3.
"""

import secrets
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from service.db import Database
from service.db.schema import facts, owner_keys, signing_keys, webhooks, workers
from service.problems import Problem
from service.settings import Settings
from service.trust import api_keys, audit
from service.trust.master import CHECK, FILE, KEY_BYTES, RETIRED, MasterKey, bind, from_hex, new_file, write_key
from service.trust.owner_keys import seal_of
from service.trust.signing import TENANT, private_seal
from service.trust.webhook_secrets import secret_seal


def rotate_master(settings: Settings, db: Database, old: MasterKey, new_key_file: Path | None = None) -> int:
    """Number of secrets sealed anew. "conflict" while workers live, "invalid-request" where the key comes by setting
    and the new one by nothing."""
    path = settings.data_dir / FILE
    if settings.master_key is not None and new_key_file is None:
        raise Problem("invalid-request", "the master key comes from MARK3DGS_MASTER_KEY: give the new one in a file")
    text = new_key_file.read_text() if new_key_file is not None else secrets.token_hex(KEY_BYTES)
    new = MasterKey(from_hex(text, str(new_key_file)))
    with db.exclusive() as connection:
        lately = workers.c.seen_at >= time.time() - settings.worker_silence_seconds
        if connection.execute(sa.select(workers.c.id).where(lately)).first() is not None:
            raise Problem("conflict", "a worker is at work: stop the service first")
        if settings.master_key is None:
            write_key(new_file(path), text.strip())  # 1
        # 2
        count = _reseal(connection, owner_keys, seal_of, old, new)
        count += _reseal(connection, signing_keys, private_seal, old, new)
        count += _reseal(connection, webhooks, secret_seal, old, new)
        retired = new.seal(old.retiring(api_keys.PURPOSE), bind(RETIRED)).hex()
        connection.execute(sa.delete(facts).where(facts.c.name.in_([CHECK, RETIRED])))
        rows = [{"name": CHECK, "value": new.check_value}, {"name": RETIRED, "value": retired}]
        connection.execute(facts.insert(), rows)
        audit.append(connection, TENANT, "master_key.rotated", {"secrets": count})
    if settings.master_key is None:
        new_file(path).replace(path)  # 3
    return count


def _reseal(
    connection: sa.Connection, table: sa.Table, bound: Callable[[Any], bytes], old: MasterKey, new: MasterKey
) -> int:
    """Seal a table's secrets anew; `bound` says what each row's seal is bound to."""
    (key,) = table.primary_key
    rows = connection.execute(table.select().where(table.c.sealed.is_not(None))).all()
    for row in rows:
        sealed = new.seal(old.unseal(row.sealed, bound(row)), bound(row))
        connection.execute(table.update().where(key == row._mapping[key]).values(sealed=sealed))
    return len(rows)
