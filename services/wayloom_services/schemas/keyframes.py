"""Models of a drive's keyframes."""

from pydantic import BaseModel, Field


class KeyframeOut(BaseModel):
    """A keyframe."""

    number: int
    frame: int = Field(description="of the log")
    t_s: float = Field(description="when it was taken, seconds since 1970")
    points: int = Field(description="of which it is the host")
    lon: float | None
    lat: float | None


class KeyframeList(BaseModel):
    """The keyframes of a drive."""

    keyframes: list[KeyframeOut]
    images: str = Field(description="kept, deleting, deleted, returning: whether there are pictures of them")
    retention: str = Field(description="when images are deleted: setting uploads.retention")
