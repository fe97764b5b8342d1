"""Random secrets and their hashes.

A key or session token holds 256 random bits. Nobody guesses these, however fast the hash is, so it is SHA-256, which costs a
microsecond a request; what people choose as passwords can be guessed, and gets argon2id (`passwords`).
"""

import hashlib
import hmac
import secrets
from typing import Final

KIND: Final = "wlk"
"""How every key begins, so that scanners find keys in places where they do not belong."""
PREFIX_BYTES: Final = 6
SECRET_BYTES: Final = 32
NO_SECRET: Final = "0" * 64
"""The hash of nothing: what a key that is not there is compared with."""


def new_prefix() -> str:
    """A key's public part, 12 hexadecimal digits."""
    return secrets.token_hex(PREFIX_BYTES)


def new_token() -> str:
    """256 random bits in letters that headers and cookies take."""
    return secrets.token_urlsafe(SECRET_BYTES)


def key_text(prefix: str, secret: str) -> str:
    """A key as its owner gets it, once."""
    return f"{KIND}_{prefix}_{secret}"


def prefix_of(key: str) -> str | None:
    """The public part of what may be a key; None of what is none."""
    kind, _, rest = key.partition("_")
    prefix, _, secret = rest.partition("_")
    ascii_only = key.isascii() and len(key) < 200
    return prefix if ascii_only and kind == KIND and len(prefix) == 2 * PREFIX_BYTES and secret else None


def hash_of(token: str) -> str:
    """SHA-256 of a key or token, in hexadecimal."""
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()


def is_same(one: str, other: str) -> bool:
    """Whether two texts are equal, in a time that does not say where they differ."""
    return hmac.compare_digest(one.encode("utf-8", "surrogatepass"), other.encode("utf-8", "surrogatepass"))
