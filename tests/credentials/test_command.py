"""The commands: a trial certificate, a signed model, and what `inspect` shows of it."""

from __future__ import annotations

import json
import stat
import zipfile
from pathlib import Path
from typing import Any

import pytest

from engine.cli.app import run
from engine.credentials.manifest import ALG, binding_value
from tests.credentials.conftest import DATA, RECORD


def ask(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> dict[str, Any]:
    """The JSON of a command, which succeeds."""
    code = run([*map(str, arguments), "--json"])
    out = capsys.readouterr().out
    assert code == 0, out
    found: dict[str, Any] = json.loads(out)
    return found


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """The message of a command that ends with exit code 2."""
    assert run([*map(str, arguments), "--json"]) == 2
    message: str = json.loads(capsys.readouterr().out)["error"]["message"]
    return message


@pytest.fixture
def desk(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> list[str | Path]:
    """Options of a signer made by the command."""
    options = ["--certificates", tmp_path / "chain.pem", "--private-key", tmp_path / "signer.key"]
    ask(capsys, "credentials", "trial", "Studio Acme", *options, "--authority", tmp_path / "authority.pem")
    return options


@pytest.fixture
def record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A record as far as this command reads it: its public header."""
    from engine.records import file
    from engine.records.header import RecordHeader

    digits = {"owner": 16, "reference_digest": 64, "original_digest": 64, "copy_digest": 32, "key_check": 32}
    values = {name: "0" * length for name, length in digits.items()}
    header = RecordHeader(RECORD, **values, registered_at="", tool_version="")
    monkeypatch.setattr(file, "read_header", lambda data: header)
    path = tmp_path / "my.record"
    path.write_bytes(b"x")
    return path


def test_what_is_packed_is_not_signed(
    desk: list[str | Path], record: Path, files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    packed = tmp_path / "sent.zip"
    with zipfile.ZipFile(packed, "w") as archive:
        archive.write(files["sog"], "scene.sog")
    message = refused(capsys, "credentials", "sign", packed, tmp_path / "a.sog", "--record", record, *desk)
    assert "sent.zip' is packed: unpack it and sign the file" in message


def test_sign_and_inspect(
    desk: list[str | Path], record: Path, files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "published.sog"
    made = ask(capsys, "credentials", "sign", files["sog"], out, "--record", record, *desk)
    assert made["record_id"] == RECORD
    assert made["bytes_out"] == out.stat().st_size > made["bytes_in"]
    shown = ask(capsys, "inspect", out, "--trust", tmp_path / "authority.pem")
    credentials = shown.pop("credentials")
    assert (credentials["state"], credentials["place"], credentials["id"]) == (
        "Trusted",
        "embedded",
        made["manifest_id"],
    )
    assert credentials["bindings"] == [[ALG, binding_value(RECORD)]]
    assert credentials["record_ids"] == [RECORD]
    bare = ask(capsys, "inspect", files["sog"])
    assert bare.pop("credentials") is None
    same = ("gaussians", "bounds", "center", "radius", "opacity_median", "scale_median", "repairs", "format")
    assert [shown[name] for name in same] == [bare[name] for name in same]
    assert run(["inspect", str(out)]) == 0
    text = capsys.readouterr().out
    for part in ("the signer is not one that you trust", "Studio Acme", "at a time without attestation", RECORD, ALG):
        assert part in text, part


def test_a_manifest_beside_a_glb(
    desk: list[str | Path], record: Path, files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "marked.glb"
    model.write_bytes(files["glb"].read_bytes())
    ask(capsys, "credentials", "sign", model, tmp_path / "marked.c2pa", "--record", record, *desk)
    shown = ask(capsys, "inspect", model)
    assert (shown["credentials"]["place"], shown["credentials"]["state"]) == ("marked.c2pa", "Valid")
    assert (
        run(["credentials", "sign", str(model), str(tmp_path / "else.c2pa"), "--record", str(record), *map(str, desk)])
        == 0
    )
    assert "marked.c2pa" in capsys.readouterr().err


def test_refusals(
    desk: list[str | Path], record: Path, files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known = ["--record", record, *desk]
    out = tmp_path / "out.sog"
    beside = tmp_path / "out.c2pa"
    assert "OUT must end in .c2pa" in refused(capsys, "credentials", "sign", files["glb"], out, *known)
    assert "OUT must end in .sog" in refused(capsys, "credentials", "sign", files["sog"], beside, *known)
    assert "must end in" in refused(capsys, "credentials", "sign", files["glb"], tmp_path / "out.glb", *known)
    same = tmp_path / "same.sog"
    same.write_bytes(files["sog"].read_bytes())
    assert "the input itself" in refused(capsys, "credentials", "sign", same, same, *known)
    text = refused(capsys, "credentials", "sign", DATA / "README.md", out, *known)
    assert "README.md" in text
    swapped = ["--record", record, "--certificates", desk[3], "--private-key", desk[1]]
    assert "no certificates in PEM" in refused(capsys, "credentials", "sign", files["sog"], out, *swapped)
    assert "no certificates" in refused(capsys, "inspect", files["sog"], "--trust", desk[3])
    assert not out.exists()
    assert not list(tmp_path.glob(".*")), "nothing half-written"


def test_trial_keeps_what_is_there(desk: list[str | Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert stat.S_IMODE(Path(desk[3]).stat().st_mode) == 0o600
    before = Path(desk[3]).read_bytes()
    again = ["credentials", "trial", "Other", *desk, "--authority", tmp_path / "authority.pem"]
    assert "exists" in refused(capsys, *again)
    assert Path(desk[3]).read_bytes() == before
    one = ["--certificates", tmp_path / "a", "--private-key", tmp_path / "a", "--authority", tmp_path / "b"]
    assert "different names" in refused(capsys, "credentials", "trial", "Other", *one)
