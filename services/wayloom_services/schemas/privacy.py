"""Response and request models of what is kept of drives."""

from typing import Any, Literal

from pydantic import BaseModel, Field


class ImagesOut(BaseModel):
    """What the service has of a drive's log."""

    state: Literal["kept", "deleting", "deleted", "returning"] = Field(
        description="deleted: its stages cannot be run anew until the log is sent once more; returning: it is being sent"
    )
    since: float | None = Field(description="when that began; None while the log is there")


class ExcludedAreaFacts(BaseModel):
    """What is known of an excluded area besides its place."""

    name: str
    source: Literal["service", "settings"] = Field(description="settings: of the file that `excluded_areas` names")
    created_at: float
    since_version: int | None = Field(description="the first version without what lies in it; None: that is being made")


class ExcludedAreaOut(BaseModel):
    """An area of which the map keeps nothing, as a feature."""

    type: Literal["Feature"] = "Feature"
    id: str
    geometry: dict[str, Any]
    properties: ExcludedAreaFacts


class ExcludedAreaList(BaseModel):
    """Excluded areas."""

    type: Literal["FeatureCollection"] = "FeatureCollection"
    features: list[ExcludedAreaOut]
