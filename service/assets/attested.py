"""A record with this service's signed statement of its registration, so that the date counts elsewhere, too."""

from typing import Any

from engine.records.attestation import LOG, Attestation, attach, header_digest
from engine.records.signatures import REGISTRATION
from service.assets.conversions import keep, kept
from service.core import Service
from service.trust import audit
from service.trust.canonical import canonical
from service.trust.commitments import registration_of
from service.trust.signing import sign

_FORMAT = "attested record"


def attested_record(service: Service, row: Any) -> str:
    """Digest of an asset's record with the log's proof attached; made once."""
    if (found := kept(service, row.record_sha256, _FORMAT)) is not None:
        return found
    data = service.blobs.read(row.record_sha256)
    with service.db.read() as connection:
        entry = registration_of(connection, row.id)
        size = entry.index + 1  # the log as it stood then: what it proves does not depend on the time of the request
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
    keep(service, row.record_sha256, _FORMAT, digest)
    return digest
