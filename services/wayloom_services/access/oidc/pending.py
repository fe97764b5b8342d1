"""Sign-ins on their way to the provider and back, in a cookie that this service has signed: no process has to remember them.

The cookie is `SameSite=Lax`, because the provider's site leads the browser back; the session's own, which is `Strict`, is not sent
on that way. It binds `state`, `nonce` and the PKCE verifier to the browser that asked.
"""

import hashlib
import secrets
import time
from dataclasses import asdict, dataclass
from typing import Final

from joserfc import jwt
from joserfc.errors import JoseError
from joserfc.jwk import OctKey

LASTS_S: Final = 600
"""How long somebody may take at the provider."""
ALGORITHM: Final = "HS256"
LONGEST_NEXT: Final = 512


@dataclass(frozen=True, slots=True)
class Pending:
    """A sign-in that has begun. next: path of this service to go to at its end."""

    state: str
    nonce: str
    verifier: str
    next: str


def begun(wanted: str) -> Pending:
    """A sign-in that begins now."""
    state, nonce, verifier = (secrets.token_urlsafe(32) for _ in range(3))
    return Pending(state, nonce, verifier, own_path(wanted))


def own_path(wanted: str) -> str:
    """The path where it is one of this service, else `/`. Browsers read `//host`, `/\\host` and tabs within as other hosts."""
    sound = wanted.startswith("/") and not wanted.startswith("//") and len(wanted) <= LONGEST_NEXT
    return wanted if sound and "\\" not in wanted and all("!" <= letter <= "~" for letter in wanted) else "/"


def key_of(client_secret: str) -> OctKey:
    """The key of these cookies, the same in every process; not the secret itself, which may sign other things."""
    return OctKey.import_key(hashlib.sha256(b"wayloom sign-ins on their way\0" + client_secret.encode()).digest())


def sealed(pending: Pending, key: OctKey) -> str:
    """The cookie's text."""
    return jwt.encode({"alg": ALGORITHM}, {**asdict(pending), "exp": int(time.time()) + LASTS_S}, key, [ALGORITHM])


def opened(text: str | None, key: OctKey) -> Pending | None:
    """What a cookie holds; None of none, of one that is not ours and of one that is too old."""
    if not text:
        return None
    try:
        claims = jwt.decode(text, key, [ALGORITHM]).claims
        jwt.JWTClaimsRegistry(exp={"essential": True}).validate(claims)
        return Pending(*(str(claims[name]) for name in ("state", "nonce", "verifier", "next")))
    except (JoseError, ValueError, KeyError):
        return None
