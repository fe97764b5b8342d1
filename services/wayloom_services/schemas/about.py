"""Models of the service itself: its health, its classes, what it is."""

from typing import Literal

from pydantic import BaseModel, Field


class Health(BaseModel):
    """Whether the server lives, and what it can reach."""

    status: Literal["ok", "degraded"]
    version: str
    checks: dict[str, str]


class ClassOut(BaseModel):
    """A class of the map."""

    id: int
    name: str
    colour: str
    in_map: bool = Field(description="False for what moves and for the sky, which the map leaves out")


class Info(BaseModel):
    """Map, stages and classes: for dashboards and clients, before their first request."""

    version: str
    map_id: str
    needs_key: bool
    oidc_label: str | None = Field(description="what the button of the sign-in by OpenID Connect says; null where there is none")
    stages: list[str]
    overlays: list[str] = Field(description="layers of pictures beside `semantic`; a version has those that show anything")
    classes: list[ClassOut]
    models: list[str] = Field(description="networks of the catalogue, by which a drive can be processed anew")
