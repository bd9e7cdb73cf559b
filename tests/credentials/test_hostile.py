"""Manifests made to mislead or to harm: none is trusted, and the model is read all the same."""

from __future__ import annotations

import http.server
import os
import sys
import threading
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.credentials import native, signing
from engine.credentials.manifest import EMBEDDED, MOST_BYTES, model_type
from engine.credentials.native import MOST_CHARACTERS, MOST_ENTRIES, parse
from engine.credentials.reading import Credentials, read_credentials
from engine.credentials.signer import Signer
from engine.credentials.signing import sign_into, sign_sidecar
from engine.errors import InputError
from engine.formats import read_model
from tests.credentials.conftest import RECORD, Desk
from tests.credentials.keys import KEYS, MAIL, chain_of, pem

BYTES_FLIPPED = 300


@pytest.fixture
def signed(files: dict[str, Path], desk: Desk, tmp_path: Path) -> Path:
    """A signed .sog."""
    path = tmp_path / "signed.sog"
    sign_into(files["sog"], path, RECORD, desk.signer)
    return path


def read(path: Path, desk: Desk | None = None) -> Credentials:
    """Its credentials, by which the model is read no worse."""
    assert len(read_model(path).model) == 1000
    found = read_credentials(path, "sog", desk.authority if desk else "")
    assert found is not None
    return found


def repacked(source: Path, target: Path, change: Callable[[str, bytes], bytes], **more: bytes) -> None:
    """A .sog with its entries changed, and more of them."""
    with zipfile.ZipFile(source) as before, zipfile.ZipFile(target, "w") as after:
        for entry in before.infolist():
            after.writestr(entry, change(entry.filename, before.read(entry)))
        for name, content in more.items():
            after.writestr(name.replace("__", "/"), content)


def test_any_change_of_the_file_shows(signed: Path, desk: Desk, tmp_path: Path) -> None:
    with zipfile.ZipFile(signed) as archive:
        at = archive.getinfo("means_l.webp").header_offset
        directory = archive.start_dir
    for place in (at + 10, directory + 12):  # a time in a local header, and in the directory: no reader cares
        data = bytearray(signed.read_bytes())
        data[place] ^= 1
        changed = tmp_path / f"changed {place}.sog"
        changed.write_bytes(data)
        assert read(changed, desk).state == "Invalid"
    more = tmp_path / "more.sog"
    more.write_bytes(signed.read_bytes())
    with zipfile.ZipFile(more, "a") as archive:
        archive.writestr("note.txt", "mine")
    assert read(more, desk).state == "Invalid"


def test_a_manifest_of_another_file(signed: Path, files: dict[str, Path], desk: Desk, tmp_path: Path) -> None:
    """A forger who puts a trusted name into a model of his own is found out."""
    with zipfile.ZipFile(signed) as archive:
        store = archive.read(EMBEDDED)
    thief, mine = tmp_path / "thief.sog", read_model(files["sog"]).model
    from engine.formats import encode_model

    thief.write_bytes(encode_model(mine.with_(means=mine.means + np.float32(1.0)), "sog"))
    with zipfile.ZipFile(thief, "a") as archive:
        archive.writestr("META-INF/", b"")
        archive.writestr(EMBEDDED, store)
    found = read(thief, desk)
    assert (found.state, found.signer) == ("Invalid", "Studio Acme")
    beside = tmp_path / "stolen.glb"
    beside.write_bytes(files["glb"].read_bytes())
    of_splat = sign_sidecar(files["splat"], "splat", RECORD, desk.signer).store
    for stolen, states in ((store, ("Unread", "Invalid")), (of_splat, ("Invalid",))):
        (tmp_path / "stolen.c2pa").write_bytes(stolen)
        other = read_credentials(beside, "glb", desk.authority)
        assert other is not None
        assert other.state in states


def test_bytes_flipped_in_a_manifest_never_pass_for_another(files: dict[str, Path], desk: Desk) -> None:
    """Each is refused, invalid, or changes nothing that is reported (padding)."""
    store = sign_sidecar(files["glb"], "glb", RECORD, desk.signer).store
    whole = parse(files["glb"], "model/gltf-binary", store, desk.authority)
    assert whole["state"] == "Trusted"
    rng, seen = np.random.default_rng(7), set()
    for place in rng.choice(len(store), BYTES_FLIPPED, replace=False):
        data = bytearray(store)
        data[place] ^= 1 << int(rng.integers(8))
        try:
            found = parse(files["glb"], "model/gltf-binary", bytes(data), desk.authority)
        except InputError:
            seen.add("refused")
            continue
        seen.add(found["state"])
        assert found["state"] == "Invalid" or found == whole, place
    assert {"refused", "Invalid"} <= seen


def test_manifests_that_are_none(files: dict[str, Path], desk: Desk, signed: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(signed) as archive:
        store = archive.read(EMBEDDED)
    for number, junk in enumerate((b"", b"\0" * 100, b"jumb" * 1000, store[:40], store[:3000], store[::-1])):
        path = tmp_path / f"junk {number}.sog"
        repacked(files["sog"], path, lambda name, content: content, **{"META-INF__content_credential.c2pa": junk})
        found = read(path, desk)
        assert found.state in ("Unread", "Invalid"), number
        assert found.record_ids == [], number
        if found.state == "Unread":
            assert found.reason
            assert "\n" not in found.reason


def test_a_huge_manifest_reaches_no_native_code(
    files: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def reply(request: dict[str, str]) -> dict[str, Any]:
        raise AssertionError("it was handed on")

    monkeypatch.setattr("engine.credentials.reading._ask", reply)
    stored, bomb = tmp_path / "stored.sog", tmp_path / "bomb.sog"
    repacked(
        files["sog"],
        stored,
        lambda name, content: content,
        **{"META-INF__content_credential.c2pa": bytes(MOST_BYTES + 1)},
    )
    bomb.write_bytes(files["sog"].read_bytes())
    with zipfile.ZipFile(bomb, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(EMBEDDED, bytes(64 << 20))
    assert bomb.stat().st_size < 200_000
    beside = tmp_path / "huge.splat"
    beside.write_bytes(files["splat"].read_bytes())
    (tmp_path / "huge.c2pa").write_bytes(bytes(MOST_BYTES + 1))
    for path in (stored, bomb, beside):
        found = read(path)
        assert (found.state, str(MOST_BYTES) in found.reason.replace(",", "")) == ("Unread", True)


@pytest.mark.parametrize("program", ["import os; os.abort()", "import time; time.sleep(60)", "print('[]')", "print(1)"])
def test_a_library_that_dies_or_hangs(program: str, signed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("engine.credentials.reading._COMMAND", (sys.executable, "-c", program))
    monkeypatch.setattr("engine.credentials.reading.SECONDS", 1.0)
    found = read(signed)
    assert (found.state, "limits" in found.reason) == ("Unread", True)


def test_the_process_has_limits(signed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that takes memory without end is ended before the machine notices."""
    greedy = "p.parse = lambda *a: (bytearray(8 << 30), {'reason': 'took it all'})[1]; p.main()"
    program = f"import engine.credentials.process as p; {greedy}"
    monkeypatch.setattr("engine.credentials.reading._COMMAND", (sys.executable, "-c", program))
    assert "limits" in read(signed).reason


def test_words_that_harm_a_terminal(
    files: dict[str, Path], desk: Desk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = signing.describe(RECORD)
    plain["claim_generator_info"] = [{"name": "\x1b[2J\x1b]0;x\x07" + "A" * 5000, "version": "1\n2"}]
    binding = plain["assertions"][1]["data"]
    binding["blocks"] = [{"scope": {}, "value": "\x1b[31mvalue" + "B" * 5000}] * 50
    plain["assertions"][0]["data"]["actions"] += [{"action": "c2pa.edited", "description": "x"}] * 50
    monkeypatch.setattr(signing, "describe", lambda record: plain)
    path = tmp_path / "loud.sog"
    sign_into(files["sog"], path, RECORD, desk.signer)
    found = read(path)
    output = (*found.actions, *(part for binding in found.bindings for part in binding), found.generator, found.signer)
    assert all(text.isprintable() for text in output)
    assert "?[31mvalue" in found.bindings[0][1]
    assert len(found.generator) <= MOST_CHARACTERS
    assert len(found.bindings) == len(found.actions) == MOST_ENTRIES
    assert found.record_ids == []


def test_the_folder_one_stands_in_is_not_run(
    signed: Path, desk: Desk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who unpacks a stranger's folder and inspects what is in it runs none of it."""
    trap = "open('sprung', 'w').close()"
    for name in ("c2pa", "json", "resource"):
        (tmp_path / f"{name}.py").write_text(trap)
    known = os.environ.get("PYTHONPATH", "")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(os.path.abspath(each) for each in known.split(os.pathsep) if each))
    monkeypatch.chdir(tmp_path)
    assert read(signed, desk).state == "Trusted"
    assert not (tmp_path / "sprung").exists()


def test_nobody_is_called(files: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """A certificate may name an address to ask about it (OCSP): the signer would learn who looks, and when."""
    calls: list[str] = []

    class Listener(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            calls.append(self.path)
            self.send_error(404)

        do_GET = do_POST

        def log_message(self, *args: Any) -> None:
            """Quiet."""

    server = http.server.HTTPServer(("127.0.0.1", 0), Listener)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        key = KEYS["es256"]()
        chain = chain_of(key, usages=MAIL, ocsp=f"http://127.0.0.1:{server.server_port}/ocsp")
        made = sign_sidecar(files["glb"], "glb", RECORD, Signer(chain, pem(key)))
        assert parse(files["glb"], model_type("glb"), made.store)["state"] == "Valid"
        assert calls == []
        verify = native.SETTINGS["verify"] | {"ocsp_fetch": True}
        monkeypatch.setitem(native.SETTINGS, "verify", verify)
        parse(files["glb"], model_type("glb"), made.store)
        assert calls, "or this test sees nothing"
    finally:
        server.shutdown()
