"""Settings of the tiles."""

from typing import Self

from pydantic import Field, model_validator

from wayloom.config.settings import Settings


class TileSettings(Settings):
    """Zoom levels and resolution of the tiles."""

    min_zoom: int = Field(12, ge=3, le=20, description="coarsest zoom of pictures and vector tiles")
    max_zoom: int = Field(
        20, ge=0, le=21, description="finest zoom of the preview pictures, from whose pixels all coarser levels are summed"
    )
    features_max_zoom: int = Field(18, ge=0, le=20, description="finest zoom of the vector tiles; viewers enlarge beyond")
    fine_cells_from_zoom: int = Field(17, ge=0, le=20, description="from here 128 cells a tile edge, below 64")
    tracks_from_zoom: int = Field(
        14,
        ge=0,
        le=20,
        description="from here the vector tiles show the drives' tracks; on coarser ones their cells say where they went",
    )
    points_zoom: int = Field(18, ge=10, le=20)
    points_per_tile: int = Field(
        75_000, ge=100, le=76_000, description="a fuller point tile is thinned by joining voxels, counts kept; 13 bytes each"
    )
    cloud_points_per_tile: int = Field(
        27_500, ge=100, le=27_500, description="of a 3D tile: more are joined, and stand whole in the tiles below; 36 bytes each"
    )
    overlays_from_zoom: int = Field(
        16, ge=3, le=20, description="coarsest zoom of the pictures of overlays: of what is parked, of what is not confirmed"
    )
    ortho_zoom: int = Field(
        20, ge=3, le=20, description="finest zoom of the orthophoto, whose tiles have 512 pixels: 20 is 5 cm at 49 degrees"
    )
    markings_from_zoom: int = Field(16, ge=12, le=20, description="coarsest zoom of the vector tiles of markings and kerbs")
    markings_zoom: int = Field(20, ge=12, le=20, description="finest zoom of the vector tiles of markings and kerbs")
    areas_from_zoom: int = Field(14, ge=12, le=20, description="coarsest zoom of the vector tiles of areas")
    areas_zoom: int = Field(18, ge=12, le=20, description="finest zoom of the vector tiles of areas")
    objects_from_zoom: int = Field(15, ge=12, le=20, description="coarsest zoom of the vector tiles of objects")
    objects_zoom: int = Field(18, ge=12, le=20, description="finest zoom of the vector tiles of objects")
    dot_from_zoom: int = Field(19, ge=0, le=21, description="from here a voxel is drawn three pixels wide")

    @property
    def block_zoom(self) -> int:
        """The zoom of the blocks by which tiles are cut anew."""
        return min(self.points_zoom, self.max_zoom)

    @model_validator(mode="after")
    def _zooms_in_order(self) -> Self:
        if not self.min_zoom <= self.features_max_zoom <= self.max_zoom:
            raise ValueError(
                f"min_zoom {self.min_zoom} <= features_max_zoom {self.features_max_zoom} <= max_zoom {self.max_zoom} must hold"
            )
        if self.dot_from_zoom <= min(self.points_zoom, self.max_zoom):
            raise ValueError(f"points_zoom {self.points_zoom} < dot_from_zoom {self.dot_from_zoom} must hold")
        for name in ("markings", "areas", "objects"):
            first, last = getattr(self, f"{name}_from_zoom"), getattr(self, f"{name}_zoom")
            if first > last:
                raise ValueError(f"{name}_from_zoom {first} <= {name}_zoom {last} must hold")
        return self
