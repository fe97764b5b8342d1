"""OpenID provider as this service asks it: discovery document and keys, held for a while, and codes changed for ID tokens."""

import json
import ssl
import time
from collections.abc import Mapping
from typing import Any, Final
from urllib.parse import quote, urlencode

import anyio
import httpx2
import structlog
from authlib.oauth2.rfc7636 import create_s256_code_challenge
from joserfc.errors import InvalidKeyIdError, JoseError
from joserfc.jwk import KeySet

from wayloom.config.access import AccessSettings, is_safe_address
from wayloom.config.roles import Role
from wayloom_services.access.oidc.id_tokens import called, key_set, role_of, verified
from wayloom_services.access.oidc.pending import Pending, begun, key_of, opened, sealed
from wayloom_services.errors import ProtocolError

log = structlog.get_logger()
HELD_S: Final = 3600.0
"""How long discovery document and keys are held; a token of a key that is not among them has the keys fetched anew."""
LONGEST_ANSWER: Final = 1 << 20
ENDPOINTS: Final = ("authorization_endpoint", "token_endpoint", "jwks_uri")


class Provider:
    """The provider that the settings name. To be used in one event loop."""

    def __init__(self, settings: AccessSettings) -> None:
        """Raises ConfigError where the client's secret cannot be read."""
        assert settings.oidc_issuer is not None
        assert settings.oidc_client_id is not None
        self.settings, self.issuer, self.client_id = settings, settings.oidc_issuer, settings.oidc_client_id
        self._secret = settings.client_secret()
        self._cookie_key = key_of(self._secret)
        self._tls = ssl.create_default_context()
        self._document: tuple[float, Mapping[str, Any]] | None = None
        self._keys: tuple[float, KeySet] | None = None

    async def begin(self, wanted: str, back: str) -> tuple[str, str]:
        """Where the browser goes to sign in, and what its cookie holds meanwhile. Raises ProtocolError (503).

        wanted : path of this service to go to at the end; back: the address at which the browser returns
        """
        pending = begun(wanted)
        return await self._address(pending, back), sealed(pending, self._cookie_key)

    def pending(self, cookie: str | None) -> Pending | None:
        """The sign-in that a cookie holds; None of none, of one that is not ours and of one that is too old."""
        return opened(cookie, self._cookie_key)

    async def _address(self, pending: Pending, back: str) -> str:
        query = {
            "response_type": "code", "client_id": self.client_id, "redirect_uri": back, "scope": self.settings.oidc_scope,
            "state": pending.state, "nonce": pending.nonce, "code_challenge": create_s256_code_challenge(pending.verifier),
            "code_challenge_method": "S256",
        }  # fmt: skip
        address = str((await self._discovered())["authorization_endpoint"])
        return f"{address}{'&' if '?' in address else '?'}{urlencode(query)}"

    async def claims(self, code: str, pending: Pending, back: str) -> dict[str, Any]:
        """The claims of the ID token that a code is changed for. Raises ProtocolError: 403 where the code or the token is not good,
        503 where the provider does not answer as it should."""
        tokens = await self._tokens(code, pending, back)
        token, access = tokens.get("id_token"), tokens.get("access_token")
        if not isinstance(token, str):
            raise self._away("no ID token in the answer of the token endpoint")
        access_token = access if isinstance(access, str) else None
        try:
            try:
                return self._verified(token, await self._key_set(HELD_S), pending, access_token)
            except InvalidKeyIdError:  # the provider signs with a new key
                return self._verified(token, await self._key_set(0.0), pending, access_token)
        except (JoseError, ValueError, TypeError) as error:
            log.warning("an ID token was refused", why=f"{type(error).__name__}: {error}"[:200])
            raise ProtocolError(
                403, "wrong-token", "the provider's ID token is not good for a sign-in here; the log says why"
            ) from None

    def role(self, claims: Mapping[str, Any]) -> Role | None:
        """The role that an ID token's claims give by the settings."""
        return role_of(claims, self.settings.oidc_role_claim, self.settings.role_of_claim, self.settings.oidc_default_role)

    def called(self, claims: Mapping[str, Any]) -> str:
        """What the provider calls a user."""
        return called(claims)

    def _verified(self, token: str, keys: KeySet, pending: Pending, access_token: str | None) -> dict[str, Any]:
        return verified(token, keys, self.issuer, self.client_id, pending.nonce, access_token)

    async def _tokens(self, code: str, pending: Pending, back: str) -> Mapping[str, Any]:
        """What the token endpoint answers to a code (RFC 6749, section 4.1.3; RFC 7636, section 4.5)."""
        document = await self._discovered()
        form = {"grant_type": "authorization_code", "code": code, "redirect_uri": back, "code_verifier": pending.verifier}
        headers = {"Accept": "application/json"}
        methods = document.get("token_endpoint_auth_methods_supported", ["client_secret_basic"])
        if "client_secret_basic" in methods:
            told = httpx2.BasicAuth(quote(self.client_id, safe=""), quote(self._secret, safe=""))
            status, answer = await self._ask("POST", document["token_endpoint"], data=form, headers=headers, auth=told)
        else:
            form |= {"client_id": self.client_id, "client_secret": self._secret}
            status, answer = await self._ask("POST", document["token_endpoint"], data=form, headers=headers)
        if status == 400 and answer.get("error") == "invalid_grant":
            raise ProtocolError(403, "wrong-code", "the provider does not know this sign-in, or knows it no more: begin anew")
        if status != 200:
            raise self._away(f"the token endpoint answers {status} {str(answer.get('error'))[:80]!r}")
        return answer

    async def _discovered(self) -> Mapping[str, Any]:
        """The discovery document (OpenID Connect Discovery 1.0, section 4)."""
        if self._document is not None and time.monotonic() - self._document[0] < HELD_S:
            return self._document[1]
        status, document = await self._ask("GET", f"{self.issuer.rstrip('/')}/.well-known/openid-configuration")
        if status != 200 or document.get("issuer") != self.issuer:
            raise self._away(f"the discovery document has status {status} and issuer {str(document.get('issuer'))[:200]!r}")
        if not all(is_safe_address(str(document.get(name))) for name in ENDPOINTS):
            raise self._away("the discovery document lacks an endpoint, or has one without TLS")
        self._document = (time.monotonic(), document)
        return document

    async def _key_set(self, at_most_s: float) -> KeySet:
        """The provider's keys, no older than so many seconds."""
        if self._keys is not None and time.monotonic() - self._keys[0] < at_most_s:
            return self._keys[1]
        status, document = await self._ask("GET", str((await self._discovered())["jwks_uri"]))
        try:
            if status != 200:
                raise ValueError(f"status {status}")
            keys = key_set(document)
        except (JoseError, ValueError, TypeError) as error:
            raise self._away(f"no keys: {error}") from None
        self._keys = (time.monotonic(), keys)
        return keys

    async def _ask(self, method: str, address: str, **more: Any) -> tuple[int, Mapping[str, Any]]:
        """Status and JSON object of an answer, within the time limit; redirects are not followed. Raises ProtocolError (503)."""
        try:
            with anyio.fail_after(self.settings.oidc_timeout_s):
                client = httpx2.AsyncClient(timeout=self.settings.oidc_timeout_s, trust_env=False, verify=self._tls)
                async with client, client.stream(method, address, **more) as answer:
                    body = bytearray()
                    async for piece in answer.aiter_bytes():
                        body += piece
                        if len(body) > LONGEST_ANSWER:
                            raise ValueError("the answer is too long")
            found = json.loads(bytes(body))
        except (httpx2.HTTPError, httpx2.InvalidURL, TimeoutError, OSError, ValueError, RecursionError) as error:
            raise self._away(f"{method} {address}: {type(error).__name__} {error}"[:300]) from None
        return answer.status_code, found if isinstance(found, dict) else {}

    def _away(self, why: str) -> ProtocolError:
        log.warning("the OpenID provider does not answer as it should", issuer=self.issuer, why=why)
        said = "the OpenID provider does not answer as it should: try again; the log says why"
        return ProtocolError(503, "away", said, {"Retry-After": "5"})
