"""Settings of access control: who must say who it is, how long that lasts, and how much anybody may ask for."""

import ipaddress
from collections.abc import Mapping
from pathlib import Path
from typing import Self
from urllib.parse import urlsplit

from pydantic import Field, field_validator, model_validator

from wayloom.config.roles import Role
from wayloom.config.settings import Settings
from wayloom.errors import ConfigError

DAY_S = 86400.0


class AccessSettings(Settings):
    """Keys, sessions, quotas of vehicles, rates of requests. Without a key and without `required` none of it applies."""

    required: bool = Field(False, description="want a key or a sign-in of every request, also where there is no api_key")
    trusted_proxies: str = Field(
        "127.0.0.1", description="addresses or networks, comma-separated, whose X-Forwarded-For and -Proto are believed"
    )
    session_s: float = Field(12 * 3600.0, gt=0, le=30 * DAY_S, description="seconds after which a sign-in has ended")
    held_s: float = Field(
        10.0, ge=0, le=300, description="seconds for which a process goes on with a key or session that another has revoked"
    )
    rotation_grace_s: float = Field(DAY_S, ge=0, description="seconds for which a key's secret before its rotation is still taken")

    drives_a_day: int = Field(200, ge=1, description="most drives that a vehicle may announce within 24 hours")
    bytes_a_day: int = Field(2 * 2**40, ge=1, description="most bytes of drives that a vehicle may announce within 24 hours")
    open_bytes: int = Field(2**40, ge=1, description="most bytes that a vehicle may have announced and not sent yet")
    requests_a_second: float = Field(1000.0, gt=0, description="of one key or user, by one process of the API, in the long run")
    requests_at_once: int = Field(10_000, ge=1, description="of one key or user, before that rate counts")
    strangers_a_second: float = Field(20.0, gt=0, description="requests of one address without a key that is known")
    strangers_at_once: int = Field(200, ge=1, description="likewise, before that rate counts")

    oidc_issuer: str | None = Field(
        None, description="address of the OpenID provider that signs operators in, as its tokens name it"
    )
    oidc_client_id: str | None = Field(None, min_length=1, description="what the provider calls this service")
    oidc_client_secret: str | None = Field(None, min_length=8, repr=False, description="the secret that the provider gave it")
    oidc_client_secret_file: Path | None = Field(None, description="file that holds the secret, instead of it")
    oidc_scope: str = Field("openid profile email", description="what the provider is asked for, `openid` among it")
    oidc_role_claim: str = Field(
        "roles", min_length=1, description="claim of the ID token that tells roles; dots lead into objects"
    )
    oidc_roles: tuple[str, ...] = Field((), description="values of that claim and their roles, `map-admins=admin,map-ops=operator`")
    oidc_default_role: Role | None = Field(None, description="role of whom the claim gives none; without it they stay out")
    oidc_label: str = Field("Sign in with single sign-on", min_length=1, max_length=80, description="what the button says")
    oidc_timeout_s: float = Field(5.0, gt=0, le=60, description="seconds in which the provider has to answer each request")

    @field_validator("oidc_issuer")
    @classmethod
    def _issuer(cls, value: str | None) -> str | None:
        if value is not None and not is_safe_address(value):
            raise ValueError("is no https:// address; http:// is for providers on this machine alone")
        return value

    @field_validator("oidc_scope")
    @classmethod
    def _scope(cls, value: str) -> str:
        if "openid" not in value.split():
            raise ValueError("lacks `openid`")
        return value

    @field_validator("oidc_roles")
    @classmethod
    def _roles(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        """Without blanks around values and roles."""
        pairs = [(claimed.strip(), role.strip()) for claimed, _, role in (one.rpartition("=") for one in value)]
        for one, (claimed, role) in zip(value, pairs, strict=True):
            _check_role(role, one)
            if not claimed:
                raise ValueError(f"{one!r} names no value of the claim: write VALUE=ROLE")
        return tuple(f"{claimed}={role}" for claimed, role in pairs)

    @field_validator("oidc_default_role")
    @classmethod
    def _default_role(cls, value: Role | None) -> Role | None:
        if value is not None:
            _check_role(value, value)
        return value

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.oidc_issuer is None:
            return self
        if self.oidc_client_id is None:
            raise ValueError("oidc_issuer wants oidc_client_id too")
        if (self.oidc_client_secret is None) == (self.oidc_client_secret_file is None):
            raise ValueError("oidc_issuer wants either oidc_client_secret or oidc_client_secret_file")
        if not self.oidc_roles and self.oidc_default_role is None:
            raise ValueError("oidc_issuer wants oidc_roles or oidc_default_role: nobody could sign in")
        return self

    @property
    def role_of_claim(self) -> Mapping[str, Role]:
        """Role by the claim's value."""
        return {claimed: Role(role) for claimed, _, role in (one.rpartition("=") for one in self.oidc_roles)}

    def client_secret(self) -> str:
        """The secret that the provider gave. Raises ConfigError where its file cannot be read or is empty."""
        if self.oidc_client_secret_file is None:
            return self.oidc_client_secret or ""
        try:
            secret = self.oidc_client_secret_file.read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"cannot be read ({error})", file=self.oidc_client_secret_file) from None
        if len(secret) < 8:
            raise ConfigError("holds no secret of 8 letters or more", file=self.oidc_client_secret_file)
        return secret


def is_safe_address(address: str) -> bool:
    """Whether what is sent to an address is encrypted or stays on this machine."""
    try:
        parts = urlsplit(address)
        name = parts.hostname or ""
        parts.port  # noqa: B018  raises for a port that is none
    except ValueError:
        return False
    if parts.scheme == "https":
        return bool(name)
    return parts.scheme == "http" and (name == "localhost" or _is_loopback(name))


def _is_loopback(name: str) -> bool:
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


def _check_role(role: str, given: str) -> None:
    if role not in (Role.VIEWER, Role.OPERATOR, Role.ADMIN):
        raise ValueError(f"{given!r} gives no role of a person: viewer, operator, admin")
