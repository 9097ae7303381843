"""Answers under seal: a salted hash that is published first, and a box that only the trial's seed opens.

The hash commits: a key cannot be changed afterwards without notice. The box lets an interrupted trial go on without
the answers lying about in the clear. Its secret is the seed, which the diagnosing processes are not given; it keeps
an honest program from seeing answers by accident and is no protection against an attacker.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

SALT_BYTES = 16
BLOCK = 32  # bytes of SHA-256


class BrokenSealError(RuntimeError):
    """An answer is not the one that was sealed."""


@dataclass(frozen=True)
class Seal:
    """What is published (`commitment`), and what is kept closed until the end."""

    commitment: str  # SHA-256 of salt and key, hexadecimal
    box: bytes


def canonical(key: Mapping[str, Any]) -> bytes:
    """Return the one text that stands for `key`."""
    return json.dumps(key, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def commitment(salt: bytes, text: bytes) -> str:
    """Return the salted hash of a key's text."""
    return hashlib.sha256(salt + text).hexdigest()


def secret_of(seed: int, trial: str) -> bytes:
    """Return the secret of a trial, slow to guess."""
    return hashlib.scrypt(str(seed).encode(), salt=trial.encode(), n=2**14, r=8, p=1, dklen=BLOCK)


def seal(key: Mapping[str, Any], secret: bytes, name: str) -> Seal:
    """Close `key` of the case `name` with a new salt."""
    salt, text = secrets.token_bytes(SALT_BYTES), canonical(key)
    return Seal(commitment(salt, text), _crypt(salt + text, secret, name))


def unseal(closed: Seal, secret: bytes, name: str) -> tuple[str, dict[str, Any]]:
    """Return the salt (hexadecimal) and the key, verified against what was published.

    Raises
    ------
    BrokenSealError
        If the box or the commitment was changed, or the secret is another.
    """
    opened = _crypt(closed.box, secret, name)
    salt, text = opened[:SALT_BYTES], opened[SALT_BYTES:]
    if commitment(salt, text) != closed.commitment:
        raise BrokenSealError(f"{name}: the answer is not the one that was sealed (published {closed.commitment}); "
                              "seed, seal or answer was changed")
    key = json.loads(text)
    return salt.hex(), key


def verify(salt: str, key: Mapping[str, Any], published: str) -> None:
    """Check an opened key against its published hash, as anybody can.

    Raises
    ------
    BrokenSealError
        If they do not belong together.
    """
    if commitment(bytes.fromhex(salt), canonical(key)) != published:
        raise BrokenSealError(f"the key does not have the published hash {published}")


def _crypt(text: bytes, secret: bytes, name: str) -> bytes:
    own = hashlib.sha256(secret + name.encode()).digest()
    blocks = (hashlib.sha256(own + k.to_bytes(8, "big")).digest() for k in range(len(text) // BLOCK + 1))
    return bytes(a ^ b for a, b in zip(text, b"".join(blocks), strict=False))
