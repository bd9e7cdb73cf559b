"""The command `mark3dgs`: the engine's sub-commands and the service's."""

from engine.cli.app import app, main, run
from service.cli.admin import apikey, audit, rotate_master_key, rotate_signing_key, tenant
from service.cli.backups import backup, restore
from service.cli.openapi import openapi
from service.cli.serve import init, serve, worker
from service.cli.verify_report import verify_report

app.command("serve")(serve)
app.command("init")(init)
app.command("worker")(worker)
app.command("verify-report")(verify_report)
app.command("openapi")(openapi)
app.command("tenant")(tenant)
app.command("backup")(backup)
app.command("restore")(restore)
app.add_typer(apikey, name="apikey")
app.add_typer(audit, name="audit")
app.command("rotate-master-key")(rotate_master_key)
app.command("rotate-signing-key")(rotate_signing_key)

__all__ = ["main", "run"]
