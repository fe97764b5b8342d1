"""Access in the OpenAPI document: how callers say who they are, and what each operation needs."""

from typing import Any, Final

from wayloom.config.roles import RIGHTS, Right
from wayloom_services.access.callers import COOKIE_OF_HTTPS
from wayloom_services.access.needs import READING, Open, need_of

SCHEMES: Final[dict[str, Any]] = {
    "key": {"type": "http", "scheme": "bearer", "description": "a key of `wayloom keys create`, or WAYLOOM_API_KEY"},
    "session": {
        "type": "apiKey",
        "in": "cookie",
        "name": COOKIE_OF_HTTPS,
        "description": "of `POST /v1/session`; `wayloom` over http",
    },
}
UNKNOWN: Final = {"description": "no key or session, or one that is unknown, expired or revoked"}
FORBIDDEN: Final = {"description": "the caller's role has not the right; or a page of another origin asks for a change"}
CROSS_SITE: Final = {"description": "a page of another origin asks for a change, or one that does not send the header"}
FLOOD: Final = {"description": "too many requests, or more than the quota: Retry-After says when it may be tried again"}


def describe_access(document: dict[str, Any]) -> None:
    """Add to each operation its right, the roles that have it, and the answers of the guard."""
    document["components"]["securitySchemes"] = SCHEMES
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            need = need_of(path, method.upper())
            answers = operation["responses"]
            answers.setdefault("429", FLOOD)
            if need is Open.TO_ALL:
                operation["security"] = []
                if method.upper() not in READING:
                    answers["403"] = CROSS_SITE
                continue
            operation["security"] = [{"key": []}, {"session": []}]
            answers["401"] = {**answers.get("401", {}), **UNKNOWN}
            answers["403"] = FORBIDDEN
            if isinstance(need, Right):
                operation["x-wayloom-right"] = str(need)
                operation["x-wayloom-roles"] = [str(role) for role, rights in RIGHTS.items() if need in rights]
