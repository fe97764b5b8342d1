"""Settings of the labelling."""

from pydantic import Field

from wayloom.config.settings import Settings


class LabellingSettings(Settings):
    """dist_min_m: an observation nearer than this does not vote (eq. 3; the paper names no value)."""

    dist_min_m: float = Field(2.0, gt=0, le=100, description="metres along the observer's z axis")
