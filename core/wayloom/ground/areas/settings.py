"""Settings of areas."""

from pydantic import Field

from wayloom.config.settings import Settings


class AreaSettings(Settings):
    """How areas of the ground are drawn."""

    least_m2: float = Field(
        1.0,
        gt=0.0,
        le=1.2,
        description="smaller patches and holes take the class around them, m^2",
    )
    smooth_cells: int = Field(2, ge=0, le=5, description="a cell's class is voted by the cells up to so far around it")
    tolerance_m: float = Field(0.15, ge=0.0, le=1.0, description="how far outlines may leave the borders of the cells, m")
