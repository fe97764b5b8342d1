"""Retention of what drives have sent: how long images are kept."""

from typing import Annotated, Literal

from pydantic import Field

from wayloom.config.settings import Settings

Days = Annotated[float, Field(ge=0.0, le=36_500.0)]


class UploadSettings(Settings):
    """How long the log of a drive, its images above all, is kept once it has arrived."""

    retention: Literal["until-published", "keep"] | Days = Field(
        "until-published",
        description="images of a drive that is in the map go at once (`until-published`), after so many days, or never (`keep`)",
    )
    held_days: float = Field(
        30.0, gt=0.0, le=36_500.0,
        description="days after which those of a drive go that is held, quarantined or failed, or did not arrive whole",
    )  # fmt: skip


MAX_AREA_BYTES = 4 * 2**20
"""Of GeoJSON with excluded areas."""
MAX_AREAS = 1000
"""Of one request: each is looked for in every version."""
