"""OpenAPI document as the errors really are: every problem is application/problem+json, a malformed request too."""

from typing import Any, Final

from fastapi import FastAPI

from wayloom_services.access.described import describe_access
from wayloom_services.errors import MEDIA_TYPE, Problem

PROBLEM: Final = {"schema": {"$ref": "#/components/schemas/Problem"}}
FRAMEWORK: Final = ("HTTPValidationError", "ValidationError")
"""Schemas of the framework's own errors, which are never sent."""

OF_BODIES: Final = {"400": "the body cannot be read", "408": "the body paused for too long", "413": "the body is too long"}
"""What is answered to any body, whatever the operation."""


def describe(app: FastAPI) -> None:
    """Make the application describe itself so."""
    made = app.openapi

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _with_problems(made())
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]


def _with_problems(document: dict[str, Any]) -> dict[str, Any]:
    schemas = document["components"]["schemas"]
    for name in FRAMEWORK:
        schemas.pop(name, None)
    schemas["Problem"] = Problem.model_json_schema()
    describe_access(document)
    for operations in document["paths"].values():
        for operation in operations.values():
            if "requestBody" in operation:
                for status, description in OF_BODIES.items():
                    operation["responses"].setdefault(status, {"description": description})
            for status, response in operation["responses"].items():
                if status.startswith(("4", "5")) and not _is_health(response):
                    response["content"] = {MEDIA_TYPE: PROBLEM}
    return document


def _is_health(response: dict[str, Any]) -> bool:
    """Readiness tells what is away in its own words, with 503."""
    return "Health" in str(response.get("content", ""))
