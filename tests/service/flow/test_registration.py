"""An asset has one time of registration, the log's: when the work was done, not when it was requested."""

from __future__ import annotations

from pathlib import Path

from service.core import Service
from service.db.schema import assets
from service.embeds.flow import embed_flow
from service.jobs.port import Job, Run, State
from service.settings import Settings
from service.trust.audit_check import verify_log
from service.trust.commitments import registration_of


def test_row_and_log_say_the_same_time(tmp_path: Path) -> None:
    service = Service.open(Settings(data_dir=tmp_path))
    request = {"model": "a" * 64, "key_id": "k", "label": "", "copy_name": "", "profile": "fast"}
    created = "2026-01-02T03:04:05.000000+00:00"
    job = Job("job_1", "acme", "key", "embed", State.RUNNING, request, created_at=created)
    texts = ("record_id", "message", "original_format", "format")
    report = {"gaussians_out": 1, "psnr_worst_view": 50.0, "ssim_worst_view": 1.0, "seconds": 1.0}
    made = {**dict.fromkeys(texts, "x"), "report": report, "screening": {"carries": []}}
    made["kept"] = dict.fromkeys(("model", "record", "preview", "sketch"), "b" * 64)
    for _ in range(2):  # a step may run twice
        embed_flow(service)[1].do(Run(job, {"embed": made}))
    with service.db.read() as connection:
        row = connection.execute(assets.select()).one()
        entry = registration_of(connection, "as_1")
    assert row.registered_at == entry.at > created
    assert not [fault for fault in verify_log(service.db).faults if fault.code == "asset"]
    service.close()
