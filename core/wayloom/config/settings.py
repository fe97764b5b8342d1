"""Base class of all settings: frozen, closed, each with its range and unit in its `Field`."""

from pydantic import BaseModel, ConfigDict


class Settings(BaseModel):
    """Settings of one stage. Unknown names are refused; a changed value is a new object (`model_copy(update=…)`)."""

    model_config = ConfigDict(frozen=True, extra="forbid")
