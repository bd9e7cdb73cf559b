"""The master key: one secret of the operator that seals all secrets in the database."""

from __future__ import annotations

import fcntl
import hmac
import os
import secrets
import stat
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from engine.errors import Mark3DGSError
from service.db import Database, fact
from service.db.schema import facts
from service.problems import Problem
from service.settings import Settings

VERSION = 1
"""Of the master key; part of what each seal is bound to."""

KEY_BYTES = 32
_NONCE_BYTES = 12
FILE = "master.key"
CHECK, RETIRED = "master_key_check", "retired_mac_keys"
"""Facts of this database: which master key it is, and the sealed sub-keys of those before."""
_SALT = b"mark3dgs-service/1"


class MasterKeyError(Mark3DGSError):
    """The master key is missing, unsafe, malformed or not the one that sealed this database."""


class MasterKey:
    """Seals secrets (AES-256-GCM) and authenticates API keys (HMAC-SHA256), under sub-keys of one secret (32 bytes)."""

    def __init__(self, secret: bytes, retired: Sequence[bytes] = ()) -> None:
        if len(secret) != KEY_BYTES:
            raise MasterKeyError(f"a master key has {KEY_BYTES} bytes, this one has {len(secret)}")
        self._secret, self._retired = bytes(secret), tuple(retired)  # retired: sub-keys that digests were made with
        self._gcm = AESGCM(self._derive("seal"))

    def __repr__(self) -> str:
        return "MasterKey(...)"

    @classmethod
    def open(cls, settings: Settings, db: Database) -> MasterKey:
        """The key of the settings, or of the file in the data folder, which the first start makes (mode 0600).

        Processes that start at the same time agree on one key. MasterKeyError if the file cannot be read, others may
        read it, it holds no key, or the key is not the one that sealed this database.
        """
        # Read before the file is: its maker writes the check value after it.
        with db.read() as connection:
            expected = fact(connection, CHECK)
        if settings.master_key is not None:
            source = "MARK3DGS_MASTER_KEY"
            key = cls(from_hex(settings.master_key.get_secret_value(), source))
        else:
            path = settings.data_dir / FILE
            source = str(path)
            finish_rotation(path, expected)
            key = cls(from_hex(_read_or_make(path, may_make=expected is None), source))
        if expected is None:
            expected = _agree_on_check(db, key.check_value)
        if not hmac.compare_digest(expected or "", key.check_value):
            raise MasterKeyError(
                f"the master key of {source} is not the one that sealed this database; put the old key back"
            )
        return cls(key._secret, key._retired_keys(db))

    @property
    def check_value(self) -> str:
        """Tells two master keys apart and reveals nothing about them."""
        return self._derive("check")[:16].hex()

    def seal(self, plain: bytes, aad: bytes) -> bytes:
        """Encrypt and authenticate, bound to `aad` (of `bind`): nonce, then ciphertext and tag."""
        nonce = secrets.token_bytes(_NONCE_BYTES)
        return nonce + self._gcm.encrypt(nonce, plain, aad)

    def unseal(self, sealed: bytes, aad: bytes) -> bytes:
        """What `seal` was given; "internal" if the bytes were altered or belong to another `aad`."""
        try:
            return self._gcm.decrypt(sealed[:_NONCE_BYTES], sealed[_NONCE_BYTES:], aad)
        except (InvalidTag, ValueError):
            raise Problem("internal", "a sealed secret was altered, or moved from its place") from None

    def mac(self, purpose: str, *parts: str) -> str:
        """HMAC-SHA256 of the parts under a sub-key of this purpose, hex."""
        return hmac.digest(self._derive(f"mac {purpose}"), bind(purpose, *parts), "sha256").hex()

    def recognises(self, digest: str, purpose: str, *parts: str) -> bool:
        """Whether a digest is the MAC of the parts, under this key or one before it."""
        keys = (self._derive(f"mac {purpose}"), *self._retired)
        found = (hmac.digest(key, bind(purpose, *parts), "sha256").hex() for key in keys)
        return any(hmac.compare_digest(each, digest) for each in found)

    def retiring(self, purpose: str) -> bytes:
        """What the next key must keep sealed to recognise this one's MACs of a purpose: sub-keys, one after another."""
        return b"".join((*self._retired, self._derive(f"mac {purpose}")))

    def _retired_keys(self, db: Database) -> list[bytes]:
        with db.read() as connection:
            found = fact(connection, RETIRED)
        keys = self.unseal(bytes.fromhex(found), bind(RETIRED)) if found is not None else b""
        return [keys[start : start + KEY_BYTES] for start in range(0, len(keys), KEY_BYTES)]

    def _derive(self, purpose: str) -> bytes:
        return HKDF(SHA256(), KEY_BYTES, _SALT, purpose.encode()).derive(self._secret)


def bind(purpose: str, *parts: str | int) -> bytes:
    """Associated data of a seal: each part after its length, so that no two lists of parts read the same."""
    texts = [str(part).encode() for part in (purpose, *parts)]
    return b"".join(len(text).to_bytes(4, "big") + text for text in texts)


def _agree_on_check(db: Database, mine: str) -> str:
    """The check value that stands in the database: this one, unless another process was first."""
    with db.exclusive() as connection:
        standing = fact(connection, CHECK)
        if standing is None:
            connection.execute(facts.insert().values(name=CHECK, value=mine))
    return standing or mine


def from_hex(text: str, source: str) -> bytes:
    """A master key from its digits; MasterKeyError, which names the source, if that is not what they are."""
    try:
        secret = bytes.fromhex(text.strip())
    except ValueError:  # without the text: it may hold most of the secret
        secret = b""
    if len(secret) != KEY_BYTES:
        raise MasterKeyError(f"{source} must hold {2 * KEY_BYTES} hexadecimal digits")
    return secret


def new_file(path: Path) -> Path:
    """Where the next master key lies while secrets are sealed anew."""
    return path.with_suffix(".new")


def finish_rotation(path: Path, expected: str | None) -> None:
    """Put a new key in its place if the database is sealed with it already: a rotation died in between."""
    new = new_file(path)
    with suppress(FileNotFoundError):
        if MasterKey(from_hex(new.read_text(), str(new))).check_value == expected:
            new.replace(path)


def _read_or_make(path: Path, *, may_make: bool) -> str:
    try:
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            fcntl.flock(folder, fcntl.LOCK_EX)  # others that start now wait, and read what this one made
            if not path.exists():
                if not may_make:
                    raise MasterKeyError(
                        f"{path} is missing, and this database was sealed with a master key: put the file back,"
                        " or set MARK3DGS_MASTER_KEY"
                    )
                write_key(path, secrets.token_hex(KEY_BYTES))
                os.fsync(folder)
        finally:
            os.close(folder)
        with path.open("rb") as file:
            mode = stat.S_IMODE(os.fstat(file.fileno()).st_mode)
            if mode & 0o077:
                raise MasterKeyError(f"{path} has mode {mode:04o}: others may use it; run chmod 600 on it")
            return file.read(4 * KEY_BYTES).decode("ascii", "replace")
    except OSError as error:
        raise MasterKeyError(f"cannot read the master key {path}: {error.strerror}") from error


def write_key(path: Path, text: str) -> None:
    """A key file (mode 0600) that appears whole or not at all."""
    part = path.with_suffix(".part")
    part.unlink(missing_ok=True)  # left by a start that died in the middle
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "w") as file:
        file.write(text + "\n")
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)
