"""What an operator can set: environment variables `MARK3DGS_...`, each with a default that works on one machine."""

from pathlib import Path

from pydantic import Field, SecretStr, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

GIB = 1 << 30
MIB = 1 << 20
DATABASE, JOBS_DATABASE = "mark3dgs.sqlite", "jobs.sqlite"
"""Files in the data folder: our tables, and the job engine's."""

OPTIONAL_ROUTERS = ("acquisitions", "credentials", "disputes", "packs", "shares", "webhooks")
"""Parts of the API that an operator can leave out."""


class Settings(BaseSettings):
    """Settings of one process of the service; API processes and workers share them."""

    model_config = SettingsConfigDict(env_prefix="MARK3DGS_", extra="ignore")

    data_dir: Path = Field(Path("mark3dgs-data"), description="Folder of database, blobs and scratch files.")
    database_url: str = Field("", description="postgresql://...; empty: a SQLite file in the data folder.")
    database_wait_seconds: float = Field(
        300.0, ge=0, description="`serve` and `worker` wait so long at their start for PostgreSQL to answer."
    )
    blob_url: str = Field("", description="s3://bucket/prefix; empty: a folder in the data folder.")
    master_key: SecretStr | None = Field(
        None, description="64 hex digits that seal all secrets; empty: the file master.key in the data folder."
    )
    workers: int = Field(1, ge=0, le=64, description="Worker processes that `serve` starts.")
    worker_silence_seconds: float = Field(
        15.0, gt=0, description="A worker silent for this long is given up; others take over its jobs."
    )

    connections: int = Field(
        1000, ge=10, description="Connections to an API process at a time; further requests answer 503."
    )
    max_upload_bytes: int = Field(2 * GIB, gt=0, description="Largest upload.")
    max_form_bytes: int = Field(64 * MIB, gt=0, description="Largest multipart form; larger files go by upload.")
    max_body_bytes: int = Field(1 * MIB, gt=0, description="Largest JSON body.")
    upload_hours: float = Field(24.0, gt=0, description="An upload not finished by then is dropped.")

    suspect_days: float = Field(30.0, gt=0, description="Uploads are kept that long; what was made of them stays.")
    job_days: float = Field(
        90.0, gt=0, description="Rows of ended jobs are kept that long; assets, claims and disputes stay."
    )

    inspect_seconds: float = Field(
        4.5, gt=0, description="A look at an upload that takes longer is left to the job that uses it."
    )

    child_memory_bytes: int = Field(10 * GIB, gt=0, description="Address space of one step's process.")
    child_cpu_seconds: int = Field(1800, gt=0, description="CPU time of one step's process.")
    child_file_bytes: int = Field(4 * GIB, gt=0, description="Largest file one step's process may write.")

    embeds_per_hour: int = Field(120, gt=0, description="Embed jobs an API key may start in an hour.")
    verifies_per_hour: int = Field(600, gt=0, description="Verify jobs an API key may start in an hour.")
    subject_verifies_per_day: int = Field(
        200, gt=0, description="Verifications a day of suspects that derive from one original (near duplicates)."
    )
    subject_embeds_per_day: int = Field(
        100,
        gt=0,
        description="Embed jobs a day of a tenant's uploads that are alike; the same file again does not count.",
    )
    watch_minutes: float = Field(
        60.0,
        ge=0,
        description="Marks of other owners are searched for in an upload, at a random moment within this time after it"
        " was marked: the queue, as its uploader sees it, reveals nothing of them.",
    )
    matches_per_hour: int = Field(
        60, gt=0, description="Searches for manifests by content that an API key may make in an hour."
    )
    queued_jobs: int = Field(200, gt=0, description="Jobs of a tenant that may wait or run at a time.")
    conversions_at_once: int = Field(2, gt=0, description="Models that are converted for a tenant at a time.")
    open_uploads: int = Field(100, gt=0, description="Uploads of a tenant that may be under way at a time.")
    tenant_bytes: int = Field(
        100 * GIB, gt=0, description="Uploads, acquisitions and assets of a tenant, together; conversions do not count."
    )
    acquisitions_per_hour: int = Field(60, gt=0, description="Acquisitions an API key may make in an hour.")
    acquire_seconds: float = Field(60.0, gt=0, description="An address that takes longer to answer is given up.")
    acquisitions_private: bool = Field(
        False, description="Addresses to acquire from may be private, loopback and link-local ones."
    )
    webhooks: int = Field(5, ge=0, description="Webhooks of a tenant.")
    webhooks_private: bool = Field(
        False, description="Webhooks may go to private, loopback and link-local addresses, and over plain HTTP."
    )
    issuer_name: str = Field("Mark3DGS", min_length=1, max_length=200, description="Who issues claims, as they say.")
    public_url: str = Field(
        "", pattern=r"^(https?://[^\s]+)?$", description="Address of this service, as claims and reports name it."
    )
    tsa_url: str = Field("", description="RFC 3161 time-stamping service; empty: no stamp.")
    tsa_certificates: str = Field(
        "",
        description="File with the certificates (PEM) that vouch for it: records are then drawn for by it, and claims"
        " need 1 in 10^9; empty: 1 in 2^128.",
    )
    credentials_certificates: str = Field(
        "", description="File with the certificate chain (PEM) that signs Content Credentials; empty: none are made."
    )
    credentials_key: str = Field("", description="File with the private key (PEM) of that chain's first certificate.")

    routers: str = Field(
        ",".join(OPTIONAL_ROUTERS),
        description="Parts of the API beyond the core, separated by commas; others are not there.",
    )

    @field_validator("routers")
    @classmethod
    def _known_routers(cls, text: str) -> str:
        if unknown := set(filter(None, text.split(","))) - set(OPTIONAL_ROUTERS):
            raise ValueError(f"{', '.join(sorted(unknown))}: none of {', '.join(OPTIONAL_ROUTERS)}")
        return text

    def has_router(self, name: str) -> bool:
        """Whether a part of the API is there."""
        return name not in OPTIONAL_ROUTERS or name in self.routers.split(",")

    def database(self) -> str:
        """SQLAlchemy URL of our tables."""
        if not self.database_url:
            return f"sqlite:///{(self.data_dir / DATABASE).absolute()}"
        return self.database_url.replace("postgresql://", "postgresql+psycopg://", 1)

    def jobs_database(self) -> str:
        """SQLAlchemy URL of the job engine's tables: a file of its own on SQLite, the same server otherwise."""
        if not self.database_url:
            return f"sqlite:///{(self.data_dir / JOBS_DATABASE).absolute()}"
        return self.database()

    @property
    def scratch(self) -> Path:
        """Folder of files in the making, on the file system of the local blobs."""
        return self.data_dir / "scratch"
