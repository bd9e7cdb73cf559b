"""A record with this service's signed word on its registration in it, so that the date counts elsewhere, too."""

from typing import Any

import sqlalchemy as sa

from engine.records.attestation import LOG, Attestation, attach, header_digest
from engine.records.signatures import REGISTRATION
from service.core import Service
from service.db.schema import conversions
from service.trust import audit
from service.trust.canonical import canonical
from service.trust.commitments import registration_of
from service.trust.signing import sign

_FORMAT = "attested record"


def attested_record(service: Service, row: Any) -> str:
    """Digest of an asset's record with the log's proof attached; made once."""
    known = (conversions.c.model_sha256 == row.record_sha256) & (conversions.c.format == _FORMAT)
    query = sa.select(conversions.c.sha256).where(known)
    with service.db.read() as connection:
        found = connection.execute(query).scalar()
    if found is not None:
        return str(found)
    data = service.blobs.read(row.record_sha256)
    with service.db.read() as connection:
        entry = registration_of(connection, row.id)
        size = entry.index + 1  # the log as it stood then: what it proves does not depend on when it is asked for
        said = {
            "header_sha256": header_digest(data),
            "entry": entry.to_json(),
            "size": size,
            "root": audit.root(connection, size),
            "proof": audit.inclusion_proof(connection, entry.index, size),
        }
        statement = sign(connection, service.master, canonical(said), REGISTRATION)
    with service.blobs.new_file() as file:
        file.write_bytes(attach(data, Attestation(LOG, statement)))
        digest = service.blobs.put(file)
    with service.db.write() as connection:
        if connection.execute(query).scalar() is None:
            connection.execute(
                conversions.insert().values(model_sha256=row.record_sha256, format=_FORMAT, sha256=digest)
            )
    return digest
