"""The owner key, the sub-keys that follow from it, and the secret streams drawn from a sub-key.

One owner key serves everything. HKDF-SHA256 (RFC 5869) derives from it one sub-key per purpose and
context; a sub-key feeds ChaCha20 (RFC 8439), and signs, permutations and uniform numbers are read off
that keystream. Nothing here comes from a statistical generator: half of the chips reveal
nothing about the other half, and a chip of a key that had no part in a suspect is a fair coin.
"""

import contextlib
import hmac
import os
import secrets
import stat
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
from cryptography.hazmat.primitives.ciphers import Cipher
from cryptography.hazmat.primitives.ciphers.algorithms import ChaCha20
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from engine.errors import KeyFileError
from engine.model import Float64, Int64

# Purposes of sub-keys. A new use takes a new purpose; two uses never share one.
CHIPS = "chips"
ASSIGNMENT = "assignment"
GRAIN = "grain"
CELLS = "cells"
COPY = "copy"
LATTICE = "lattice"
POSE = "pose"
MESSAGE = "message"
RECORD_SEAL = "record seal"
RECORD_ID = "record id"
RECORD_CHECK = "record check"
DRAW_TERMS = "draw terms"
COPY_NAME = "copy name"
FINGERPRINT = "fingerprint"

MIN_SECRET_BYTES = 32
MAX_SECRET_BYTES = 1024
SUBKEY_BYTES = 32  # what ChaCha20 takes

_SALT = b"mark3dgs/1"  # HKDF salt: keeps our sub-keys apart from those of any other program
_FILE_HEADER = "mark3dgs-owner-key 1"
_FILE_COMMENT = "# SECRET. Everyone who has this file can claim, and remove, your watermarks. Keep a backup offline."
_MAX_FILE_BYTES = 16 * 1024

Int8 = npt.NDArray[np.int8]


@dataclass(frozen=True)
class OwnerKey:
    """The owner's secret, from which every other key follows.

    KeyFileError if the secret is too short, too long, or one byte repeated.
    """

    secret: bytes = field(repr=False)  # 32 to 1024 bytes from a cryptographic source. Never shown by `repr`

    def __post_init__(self) -> None:
        n = len(self.secret)
        if not MIN_SECRET_BYTES <= n <= MAX_SECRET_BYTES:
            raise KeyFileError(f"an owner key has {MIN_SECRET_BYTES} to {MAX_SECRET_BYTES} bytes, this one has {n}")
        if len(set(self.secret)) == 1:
            raise KeyFileError("this owner key is one byte repeated; make one with OwnerKey.generate()")
        object.__setattr__(self, "secret", bytes(self.secret))

    def __repr__(self) -> str:
        return f"OwnerKey(fingerprint={self.fingerprint!r})"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, OwnerKey):
            return NotImplemented
        return hmac.compare_digest(self.secret, other.secret)

    def __hash__(self) -> int:
        return hash(self.fingerprint)

    @classmethod
    def generate(cls) -> "OwnerKey":
        """A fresh key of 32 bytes from the operating system's generator."""
        return cls(secrets.token_bytes(MIN_SECRET_BYTES))

    @property
    def fingerprint(self) -> str:
        """Public short name of the key: 16 hex digits (64 bits) that reveal nothing about it."""
        return self.derive(FINGERPRINT, b"")[:8].hex()

    def derive(self, purpose: str, context: bytes, length: int = SUBKEY_BYTES) -> bytes:
        """Sub-key for one purpose in one context (HKDF-SHA256).

        One sub-key for one (key, purpose, context, length); others are unrelated. Lengths of one (purpose, context) are
        prefixes of one another, so each purpose keeps to one length. ValueError if the purpose is empty or holds a NUL.

        Parameters
        ----------
        purpose : str
            One of this module's constants; ASCII without NUL.
        context : bytes
            What the sub-key is bound to, for example `record.chip_context(...)`. Any bytes.
        length : int
            Bytes wanted, 1 to 8160.
        """
        if not purpose or "\0" in purpose:
            raise ValueError(f"purpose must be a non-empty string without NUL, got {purpose!r}")
        # The purpose ends at the first NUL, so no two (purpose, context) pairs share an info string.
        info = purpose.encode("ascii") + b"\0" + context
        return HKDF(SHA256(), length, _SALT, info).derive(self.secret)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> "OwnerKey":
        """Read a key file written by `write`.

        KeyFileError if the file is missing, may be read or written by others than its owner, is no key file, is of a
        later version, or was altered.
        """
        name = os.fspath(path)
        try:
            with open(path, "rb") as file:
                _refuse_shared(file.fileno(), name)
                data = file.read(_MAX_FILE_BYTES + 1)
        except OSError as error:
            raise KeyFileError(f"cannot read owner key {name!r}: {error.strerror}") from error
        if len(data) > _MAX_FILE_BYTES or not data.isascii():
            raise KeyFileError(f"{name!r} is no owner key file")
        return cls.from_text(data.decode("ascii"), name)

    @classmethod
    def from_text(cls, text: str, name: str = "the key") -> "OwnerKey":
        """The key that the text of a key file holds; KeyFileError as in `read`, under this name."""
        lines = [line.strip() for line in text.splitlines()]
        head = lines[0].split() if lines else []
        if head[:1] != _FILE_HEADER.split()[:1] or len(head) != 3:
            raise KeyFileError(f"{name!r} is no owner key file: its first line is not {_FILE_HEADER!r} ...")
        if head[1] != _FILE_HEADER.split()[1]:
            raise KeyFileError(f"{name!r} is an owner key file of version {head[1]}, this program reads 1")
        body = "".join(line for line in lines[1:] if not line.startswith("#"))
        try:
            key = cls(bytes.fromhex(body))
        except ValueError:  # without the text: it may hold most of the secret
            raise KeyFileError(f"{name!r}: the key is not written in hexadecimal digits") from None
        if key.fingerprint != head[2]:
            raise KeyFileError(f"{name!r} was altered: fingerprint {head[2]} stands on another key")
        return key

    def to_text(self) -> str:
        """The text of a key file."""
        return f"{_FILE_HEADER} {self.fingerprint}\n{_FILE_COMMENT}\n{self.secret.hex()}\n"

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the key to a new file that only its owner can read (mode 0600).

        The file appears whole or not at all. KeyFileError if the file exists already (a key is never overwritten) or
        cannot be written.
        """
        target = Path(path)
        text = self.to_text()
        part = target.with_name(f".{target.name}.{secrets.token_hex(8)}.part")
        try:
            try:
                _write_new(part, text.encode("ascii"))
                try:
                    os.link(part, target)  # unlike rename, fails where the target exists
                except FileExistsError:
                    raise
                except OSError:  # a file system without hard links: exclusive, though not atomic
                    _write_new(target, text.encode("ascii"))
            finally:
                with contextlib.suppress(FileNotFoundError):
                    part.unlink()
        except FileExistsError:
            raise KeyFileError(f"{str(target)!r} exists; an owner key is never overwritten") from None
        except OSError as error:
            raise KeyFileError(f"cannot write owner key {str(target)!r}: {error.strerror}") from error


def _refuse_shared(descriptor: int, name: str) -> None:
    """What others can read is no secret; where files have no such rights, as on Windows, nothing is checked."""
    mode = stat.S_IMODE(os.fstat(descriptor).st_mode)
    if os.name == "posix" and mode & 0o077:
        raise KeyFileError(f"{name!r} may be read or written by others (mode {mode:04o}): chmod 600 {name}")


def _write_new(path: Path, data: bytes) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except OSError:
        path.unlink(missing_ok=True)
        raise


def keystream(subkey: bytes, n: int, use: str) -> npt.NDArray[np.uint8]:
    """(n,) uint8 the first bytes of ChaCha20 under a sub-key of 32 bytes, in the stream of one use.

    A use has at most 12 ASCII letters; streams of different uses of one sub-key are unrelated.
    """
    if len(subkey) != SUBKEY_BYTES:
        raise ValueError(f"a sub-key has {SUBKEY_BYTES} bytes, got {len(subkey)}")
    if n < 0:
        raise ValueError(f"cannot draw {n} values")
    nonce = bytes(4) + use.encode("ascii").ljust(12, b"\0")  # block counter 0, then RFC 8439's 96-bit nonce
    stream = Cipher(ChaCha20(subkey, nonce), mode=None).encryptor().update(bytes(n))
    return np.frombuffer(stream, np.uint8)


def signs(subkey: bytes, n: int) -> Int8:
    """(n,) int8 fair signs, each -1 or +1: one keystream bit each, least significant first."""
    bits = np.unpackbits(keystream(subkey, (n + 7) // 8, "signs"), count=n, bitorder="little")
    return (2 * bits.astype(np.int8) - 1).astype(np.int8)


def permutation(subkey: bytes, n: int) -> Int64:
    """(n,) int64 secret permutation of 0..n-1: the stable order of n 64-bit keystream words."""
    words = keystream(subkey, 8 * n, "permutation").view("<u8")
    return np.argsort(words, kind="stable").astype(np.int64)


def uniform(subkey: bytes, n: int, use: str = "uniform") -> Float64:
    """(n,) float64 in [0, 1): multiples of 2^-53, the top bits of n 64-bit keystream words."""
    words = keystream(subkey, 8 * n, use).view("<u8")
    return (words >> np.uint64(11)).astype(np.float64) * 2.0**-53
