"""A small OpenID provider on this machine: discovery, authorisation with PKCE, codes that are good once, signed ID tokens, keys.

It answers as told: claims can be added, changed and left out, tokens signed otherwise, and it can be away.
"""

import base64
import hashlib
import json
import secrets
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import parse_qsl, quote, urlencode

import uvicorn
from joserfc import jwt
from joserfc.jwk import ECKey, KeySet, OctKey, RSAKey
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, RedirectResponse, Response
from starlette.routing import Route

CLIENT_ID, CLIENT_SECRET = "wayloom-of-a-test", "a secret: of+the/test & its client"
NOT_ANSWERED = object()
"""A claim of this value is left out."""
Signer = RSAKey | ECKey | OctKey


@dataclass
class OpenIdProvider:
    """Who signs in is `user`; `changed` replaces claims of the next tokens, `signer` and `algorithm` sign them."""

    issuer: str
    user: dict[str, Any] = field(default_factory=lambda: {"sub": "248289761001", "preferred_username": "Anna.B@example.org"})
    changed: dict[str, Any] = field(default_factory=dict)
    keys: list[RSAKey | ECKey] = field(default_factory=lambda: [RSAKey.generate_key(2048, {"kid": "first"})])
    signer: Signer | None = None
    algorithm: str = "RS256"
    is_away: bool = False
    denies: bool = False
    auth_methods: list[str] = field(default_factory=lambda: ["client_secret_basic"])
    codes: dict[str, dict[str, str]] = field(default_factory=dict)

    def reset(self) -> None:
        """As at the start, with the keys that it has."""
        fresh = OpenIdProvider(self.issuer, keys=self.keys)
        self.__dict__.update({name: value for name, value in fresh.__dict__.items() if name != "codes"})

    def discovery(self, _: Request) -> Response:
        at = {
            name: f"{self.issuer}/{path}" for name, path in (("authorization_endpoint", "authorize"), ("token_endpoint", "token"))
        }
        return self._answer({"issuer": self.issuer, **at, "jwks_uri": f"{self.issuer}/jwks"} | self._methods())

    def jwks(self, _: Request) -> Response:
        others = [{"kty": "unknown", "kid": "of another kind"}, {**RSAKey.generate_key(2048).as_dict(private=False), "use": "enc"}]
        return self._answer({"keys": [*KeySet(list(self.keys)).as_dict(private=False)["keys"], *others]})

    def authorize(self, request: Request) -> Response:
        """Sign the user in without asking: at once, or, in a browser, behind a link."""
        asked = dict(request.query_params)
        wanted = {"response_type": "code", "client_id": CLIENT_ID, "code_challenge_method": "S256"}
        good = wanted.items() <= asked.items() and "openid" in asked["scope"].split() and len(asked["code_challenge"]) == 43
        if not good or len(asked["state"]) < 32 or len(asked["nonce"]) < 32:
            return Response("no request of a careful client", 400)
        code = secrets.token_urlsafe(16)
        self.codes[code] = asked
        said = {"error": "access_denied"} if self.denies else {"code": code}
        back = f"{asked['redirect_uri']}?{urlencode({**said, 'state': asked['state'], 'iss': self.issuer})}"
        if "text/html" in request.headers["accept"]:
            return HTMLResponse(f'<a id="continue" href="{back.replace("&", "&amp;")}">Continue</a>')
        return RedirectResponse(back, 302)

    async def token(self, request: Request) -> Response:
        form = dict(parse_qsl((await request.body()).decode()))
        if not self._is_client(request, form):
            return JSONResponse({"error": "invalid_client"}, 401)
        asked = self.codes.pop(form["code"], None)
        challenge = _base64url(hashlib.sha256(form["code_verifier"].encode()).digest())
        if asked is None or asked["redirect_uri"] != form["redirect_uri"] or asked["code_challenge"] != challenge:
            return JSONResponse({"error": "invalid_grant"}, 400)
        return self._answer({"access_token": "for nothing", "token_type": "Bearer", "id_token": self.id_token(asked["nonce"])})

    def id_token(self, nonce: str) -> str:
        """A token as told."""
        now = int(time.time())
        claims = {"iss": self.issuer, "aud": CLIENT_ID, "nonce": nonce, "iat": now, "exp": now + 60, **self.user, **self.changed}
        claims = {name: value for name, value in claims.items() if value is not NOT_ANSWERED}
        if self.algorithm == "none":
            return ".".join(_base64url(json.dumps(part).encode()) for part in ({"alg": "none", "typ": "JWT"}, claims)) + "."
        signer = self.signer or self.keys[-1]
        header = {"alg": self.algorithm, **({"kid": signer.kid} if signer.kid else {})}
        return jwt.encode(header, claims, signer, [self.algorithm])

    def _is_client(self, request: Request, form: dict[str, str]) -> bool:
        if "client_secret_basic" in self.auth_methods:
            told = base64.b64decode(request.headers["authorization"].removeprefix("Basic ")).decode()
            return told == ":".join(quote(text, safe="") for text in (CLIENT_ID, CLIENT_SECRET))
        return (form.get("client_id"), form.get("client_secret")) == (CLIENT_ID, CLIENT_SECRET)

    def _methods(self) -> dict[str, Any]:
        return {"token_endpoint_auth_methods_supported": self.auth_methods}

    def _answer(self, body: dict[str, Any]) -> Response:
        return Response("<h1>away</h1>", 503) if self.is_away else JSONResponse(body)


def _base64url(content: bytes) -> str:
    return base64.urlsafe_b64encode(content).rstrip(b"=").decode()


@contextmanager
def openid_provider() -> Iterator[OpenIdProvider]:
    """The provider under uvicorn, at `localhost`: another site than `127.0.0.1`, where the service is."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        provider = OpenIdProvider(f"http://localhost:{listener.getsockname()[1]}")
        routes = [
            Route("/.well-known/openid-configuration", provider.discovery), Route("/jwks", provider.jwks),
            Route("/authorize", provider.authorize), Route("/token", provider.token, methods=["POST"]),
        ]  # fmt: skip
        server = uvicorn.Server(uvicorn.Config(Starlette(routes=routes), log_level="error", lifespan="off"))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            yield provider
        finally:
            server.should_exit = True
            thread.join(10)
