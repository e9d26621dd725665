"""Signatures of recordings: somebody vouches for one with a key.

A signature stands in a file of its own beside the recording, so that signing changes nothing in what is signed and
several may sign. What is signed is the recording's closing statement: the head of its hash chain, which covers the
metadata and every record, the number of records and when it was closed.

Invariant: a signature is never taken to be good for a recording that is not sound to its end.
"""

from __future__ import annotations

import base64
import os
from hashlib import sha256
from pathlib import Path
from typing import Any

import orjson
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    PublicFormat,
    load_pem_private_key,
    load_pem_public_key,
)

from nmes.errors import SigningError
from nmes.recording.reader import Recording
from nmes.recording.signed import signature_of

__all__ = ["check_signature", "private_key", "public_key", "sign", "signer"]

_VERSION = "nmes-signature-1"
_LONGEST = 64 << 10  # bytes of a key or a signature that are read


def private_key(path: str | os.PathLike[str]) -> Ed25519PrivateKey:
    """Reads an Ed25519 private key, PEM without a passphrase, as `openssl genpkey -algorithm ed25519` makes it.

    Raises:
        SigningError: It cannot be read, or is something else (`bad_key`).
    """
    try:
        key = load_pem_private_key(_read(path), password=None)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise SigningError("bad_key", f"{path} is no private key in PEM without a passphrase") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise SigningError("bad_key", f"{path} is a key, but none of Ed25519")
    return key


def public_key(path: str | os.PathLike[str]) -> Ed25519PublicKey:
    """Reads an Ed25519 public key, PEM, as `openssl pkey -pubout` makes it.

    Raises:
        SigningError: It cannot be read, or is something else (`bad_key`).
    """
    try:
        key = load_pem_public_key(_read(path))
    except (ValueError, UnsupportedAlgorithm) as error:
        raise SigningError("bad_key", f"{path} is no public key in PEM") from error
    if not isinstance(key, Ed25519PublicKey):
        raise SigningError("bad_key", f"{path} is a key, but none of Ed25519")
    return key


def sign(recording: Recording, key: Ed25519PrivateKey, path: str | os.PathLike[str] | None = None) -> Path:
    """Writes a signature of a recording, by default beside it, and returns its path.

    Raises:
        SigningError: The recording is not sound to its end, or the file exists already or cannot be written.
    """
    statement = _statement(recording)
    target = Path(path) if path is not None else signature_of(recording.path)
    raw = key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)
    document = {
        "signature": base64.b64encode(key.sign(statement)).decode(),
        "public_key": base64.b64encode(raw).decode(),
        "signed": orjson.loads(statement),
    }
    try:
        file = open(target, "xb")
        try:
            with file:
                file.write(orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE))
        except OSError:
            target.unlink()
            raise
    except FileExistsError:
        raise SigningError("signing_failed", f"{target} exists already") from None
    except OSError as error:
        raise SigningError("signing_failed", f"cannot write {target}: {error.strerror}") from error
    return target


def check_signature(recording: Recording, key: Ed25519PublicKey, path: str | os.PathLike[str] | None = None) -> None:
    """Checks that the owner of a key signed this very recording.

    Args:
        recording: The recording, which is read to its end if it was not yet.
        key: The public key that one has from its owner; the one in the signature's file is not looked at.
        path: The signature, by default the file beside the recording.

    Raises:
        SigningError: The owner did not, or the recording is damaged (`bad_signature`).
    """
    path = path if path is not None else signature_of(recording.path)
    signature, _ = _signature(path)
    _verify(recording, key, signature, path)


def signer(recording: Recording) -> str:
    """Returns the key that signed a recording, as the signature beside it says: it did, but whose it is nobody says.

    Returns:
        SHA-256 of the public key's 32 bytes, 64 hexadecimal digits; nothing where there is no signature.

    Raises:
        SigningError: The signature is not that key's of this recording, or the recording is damaged (`bad_signature`).
    """
    path = signature_of(recording.path)
    if not path.is_file():
        return ""
    signature, raw = _signature(path)
    try:
        key = Ed25519PublicKey.from_public_bytes(raw)
    except ValueError as error:
        raise SigningError("bad_signature", f"{path} is no signature") from error
    _verify(recording, key, signature, path)
    return sha256(raw).hexdigest()


def _signature(path: str | os.PathLike[str]) -> tuple[bytes, bytes]:
    """Reads a signature's file: the signature, and the public key that it says made it."""
    try:
        document: Any = orjson.loads(_read(path))
        signature, key = (base64.b64decode(document[name], validate=True) for name in ("signature", "public_key"))
    except (ValueError, KeyError, TypeError) as error:
        raise SigningError("bad_signature", f"{path} is no signature") from error
    return signature, key


def _verify(recording: Recording, key: Ed25519PublicKey, signature: bytes, path: str | os.PathLike[str]) -> None:
    try:
        key.verify(signature, _statement(recording))
    except InvalidSignature:
        raise SigningError(
            "bad_signature", f"{path} is not this key's signature of this recording, as it is now"
        ) from None


def _statement(recording: Recording) -> bytes:
    if recording.damage is not None:
        raise SigningError("bad_signature", f"only a whole recording can be signed: {recording.damage.message}")
    return orjson.dumps({**recording.end, "version": _VERSION}, option=orjson.OPT_SORT_KEYS)


def _read(path: str | os.PathLike[str]) -> bytes:
    try:
        with open(path, "rb") as file:
            return file.read(_LONGEST)
    except OSError as error:
        raise SigningError("signing_failed", f"cannot read {path}: {error.strerror}") from error
