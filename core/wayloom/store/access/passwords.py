"""Passwords: argon2id by RFC 9106's second recommended option (64 MiB of memory, 3 passes)."""

from typing import Final

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from wayloom.errors import ConfigError

LEAST_LETTERS: Final = 12
MOST_LETTERS: Final = 256
_HASHER: Final = PasswordHasher(time_cost=3, memory_cost=64 * 1024, parallelism=1)
_KIND: Final = "$argon2"
_OF_NOBODY: Final = "$argon2id$v=19$m=65536,t=3,p=1$lg4SE51VuDcVhE1BxJLSVg$ImBK6OBVuRfD+fKR8YeSmt8B5TILUUTnwoiIOjc2mUI"
"""What is verified where there is no user of a name, so that the time does not tell: the hash of a word, by `_HASHER`'s parameters.
Written down: to make it would take each start of the API as long as a sign-in."""


def password_hash(password: str) -> str:
    """The hash that is kept. Raises ConfigError for a password that is too short or too long."""
    if not LEAST_LETTERS <= len(password) <= MOST_LETTERS:
        raise ConfigError(f"a password has {LEAST_LETTERS} to {MOST_LETTERS} letters", remedy="choose a few words")
    return _HASHER.hash(password)


def is_right(password: str, kept: str | None) -> bool:
    """Whether the password is that of the hash; of None, and of what is no hash of a password, never, after as much work."""
    known = kept if kept is not None and kept.startswith(_KIND) else None
    try:
        return _HASHER.verify(known or _OF_NOBODY, password) and known is not None
    except (VerificationError, InvalidHashError, UnicodeEncodeError):
        return False
