"""What docs/access.md says of tests, secrets and proxies is so."""

import json
import re
from pathlib import Path

import pytest

from wayloom.config.access import AccessSettings
from wayloom.config.service import ServiceSettings
from wayloom_services.access.needs import asked
from wayloom_services.app import create_app

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "access.md").read_text(encoding="utf-8")
COMPOSITION = (ROOT / "docker-compose.yml").read_text(encoding="utf-8")
CADDY = (ROOT / "deploy" / "Caddyfile").read_text(encoding="utf-8")
VEHICLES = (ROOT / "deploy" / "vehicles.caddy.example").read_text(encoding="utf-8")


def test_every_test_that_the_page_names_is_there_and_each_of_the_ten_risks_has_one() -> None:
    rows = re.findall(r"^\| (\d+) .*\| ([^|]*) \|$", PAGE, re.MULTILINE)
    assert [int(number) for number, _ in rows] == list(range(1, 11))
    sources = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py"))
    for number, cell in rows:
        named = re.findall(r"`(test_\w+)`", cell)
        assert named, number
        assert [name for name in named if not re.search(rf"^def {name}\(", sources, re.MULTILINE)] == []


def test_the_settings_that_the_page_names_are_those_of_access() -> None:
    named = re.findall(r"`(?:WAYLOOM_ACCESS__|…__)([A-Z_]+)`", PAGE)
    assert {name.lower() for name in named} == set(AccessSettings.model_fields)


def test_the_composition_has_no_default_secret() -> None:
    """Compose ends with a message where one of them is not set (`:?`), and each is used through its variable."""
    for name in ("WAYLOOM_API_KEY", "POSTGRES_PASSWORD", "S3_SECRET"):
        uses = re.findall(rf"\$\{{{name}([^}}]*)\}}", COMPOSITION)
        assert uses, name
        assert any(use.startswith(":?") for use in uses), name
        assert not [use for use in uses if use.startswith((":-", "-"))], name
    secret = re.compile(r"^\s*\S*(?:PASSWORD|SECRET|API_KEY)\S*:\s*(?!\$\{|\"\$\{)(\S+)", re.MULTILINE)
    assert secret.findall(COMPOSITION) == []
    assert '"${WAYLOOM_PUBLISH:-127.0.0.1:8088}:8088"' in COMPOSITION


def test_the_proxy_is_the_one_that_the_api_trusts_and_leads_to_it_with_tls() -> None:
    trusted = re.findall(r"WAYLOOM_ACCESS__TRUSTED_PROXIES: (\S+)", COMPOSITION)
    proxy = COMPOSITION[COMPOSITION.index("  proxy:\n") :].partition("\n\n")[0]
    assert trusted == re.findall(r"ipv4_address: ([\d.]+)", proxy)
    assert "profiles: [tls]" in proxy
    for site in (CADDY, VEHICLES):
        code = "\n".join(line for line in site.splitlines() if not line.startswith("#"))
        assert code.count("{") - code.count("}") == 0
        assert "reverse_proxy api:8088" in code
        assert "http://" not in code
        assert "header_up" not in code  # Caddy's own X-Forwarded headers, and the Host as it came
    assert "mode require_and_verify" in VEHICLES


@pytest.mark.parametrize("path", ["/v1/drives", "/v1/drives/x/track", "/v1/uploads", "/v1/uploads/x", "/v1/events", "/v1/info"])
def test_vehicles_with_certificates_reach_what_they_need(path: str) -> None:
    (said,) = re.findall(r"@sending path (.*)", VEHICLES)
    patterns = [re.escape(one).replace(r"\*", ".*") for one in said.split()]
    assert [one for one in patterns if re.fullmatch(one, path)]
    assert not [one for one in patterns if re.fullmatch(one, "/v1/keys") or re.fullmatch(one, "/v1/maps/city")]
    assert asked("GET", path) or asked("POST", path) or asked("PATCH", path)


def test_no_route_takes_an_address_to_fetch(tmp_path: Path) -> None:
    """No parameter and no field of a body is called, or has the format of, an address."""
    document = create_app(ServiceSettings(data_dir=tmp_path)).openapi()
    named = [
        parameter
        for operations in document["paths"].values()
        for operation in operations.values()
        for parameter in operation.get("parameters", [])
    ]
    assert len(named) > 100
    bodies = [
        json.dumps(operation["requestBody"]) for operations in document["paths"].values() for operation in operations.values()
        if "requestBody" in operation
    ]  # fmt: skip
    used = {name for body in bodies for name in re.findall(r"#/components/schemas/(\w+)", body)}
    fields = [field for name in used for field in document["components"]["schemas"][name].get("properties", {})]
    assert {"password", "vehicle_id", "why"} <= set(fields)
    suspicious = re.compile(r"(^|_)(url|uri|href|address|callback|webhook|host|endpoint)(_|$)", re.IGNORECASE)
    assert [one["name"] for one in named if suspicious.search(one["name"])] == []
    assert [one for one in fields if suspicious.search(one)] == []
    assert '"format": "uri"' not in json.dumps([*named, *bodies])
