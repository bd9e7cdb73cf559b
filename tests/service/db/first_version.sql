-- The tables as the first version (0001) made them on SQLite, and its mark in them.
CREATE TABLE alembic_version (version_num VARCHAR(32) NOT NULL, CONSTRAINT alembic_version_pkc PRIMARY KEY
    (version_num));
CREATE TABLE api_keys (id TEXT NOT NULL, tenant TEXT NOT NULL, digest TEXT NOT NULL, scopes TEXT NOT NULL,
    label TEXT NOT NULL, created_at TEXT NOT NULL, revoked_at TEXT, PRIMARY KEY (id));
CREATE TABLE assets (id TEXT NOT NULL, tenant TEXT NOT NULL, job TEXT NOT NULL, owner_key TEXT NOT NULL, label
    TEXT NOT NULL, copy TEXT NOT NULL, record_id TEXT NOT NULL, message TEXT NOT NULL, profile TEXT NOT NULL,
    report TEXT NOT NULL, gaussians BIGINT NOT NULL, original_sha256 TEXT NOT NULL, model_sha256 TEXT NOT NULL,
    original_format TEXT NOT NULL, model_format TEXT NOT NULL, record_sha256 TEXT NOT NULL, preview_sha256 TEXT
    NOT NULL, sketch_sha256 TEXT NOT NULL, registered_at TEXT NOT NULL, PRIMARY KEY (id), UNIQUE (job));
CREATE TABLE audit ("index" INTEGER NOT NULL, at TEXT NOT NULL, tenant TEXT NOT NULL, event TEXT NOT NULL,
    subject TEXT NOT NULL, payload TEXT NOT NULL, hash TEXT NOT NULL, PRIMARY KEY ("index"));
CREATE TABLE audit_nodes (level INTEGER NOT NULL, position BIGINT NOT NULL, hash TEXT NOT NULL, PRIMARY KEY
    (level, position));
CREATE TABLE claims (id TEXT NOT NULL, tenant TEXT NOT NULL, job TEXT NOT NULL, asset TEXT, document TEXT NOT
    NULL, jws TEXT NOT NULL, pictures TEXT NOT NULL, created_at TEXT NOT NULL, timestamp BLOB, PRIMARY KEY (id),
    UNIQUE (job));
CREATE TABLE conversions (model_sha256 TEXT NOT NULL, format TEXT NOT NULL, sha256 TEXT NOT NULL, PRIMARY KEY
    (model_sha256, format));
CREATE TABLE facts (name TEXT NOT NULL, value TEXT NOT NULL, PRIMARY KEY (name));
CREATE TABLE idempotency (tenant TEXT NOT NULL, "key" TEXT NOT NULL, body_hash TEXT NOT NULL, job TEXT,
    created_at TEXT NOT NULL, PRIMARY KEY (tenant, "key"));
CREATE TABLE jobs (id TEXT NOT NULL, tenant TEXT NOT NULL, state TEXT NOT NULL, created_at TEXT NOT NULL,
    api_key TEXT NOT NULL, kind TEXT NOT NULL, request TEXT NOT NULL, stage TEXT NOT NULL, fraction FLOAT NOT
    NULL, result TEXT, problem TEXT, revision BIGINT NOT NULL, cancelling BOOLEAN NOT NULL, worker TEXT,
    started_at TEXT, finished_at TEXT, attempts BIGINT NOT NULL, tries BIGINT NOT NULL, PRIMARY KEY (id));
CREATE TABLE owner_keys (id TEXT NOT NULL, tenant TEXT NOT NULL, fingerprint TEXT NOT NULL, label TEXT NOT
    NULL, version BIGINT NOT NULL, sealed BLOB, created_at TEXT NOT NULL, deleted_at TEXT, PRIMARY KEY (id));
CREATE TABLE signing_keys (kid TEXT NOT NULL, public TEXT NOT NULL, created_at TEXT NOT NULL, sealed BLOB NOT
    NULL, retired_at TEXT, PRIMARY KEY (kid));
CREATE TABLE uploads (id TEXT NOT NULL, tenant TEXT NOT NULL, created_at TEXT NOT NULL, name TEXT NOT NULL,
    parts TEXT NOT NULL, state TEXT NOT NULL, size BIGINT, received BIGINT NOT NULL, sha256 TEXT, info TEXT,
    PRIMARY KEY (id));
CREATE TABLE usage (subject TEXT NOT NULL, "window" TEXT NOT NULL, count BIGINT NOT NULL, PRIMARY KEY
    (subject, "window"));
CREATE TABLE workers (id TEXT NOT NULL, host TEXT NOT NULL, started_at TEXT NOT NULL, pid BIGINT NOT NULL,
    seen_at FLOAT NOT NULL, PRIMARY KEY (id));
CREATE INDEX ix_api_keys_tenant ON api_keys (tenant);
CREATE INDEX ix_assets_model_sha256 ON assets (model_sha256);
CREATE INDEX ix_assets_original_sha256 ON assets (original_sha256);
CREATE INDEX ix_assets_tenant ON assets (tenant);
CREATE INDEX ix_audit_event ON audit (event);
CREATE INDEX ix_audit_subject ON audit (subject);
CREATE INDEX ix_claims_tenant ON claims (tenant);
CREATE INDEX ix_idempotency_created_at ON idempotency (created_at);
CREATE INDEX ix_jobs_created_at ON jobs (created_at);
CREATE INDEX ix_jobs_state ON jobs (state);
CREATE INDEX ix_jobs_tenant ON jobs (tenant);
CREATE INDEX ix_owner_keys_tenant ON owner_keys (tenant);
CREATE INDEX ix_uploads_created_at ON uploads (created_at);
CREATE INDEX ix_uploads_tenant ON uploads (tenant);
INSERT INTO alembic_version VALUES ('0001');
