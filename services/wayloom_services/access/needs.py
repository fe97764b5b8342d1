"""Table of every route and the right that it needs. A route that is not in it is not answered."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from starlette.routing import compile_path

from wayloom.config.roles import Right


class Open(StrEnum):
    """Needs of routes that want no right: of everybody, or of everybody who is known."""

    TO_ALL = "to all"
    TO_KNOWN = "to known callers"


Need = Right | Open
FOLLOW, SEND, READ, OPERATE, MANAGE = Right.FOLLOW, Right.SEND, Right.READ, Right.OPERATE, Right.MANAGE
STATIC: Final = "/static/"
SESSION: Final = "/v1/session"
OIDC: Final = f"{SESSION}/oidc"
OIDC_CALLBACK: Final = f"{OIDC}/callback"
MAP, VERSION = "/v1/maps/{map_id}", "/v1/maps/{map_id}/versions/{number}"
DRIVE, UPLOAD = "/v1/drives/{drive_id}", "/v1/uploads/{upload_id}"

OF_BOTH: Final = (
    "/tiles/{layer}/{z}/{x}/{y}@2x.{ext}", "/tiles/{layer}/{z}/{x}/{y}.{ext}", "/tiles/{layer}/tilejson.json", "/wmts.xml",
    "/style.json", "/3dtiles/tileset.json", "/3dtiles/{overlay}/tileset.json", "/changes", "/ogc", "/ogc/conformance",
    "/ogc/collections", "/ogc/collections/{name}", "/ogc/collections/{name}/items", "/ogc/collections/{name}/items/{feature_id}",
    "",
)  # fmt: skip
"""What there is of a map's newest version and of each that is kept, below either's path."""

NEEDS: Final[Mapping[str, Mapping[str, Need]]] = {
    **{f"{base}{path}": {"GET": READ} for base in (MAP, VERSION) for path in OF_BOTH},
    "/v1/maps": {"GET": READ},
    f"{MAP}/versions": {"GET": READ},
    f"{MAP}/coverage": {"GET": READ},
    f"{MAP}/jobs": {"GET": READ},
    f"{MAP}/submaps": {"GET": READ},
    f"{MAP}/tracks": {"GET": READ},
    f"{MAP}/diff/{{base}}/{{number}}": {"GET": READ},
    f"{MAP}/diff/{{base}}/{{number}}/regions": {"GET": READ},
    f"{MAP}/sync": {"POST": READ},
    f"{VERSION}/markings": {"GET": READ},
    f"{VERSION}/lineage": {"GET": READ},
    f"{VERSION}/regions": {"GET": READ},
    f"{VERSION}/regions/{{east}}/{{north}}/{{part}}": {"GET": READ},
    "/v1/submaps/{digest}": {"GET": READ},
    "/v1/rigs": {"GET": READ},
    "/v1/rigs/{key}": {"GET": READ},
    "/v1/rigs/{key}/RIG.toml": {"GET": READ},
    "/v1/rigs/{key}/versions/{number}/RIG.toml": {"GET": READ},
    "/v1/drives": {"GET": FOLLOW, "POST": SEND},
    DRIVE: {"GET": FOLLOW, "DELETE": OPERATE},
    f"{DRIVE}/track": {"GET": FOLLOW},
    f"{DRIVE}/preview.png": {"GET": FOLLOW},
    f"{DRIVE}/quality": {"GET": FOLLOW},
    f"{DRIVE}/quality/{{picture}}.svg": {"GET": FOLLOW},
    f"{DRIVE}/runs": {"GET": FOLLOW},
    f"{DRIVE}/release": {"POST": OPERATE, "DELETE": OPERATE},
    f"{DRIVE}/retry": {"POST": OPERATE},
    f"{DRIVE}/cancel": {"POST": OPERATE},
    f"{DRIVE}/reprocess": {"POST": OPERATE},
    f"{DRIVE}/packs": {"POST": SEND},
    f"{UPLOAD}/files": {"GET": SEND},
    "/v1/uploads": {"OPTIONS": SEND, "POST": SEND},
    UPLOAD: {"OPTIONS": SEND, "HEAD": SEND, "PATCH": SEND, "DELETE": SEND},
    f"{DRIVE}/report.html": {"GET": FOLLOW},
    f"{DRIVE}/history": {"GET": FOLLOW},
    f"{DRIVE}/trajectory.tum": {"GET": FOLLOW},
    f"{DRIVE}/cloud.ply": {"GET": FOLLOW},
    f"{DRIVE}/archive.zip": {"GET": FOLLOW},
    f"{DRIVE}/log.tar": {"GET": OPERATE},
    f"{DRIVE}/keyframes": {"GET": FOLLOW},
    f"{DRIVE}/keyframes/{{number}}/points.webp": {"GET": FOLLOW},
    f"{DRIVE}/keyframes/{{number}}/image.webp": {"GET": OPERATE},
    "/v1/fleet": {"GET": READ},
    "/v1/events": {"GET": FOLLOW},
    SESSION: {"GET": Open.TO_KNOWN, "POST": Open.TO_ALL, "DELETE": Open.TO_KNOWN},
    OIDC: {"GET": Open.TO_ALL},
    OIDC_CALLBACK: {"GET": Open.TO_ALL},
    "/v1/excluded-areas": {"GET": READ, "POST": OPERATE},
    "/v1/excluded-areas/{area_id}": {"DELETE": OPERATE},
    "/v1/keys": {"GET": MANAGE, "POST": MANAGE},
    "/v1/keys/{prefix}": {"DELETE": MANAGE},
    "/v1/keys/{prefix}/rotate": {"POST": MANAGE},
    "/v1/audit": {"GET": MANAGE},
    "/metrics": {"GET": READ},
    "/v1/info": {"GET": Open.TO_ALL},
    "/v1/openapi.json": {"GET": Open.TO_ALL},
    "/healthz": {"GET": Open.TO_ALL},
    "/readyz": {"GET": Open.TO_ALL},
    "/": {"GET": Open.TO_ALL},
    "/sign-in": {"GET": Open.TO_ALL},
    "/3d": {"GET": Open.TO_ALL},
    "/drives/{drive_id}": {"GET": Open.TO_ALL},
    "/fleet": {"GET": Open.TO_ALL},
    "/areas": {"GET": Open.TO_ALL},
    "/access": {"GET": Open.TO_ALL},
}
"""The pages and what they load (`/static/`) hold nothing of anybody: what they show they ask of /v1."""

READING: Final = frozenset({"GET", "HEAD", "OPTIONS"})
"""Methods that change nothing."""
ONLY_ASK: Final = frozenset({f"{MAP}/sync"})
"""Templates that change nothing either: a question too long for an address."""
BY_GET: Final = frozenset({OIDC_CALLBACK})
"""Templates whose GET changes something: a browser comes back there with what it needs for a session."""


@dataclass(frozen=True, slots=True)
class Asked:
    """A request's route: template, need, whether it changes anything, and what its path names."""

    template: str
    need: Need
    changes: bool
    named: dict[str, str]

    @property
    def path(self) -> str:
        """The template, as routes of the framework call it."""
        return self.template


def _compiled() -> dict[int, list[tuple[str, re.Pattern[str]]]]:
    """Templates by their number of slashes: a path is compared with a few."""
    found: dict[int, list[tuple[str, re.Pattern[str]]]] = {}
    for template in NEEDS:
        found.setdefault(template.count("/"), []).append((template, compile_path(template)[0]))
    return found


_COMPILED: Final = _compiled()
_OF_STATIC: Final = Asked(STATIC, Open.TO_ALL, False, {})


def asked(method: str, path: str) -> Asked | None:
    """The route of a request; HEAD needs what GET does. None where no route is known."""
    if path.startswith(STATIC):
        return _OF_STATIC if method in READING else None
    for template, pattern in _COMPILED.get(path.count("/"), ()):
        found = pattern.match(path)
        need = need_of(template, method) if found else None
        if found and need is not None:
            changes = (method not in READING and template not in ONLY_ASK) or (method == "GET" and template in BY_GET)
            return Asked(template, need, changes, found.groupdict())
    return None


def need_of(template: str, method: str) -> Need | None:
    """The need of a route by its template; None where it is not in the table."""
    of_route = NEEDS.get(template, {})
    return of_route.get(method) or (of_route.get("GET") if method == "HEAD" else None)


def methods_of(path: str) -> set[str]:
    """The methods that are known at a path."""
    found = (NEEDS[template] for template, pattern in _COMPILED.get(path.count("/"), ()) if pattern.match(path))
    return {method for methods in found for method in methods}
