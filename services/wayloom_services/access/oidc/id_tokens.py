"""ID tokens: verification by OpenID Connect Core 1.0, section 3.1.3.7, and what they tell of a user."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from authlib.oidc.core import CodeIDToken
from joserfc import jwt
from joserfc.jwk import KeySet

from wayloom.config.roles import Role

ALGORITHMS: Final = ("RS256", "ES256")
LEEWAY_S: Final = 30
"""By how much the provider's clock may differ from ours."""
LONGEST: Final = 32_768
RANKS: Final = (Role.ADMIN, Role.OPERATOR, Role.VIEWER)
"""Of several roles the first of these counts."""


def key_set(document: Mapping[str, Any]) -> KeySet:
    """The keys of a JWKS that may sign ID tokens; others, of unknown kinds, are left out. Raises JoseError, ValueError."""
    keys = document.get("keys")
    if not isinstance(keys, list):
        raise ValueError("a JWKS without keys")
    ours = [key for key in keys if isinstance(key, dict) and key.get("kty") in ("RSA", "EC") and key.get("use", "sig") == "sig"]
    return KeySet.import_key_set({"keys": ours})


def verified(token: str, keys: KeySet, issuer: str, client_id: str, nonce: str, access_token: str | None) -> dict[str, Any]:
    """The claims of an ID token. Raises JoseError (InvalidKeyIdError: no such key), ValueError, TypeError for a bad one."""
    if len(token) > LONGEST:
        raise ValueError("the ID token is too long")
    decoded = jwt.decode(token, keys, list(ALGORITHMS))
    wanted = {
        "iss": {"essential": True, "value": issuer},
        "aud": {"essential": True, "value": client_id},
        "sub": {"essential": True},
    }
    params = {"nonce": nonce, "client_id": client_id, "access_token": access_token}
    claims = CodeIDToken(decoded.claims, decoded.header, wanted, params)
    claims.validate(leeway=LEEWAY_S)
    if not isinstance(claims["sub"], str) or not 0 < len(claims["sub"]) <= 255:
        raise ValueError("`sub` is no text of 1 to 255 letters")
    return dict(claims)


def role_of(claims: Mapping[str, Any], path: str, roles: Mapping[str, Role], default: Role | None) -> Role | None:
    """The highest role that the claim gives, else the default. path: the claim's name; dots lead into objects where no claim has
    the whole as its name (`realm_access.roles`)."""
    given = {roles[value] for value in _values(claims, path) if value in roles}
    return next((role for role in RANKS if role in given), default)


def called(claims: Mapping[str, Any]) -> str:
    """What to call the user."""
    names = (claims.get(name) for name in ("preferred_username", "email", "name", "sub"))
    return next(name for name in names if isinstance(name, str) and name)


def _values(claims: Mapping[str, Any], path: str) -> Sequence[str]:
    found: Any = claims
    for name in [path] if path in claims else path.split("."):
        found = found.get(name) if isinstance(found, Mapping) else None
    found = found if isinstance(found, list) else [found]
    return [value for value in found if isinstance(value, str)]
