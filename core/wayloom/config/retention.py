"""Settings of what drives have sent: where it is kept, and for how long."""

from typing import Annotated, Literal

from pydantic import Field

from wayloom.config.settings import Settings

Days = Annotated[float, Field(ge=0.0, le=36_500.0)]


class UploadSettings(Settings):
    """Where the log of a drive is kept once it has arrived, its images above all, and for how long."""

    url: str | None = Field(None, description="object store URL of what drives send, s3://bucket/prefix; default the data folder")
    fetched_bytes: int = Field(
        100 * 2**30, ge=0,
        description="bytes of drives' logs that workers keep in the data folder of what they fetched from that object store",
    )  # fmt: skip

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
