"""Settings of the sign-in by an OpenID provider: what is refused at the start rather than at somebody's sign-in."""

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from wayloom.config.access import AccessSettings, is_safe_address
from wayloom.config.roles import Role
from wayloom.config.service import ServiceSettings
from wayloom.errors import ConfigError

WHOLE = {
    "oidc_issuer": "https://sso.example",
    "oidc_client_id": "x",
    "oidc_client_secret": "x" * 8,
    "oidc_roles": ("a=b=admin", "c=viewer"),
}


def test_whole_settings_are_taken_and_ask_for_access() -> None:
    access = AccessSettings(**WHOLE)  # type: ignore[arg-type]
    assert access.role_of_claim == {"a=b": Role.ADMIN, "c": Role.VIEWER}
    assert access.client_secret() == "x" * 8
    assert "x" * 8 not in repr(access)
    assert ServiceSettings(access=access).is_closed
    assert not ServiceSettings().is_closed


@pytest.mark.parametrize("given", ["map-admins = admin", " map-admins=admin ", "map-admins\t= admin"])
def test_blanks_around_values_and_roles_are_no_part_of_them(given: str) -> None:
    access = AccessSettings(**{**WHOLE, "oidc_roles": (given,)})  # type: ignore[arg-type]
    assert access.role_of_claim == {"map-admins": Role.ADMIN}


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"oidc_client_id": None}, "oidc_client_id"), ({"oidc_client_secret": None}, "either"),
        ({"oidc_client_secret_file": Path("x")}, "either"), ({"oidc_roles": ()}, "nobody could sign in"),
        ({"oidc_roles": ("a=vehicle",)}, "no role of a person"), ({"oidc_roles": ("admin",)}, "VALUE=ROLE"),
        ({"oidc_roles": ("a = boss",)}, "'a = boss' gives no role of a person"), ({"oidc_roles": (" = admin",)}, "VALUE=ROLE"),
        ({"oidc_default_role": "vehicle"}, "no role of a person"), ({"oidc_scope": "profile"}, "openid"),
        ({"oidc_issuer": "http://sso.example"}, "https"), ({"oidc_issuer": "sso.example"}, "https"),
    ],
    ids=str,
)  # fmt: skip
def test_what_nobody_could_sign_in_with_is_refused(changed: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        AccessSettings(**{**WHOLE, **changed})


def test_a_secret_is_read_from_its_file_and_an_unreadable_one_is_said(tmp_path: Path) -> None:
    access = AccessSettings(**{**WHOLE, "oidc_client_secret": None, "oidc_client_secret_file": tmp_path / "secret"})  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="cannot be read"):
        access.client_secret()
    (tmp_path / "secret").write_text("short\n")
    with pytest.raises(ConfigError, match="no secret"):
        access.client_secret()
    (tmp_path / "secret").write_text("long enough\n")
    assert access.client_secret() == "long enough"


@pytest.mark.parametrize(
    ("address", "is_safe"),
    [
        ("https://sso.example:8443/x", True), ("http://localhost:1/x", True), ("http://127.0.0.1/", True), ("http://[::1]/", True),
        ("http://localhost.evil.example/", False), ("http://10.0.0.1/", False), ("https://", False), ("https://x:port/", False),
        ("file:///etc/passwd", False), ("None", False),
    ],
)  # fmt: skip
def test_an_address_is_safe_by_tls_or_by_being_on_this_machine(address: str, is_safe: bool) -> None:
    assert is_safe_address(address) is is_safe
