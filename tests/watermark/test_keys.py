"""Owner keys: files, derivation, and streams that any later version must reproduce bit for bit."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import numpy as np
import pytest

from engine.errors import KeyFileError
from engine.watermark import keys
from engine.watermark.keys import CHIPS, POSE, OwnerKey, keystream, permutation, signs, uniform

KEY = OwnerKey(bytes(range(32)))


@pytest.mark.parametrize("secret", [b"", bytes(range(31)), bytes(range(256)) * 5, bytes(32)])
def test_weak_secrets_are_refused(secret: bytes) -> None:
    with pytest.raises(KeyFileError):
        OwnerKey(secret)


def test_generated_keys_differ_and_round_trip(tmp_path: Path) -> None:
    first, second = OwnerKey.generate(), OwnerKey.generate()
    assert first != second
    assert len(first.secret) == 32
    path = tmp_path / "owner.key"
    first.write(path)
    assert OwnerKey.read(path) == first
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert os.listdir(tmp_path) == ["owner.key"]  # no part file left behind


def test_key_file_says_what_it_is_and_never_gets_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "owner.key"
    KEY.write(path)
    text = path.read_text()
    assert text.startswith(f"mark3dgs-owner-key 1 {KEY.fingerprint}\n")
    assert "SECRET" in text
    with pytest.raises(KeyFileError, match="never overwritten"):
        OwnerKey.generate().write(path)
    assert path.read_text() == text
    assert os.listdir(tmp_path) == ["owner.key"]


def test_key_file_is_written_where_links_are_not_allowed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    path = tmp_path / "owner.key"
    KEY.write(path)
    assert OwnerKey.read(path) == KEY
    with pytest.raises(KeyFileError, match="never overwritten"):
        KEY.write(path)


def test_repr_and_errors_hide_the_secret(tmp_path: Path) -> None:
    assert KEY.secret.hex() not in f"{KEY!r} {KEY}"
    assert KEY.fingerprint in repr(KEY)
    path = tmp_path / "bad.key"
    body = KEY.secret.hex()[:-1] + "g"
    path.write_text(f"mark3dgs-owner-key 1 {KEY.fingerprint}\n{body}\n")
    path.chmod(0o600)
    with pytest.raises(KeyFileError) as caught:
        OwnerKey.read(path)
    assert body[:16] not in str(caught.value)
    assert caught.value.__cause__ is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no owner key file"),
        ("hello\n", "no owner key file"),
        (f"mark3dgs-owner-key 2 {KEY.fingerprint}\n{KEY.secret.hex()}\n", "version 2"),
        (f"mark3dgs-owner-key 1 {'0' * 16}\n{KEY.secret.hex()}\n", "altered"),
        (f"mark3dgs-owner-key 1 {KEY.fingerprint}\n{KEY.secret.hex()[:-2]}\n", "31"),
        ("x" * 20_000, "no owner key file"),
    ],
)
def test_bad_key_files_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.key"
    path.write_text(text)
    path.chmod(0o600)
    with pytest.raises(KeyFileError, match=message):
        OwnerKey.read(path)


def test_missing_files_and_folders_are_key_errors(tmp_path: Path) -> None:
    with pytest.raises(KeyFileError, match="cannot read"):
        OwnerKey.read(tmp_path / "none")
    with pytest.raises(KeyFileError, match="cannot write"):
        KEY.write(tmp_path / "none" / "owner.key")


def test_sub_keys_are_separate() -> None:
    purposes = [
        value
        for name, value in vars(keys).items()
        if name.isupper() and isinstance(value, str) and not name.startswith("_")
    ]
    assert len(purposes) == len(set(purposes)) >= 8
    made = {KEY.derive(p, c) for p in purposes for c in (b"", b"a", b"\0a")}
    assert len(made) == 3 * len(purposes)
    assert KEY.derive("chips", b"x") != KEY.derive("chip", b"s\0x")
    for purpose in ("", "a\0b"):
        with pytest.raises(ValueError, match="purpose"):
            KEY.derive(purpose, b"")


def test_streams_are_frozen() -> None:
    """Records outlive program versions: these values must never change."""
    assert KEY.fingerprint == "e5b39bdab9d34f9e"
    subkey = KEY.derive(CHIPS, b"context")
    assert subkey.hex() == "970a798f9e6a8d6aba1edf135c23c0eade6f5fe8c7ec62372f297dbe46dfd1a0"
    assert signs(subkey, 12).tolist() == [-1, 1, 1, -1, 1, 1, 1, -1, -1, 1, -1, 1]
    assert permutation(subkey, 8).tolist() == [6, 0, 2, 7, 5, 1, 3, 4]
    assert uniform(subkey, 2).tolist() == [0.3330422933926228, 0.07917110943613104]


def test_streams_have_their_type_and_range() -> None:
    subkey = KEY.derive(POSE, b"")
    n = 100_003
    s, p, u = signs(subkey, n), permutation(subkey, n), uniform(subkey, n)
    assert (s.dtype, p.dtype, u.dtype) == (np.int8, np.int64, np.float64)
    assert set(np.unique(s)) == {-1, 1}
    assert abs(int(s.sum())) < 5 * n**0.5
    assert np.array_equal(np.sort(p), np.arange(n))
    assert u.min() >= 0
    assert u.max() < 1
    assert abs(u.mean() - 0.5) < 5 * (1 / 12 / n) ** 0.5
    assert abs(np.corrcoef(s, u)[0, 1]) < 5 / n**0.5  # streams of one sub-key are unrelated
    assert np.array_equal(signs(subkey, 77), s[:77])
    assert len(signs(subkey, 0)) == len(permutation(subkey, 0)) == len(uniform(subkey, 0)) == 0


def test_keystream_is_rfc_8439() -> None:
    """Appendix A.1, test vector 1: all-zero key and nonce, block counter 0."""
    block = keystream(bytes(32), 16, "").tobytes()
    assert block.hex() == "76b8e0ada0f13d90405d6ae55386bd28"
    with pytest.raises(ValueError, match="32 bytes"):
        keystream(b"short", 1, "")
    with pytest.raises(ValueError, match="-1"):
        keystream(bytes(32), -1, "")


def test_the_text_of_a_key_file_is_a_key(tmp_path: Path) -> None:
    KEY.write(tmp_path / "owner.key")
    text = (tmp_path / "owner.key").read_text()
    assert OwnerKey.from_text(text) == KEY
    with pytest.raises(KeyFileError, match="'upload' is no owner key file"):
        OwnerKey.from_text("", "upload")
    with pytest.raises(KeyFileError, match="was altered"):
        OwnerKey.from_text(text.replace("0001", "0002"))


@pytest.mark.skipif(os.name != "posix", reason="files have no such rights here")
@pytest.mark.parametrize("mode", [0o644, 0o640, 0o604, 0o602, 0o660])
def test_a_key_that_others_can_read_is_no_secret(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "owner.key"
    KEY.write(path)
    path.chmod(mode)
    with pytest.raises(KeyFileError, match="chmod 600"):
        OwnerKey.read(path)
    path.chmod(0o400)
    assert OwnerKey.read(path) == KEY
