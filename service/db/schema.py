"""The tables. Times are UTC in ISO 8601 (sortable text), ids are random text, JSON is text in canonical form."""

import sqlalchemy as sa
from sqlalchemy import BigInteger, Boolean, Column, Float, Integer, LargeBinary, Table, Text

metadata = sa.MetaData()


def key(*names: str) -> list[sa.Column[str]]:
    """Columns of a primary key."""
    return [Column(name, Text, primary_key=True) for name in names]


def texts(*names: str, null: bool = False, index: bool = False) -> list[sa.Column[str]]:
    """Columns of text."""
    return [Column(name, Text, nullable=null, index=index) for name in names]


def number(name: str, default: int | None = 0) -> sa.Column[int]:
    """A column of whole numbers; without a `default` it may be NULL."""
    return Column(name, BigInteger, nullable=default is None, default=default)


# What holds for this database as a whole.
facts = Table("facts", metadata, *key("name"), *texts("value"))

api_keys = Table(
    "api_keys",
    metadata,
    *key("id"),  # public part of the key
    *texts("tenant", index=True),
    *texts("digest", "scopes", "label", "created_at"),  # keyed HMAC-SHA256 of the secret part, hex; space-separated
    *texts("revoked_at", null=True),
)

tenants = Table("tenants", metadata, *key("id"), *texts("name"))  # what people call them; others have their id

owner_keys = Table(
    "owner_keys",
    metadata,
    *key("id"),
    *texts("tenant", index=True),
    *texts("fingerprint", "label"),
    number("version", 1),  # of the master key that sealed it
    Column("sealed", LargeBinary, nullable=True),  # NULL once deleted
    *texts("created_at"),
    *texts("deleted_at", null=True),
)

uploads = Table(
    "uploads",
    metadata,
    *key("id"),
    *texts("tenant", "created_at", index=True),
    *texts("name", "parts", "state"),  # parts: JSON list of [name, length, sha256]; state: open, complete
    number("size", None),  # announced, NULL if not
    number("received"),
    *texts("sha256", "info", null=True),  # announced, then measured; JSON: what the file is, once it was inspected
    Column("api_key", Text, nullable=False, server_default=""),  # whose it is; "": made before that was kept
)

jobs = Table(
    "jobs",
    metadata,
    *key("id"),
    *texts("tenant", "state", "created_at", index=True),  # state: of `service.jobs.port.State`
    *texts("api_key", "kind", "request", "stage"),  # kind: embed, verify, dispute, watch; request: JSON
    Column("fraction", Float, nullable=False, default=0.0),
    *texts("result", "problem", null=True),  # JSON; the problem as in RFC 9457
    number("revision"),
    Column("cancelling", Boolean, nullable=False, default=False),
    *texts("worker", "started_at", "finished_at", null=True),
    number("attempts"),  # begun so often; who holds an older number has lost the job
    number("tries"),  # of these, since its last step was done
)

idempotency = Table(
    "idempotency",
    metadata,
    *key("tenant", "key"),  # key: id of the API key, and what its client drew
    *texts("body_hash"),
    *texts("job", null=True),  # or acquisition; NULL while the first request is in flight
    *texts("created_at", index=True),
)

assets = Table(
    "assets",
    metadata,
    *key("id"),
    *texts("tenant", index=True),
    Column("job", Text, nullable=False, unique=True),
    *texts("owner_key", "label", "copy", "record_id", "message", "profile", "report"),  # message: hex; report: JSON
    number("gaussians"),
    *texts("original_sha256", "model_sha256", index=True),
    *texts("original_format", "model_format", "record_sha256", "preview_sha256", "sketch_sha256", "registered_at"),
)

conversions = Table("conversions", metadata, *key("model_sha256", "format"), *texts("sha256"))

# Signed manifests (C2PA) of delivered files: what was signed once stays to be found.
manifests = Table(
    "manifests",
    metadata,
    *key("id"),  # urn:c2pa:...
    *texts("asset", "binding", index=True),  # binding: id of the mark's record
    *texts("signer", "source_sha256"),  # of the certificate chain, and of the file that was to be signed
    *texts("file_sha256", "sha256", "created_at"),  # of the file as it is delivered, and of the manifest store
    Column("rights", Text, nullable=False, server_default=""),  # as the file states them
)

# What an owner publishes of an asset's credentials; without a row, nothing. Not in `assets`, whose rows never change.
published = Table(
    "published",
    metadata,
    *key("asset"),
    Column("by_content", Boolean, nullable=False),  # whether its manifests are found by what looks alike
    *texts("rights"),
)

claims = Table(
    "claims",
    metadata,
    *key("id"),
    *texts("tenant", index=True),
    Column("job", Text, nullable=False, unique=True),
    *texts("asset", null=True),
    *texts("document", "jws", "pictures", "created_at"),  # document: canonical JSON; pictures: JSON, name -> sha256
    Column("timestamp", LargeBinary, nullable=True),  # RFC 3161 token of the JWS
    Column("verdict", Text, nullable=False, server_default=""),  # as the document has it: for lists
    Column("names", Text, nullable=False, server_default=""),  # of the suspect's files, one per line; not signed
)

# Uploads of others in which the mark of an asset was found, for its owner. Not in the audit log: its size is no secret.
notices = Table(
    "notices",
    metadata,
    *key("id"),
    *texts("tenant", index=True),
    *texts("asset", "upload", "finding", "created_at"),  # upload: what it became; finding: JSON, of `marks`
)

# Time stamps from which a part of a record's plan follows: the same for all copies of an asset, so kept for good.
draws = Table(
    "draws",
    metadata,
    *key("request"),  # SHA-256 of what was stamped, hex
    Column("token", LargeBinary, nullable=False),
    *texts("created_at"),
)

# Suspects as they were found; what a claim names of one is in the log.
acquisitions = Table(
    "acquisitions",
    metadata,
    *key("id"),
    *texts("tenant", index=True),
    *texts("api_key", "at", "payload_sha256", "warc_sha256", "created_at"),
    *texts("url", "upload", null=True),  # url: NULL of an uploaded file; upload: NULL of no suspect
    number("bytes"),
    number("warc_bytes"),
    Column("timestamp", LargeBinary, nullable=True),  # RFC 3161 token of `trust.commitments.acquisition_facts`
)

# Addresses under which a claim is seen without an API key; the address itself is nowhere kept.
shares = Table(
    "shares",
    metadata,
    *key("id"),
    *texts("tenant"),
    *texts("claim", index=True),
    Column("digest", Text, nullable=False, unique=True),  # SHA-256 of the token in the address, hex
    *texts("created_at", "expires_at"),
)

# Payloads are canonical JSON: digests, never secrets. The hash is of the previous hash and this row, hex.
audit = Table(
    "audit",
    metadata,
    Column("index", BigInteger().with_variant(Integer, "sqlite"), primary_key=True, autoincrement=False),
    *texts("at", "tenant"),
    *texts("event", "subject", index=True),  # what happened, and the id of what it happened to
    *texts("payload", "hash"),
)

# Perfect subtrees of the Merkle tree (RFC 6962).
audit_nodes = Table(
    "audit_nodes",
    metadata,
    Column("level", Integer, primary_key=True, autoincrement=False),
    Column("position", BigInteger, primary_key=True, autoincrement=False),
    *texts("hash"),
)

signing_keys = Table(
    "signing_keys",
    metadata,
    *key("kid"),
    *texts("public", "created_at"),  # public: JWK
    Column("sealed", LargeBinary, nullable=False),
    *texts("retired_at", null=True),
)

workers = Table(
    "workers",
    metadata,
    *key("id"),
    *texts("host", "started_at"),
    number("pid"),
    Column("seen_at", Float, nullable=False),  # seconds since the epoch, by the worker's clock
)

ENDED, FOUND = "job.ended", "mark.found"
"""Events: a job of the tenant ended; a notice was given to it."""

webhooks = Table(
    "webhooks",
    metadata,
    *key("id"),
    *texts("tenant", index=True),
    *texts("url", "created_at"),
    number("version", 1),  # of the master key that sealed the secret
    Column("sealed", LargeBinary, nullable=False),
    *texts("last_at", "last_outcome", null=True),  # of the last try
    number("last_status", None),  # HTTP, NULL where no answer came
    Column("events", Text, nullable=False, server_default=ENDED),  # space-separated
)

# Pending messages of webhooks: written by the transaction that ends a job, or that gives notice (`job` is its id then);
# gone once delivered or given up.
deliveries = Table("deliveries", metadata, *key("webhook", "job"), *texts("due_at", index=True), number("tries"))

# How much of a budget a subject has used in the part of its span that begins at `window`.
usage = Table("usage", metadata, *key("subject", "window"), number("count"))
