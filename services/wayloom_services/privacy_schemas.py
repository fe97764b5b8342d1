"""Response and request models of what is kept of drives."""

from typing import Literal

from pydantic import BaseModel, Field


class ImagesOut(BaseModel):
    """What the service has of a drive's log."""

    state: Literal["kept", "deleting", "deleted", "returning"] = Field(
        description="deleted: its stages cannot be run anew until the log is sent once more; returning: it is being sent"
    )
    since: float | None = Field(description="when that began; None while the log is there")
