"""The tables. Times are UTC in ISO 8601 (sortable text), ids are random text, JSON is text in canonical form."""

import sqlalchemy as sa

metadata = sa.MetaData()

Column, Table, Text, Integer, Float = sa.Column, sa.Table, sa.Text, sa.Integer, sa.Float


def _key(name: str = "id") -> sa.Column[str]:
    return Column(name, Text, primary_key=True)


def _text(name: str, *, null: bool = False, index: bool = False) -> sa.Column[str]:
    return Column(name, Text, nullable=null, index=index)


def _number(name: str, *, default: int | None = None) -> sa.Column[int]:
    return Column(name, sa.BigInteger, nullable=default is None, default=default)


facts = Table(
    "facts",
    metadata,  # what holds for this database as a whole
    _key("name"),
    _text("value"),
)

api_keys = Table(
    "api_keys",
    metadata,
    _key(),  # public part of the key
    _text("tenant", index=True),
    _text("digest"),  # keyed HMAC-SHA256 of the secret part, hex
    _text("scopes"),  # space-separated
    _text("label"),
    _text("created_at"),
    _text("revoked_at", null=True),
)

owner_keys = Table(
    "owner_keys",
    metadata,
    _key(),
    _text("tenant", index=True),
    _text("fingerprint"),
    _text("label"),
    _number("version", default=1),  # of the master key that sealed it
    Column("sealed", sa.LargeBinary, nullable=True),  # NULL once deleted
    _text("created_at"),
    _text("deleted_at", null=True),
)

uploads = Table(
    "uploads",
    metadata,
    _key(),
    _text("tenant", index=True),
    _text("name"),
    _number("size"),  # announced, NULL if not
    _text("sha256", null=True),  # announced, then measured
    _number("received", default=0),
    _text("parts"),  # JSON list of [offset, length]
    _text("state"),  # open, complete
    _text("info", null=True),  # JSON: what the file is, once it was inspected
    _text("created_at", index=True),
)

jobs = Table(
    "jobs",
    metadata,
    _key(),
    _text("tenant", index=True),
    _text("api_key"),
    _text("kind"),  # embed, verify
    _text("state", index=True),  # queued, running, succeeded, disputed, failed, cancelled
    _text("request"),  # JSON
    _text("stage"),
    Column("fraction", Float, nullable=False, default=0.0),
    _text("result", null=True),  # JSON
    _text("problem", null=True),  # JSON, RFC 9457
    _number("revision", default=0),
    Column("cancelling", sa.Boolean, nullable=False, default=False),
    _text("worker", null=True),
    _number("attempts", default=0),  # begun so often; who holds an older number has lost the job
    _number("tries", default=0),  # of these, since its last step was done
    _text("created_at", index=True),
    _text("started_at", null=True),
    _text("finished_at", null=True),
)

idempotency = Table(
    "idempotency",
    metadata,
    Column("tenant", Text, primary_key=True),
    Column("key", Text, primary_key=True),
    _text("body_hash"),
    _text("job", null=True),  # NULL while the first request is in flight
    _text("created_at", index=True),
)

assets = Table(
    "assets",
    metadata,
    _key(),
    _text("tenant", index=True),
    Column("job", Text, nullable=False, unique=True),
    _text("owner_key"),
    _text("label"),
    _text("copy"),
    _text("record_id"),
    _text("message"),  # hex
    _text("profile"),
    _text("report"),  # JSON
    _number("gaussians", default=0),
    _text("original_sha256", index=True),
    _text("original_format"),
    _text("model_sha256", index=True),
    _text("model_format"),
    _text("record_sha256"),
    _text("preview_sha256"),
    _text("sketch_sha256"),
    _text("registered_at"),
)

conversions = Table(
    "conversions",
    metadata,
    Column("model_sha256", Text, primary_key=True),
    Column("format", Text, primary_key=True),
    _text("sha256"),
)

claims = Table(
    "claims",
    metadata,
    _key(),
    _text("tenant", index=True),
    Column("job", Text, nullable=False, unique=True),
    _text("asset", null=True),
    _text("document"),  # canonical JSON, what is signed
    _text("jws"),
    _text("pictures"),  # JSON: name -> sha256
    Column("timestamp", sa.LargeBinary, nullable=True),  # RFC 3161 token of the JWS
    _text("created_at"),
)

audit = Table(
    "audit",
    metadata,
    Column("index", sa.BigInteger().with_variant(Integer, "sqlite"), primary_key=True, autoincrement=False),
    _text("at"),
    _text("tenant"),
    _text("event", index=True),
    _text("subject", index=True),  # id of what it is about
    _text("payload"),  # canonical JSON; digests, never secrets
    _text("hash"),  # of the previous hash and this row, hex
)

audit_nodes = Table(
    "audit_nodes",
    metadata,  # perfect subtrees of the Merkle tree (RFC 6962)
    Column("level", Integer, primary_key=True, autoincrement=False),
    Column("position", sa.BigInteger, primary_key=True, autoincrement=False),
    _text("hash"),
)

signing_keys = Table(
    "signing_keys",
    metadata,
    _key("kid"),
    _text("public"),  # JWK
    Column("sealed", sa.LargeBinary, nullable=False),
    _text("created_at"),
    _text("retired_at", null=True),
)

workers = Table(
    "workers",
    metadata,
    _key(),
    _text("host"),
    _number("pid", default=0),
    _text("started_at"),
    Column("seen_at", Float, nullable=False),  # seconds since the epoch, of the database's machine where it has a clock
)

usage = Table(
    "usage",
    metadata,  # how much of a budget a subject has used in one window of time
    Column("subject", Text, primary_key=True),
    Column("window", Text, primary_key=True),
    _number("count", default=0),
)
