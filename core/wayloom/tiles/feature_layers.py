"""Layers of vector tiles of a map's features: what each shows, as what, and what its features tell."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from wayloom.tiles import protobuf
from wayloom.tiles.settings import TileSettings

MARKINGS: Final = "markings"
KERBS: Final = "kerbs"
AREAS: Final = "areas"
OBJECTS: Final = "objects"
STRINGS: Final = frozenset({"id", "kind"})
"""The properties that are no numbers."""


@dataclass(frozen=True, slots=True)
class FeatureLayer:
    """A layer of tiles.

    parts       the layers in each of its tiles
    drawn_as    POINT, LINE or POLYGON of `protobuf`
    properties  that its features tell, those that they have
    part_of     of kinds that are not in the first part, the part
    """

    name: str
    parts: tuple[str, ...]
    drawn_as: int
    properties: tuple[str, ...]
    part_of: Mapping[str, str] = field(default_factory=dict)

    def part(self, kind: str) -> str:
        """The layer in a tile that shows features of a kind."""
        return self.part_of.get(kind, self.parts[0])

    def zooms(self, settings: TileSettings) -> Sequence[int]:
        """Of its tiles, coarsest first."""
        return range(getattr(settings, f"{self.name}_from_zoom"), getattr(settings, f"{self.name}_zoom") + 1)

    def vector_layers(self) -> list[dict[str, Any]]:
        """Its parts as TileJSON lists them."""
        fields = {name: "String" if name in STRINGS else "Number" for name in self.properties}
        return [{"id": part, "fields": fields} for part in self.parts]


MARKING_PROPERTIES: Final = (
    "kind", "width_m", "height_m", "length_m", "sigma_m", "sigma_height_m", "sigma_place_m", "confidence",
)  # fmt: skip
OBJECT_PROPERTIES: Final = (
    "id", "kind", "height_m", "bottom_m", "width_m", "facing_deg", "facing_sigma_deg", "sigma_m", "confidence", "drive_count",
)  # fmt: skip
FEATURE_LAYERS: Final = {
    layer.name: layer
    for layer in (
        FeatureLayer(MARKINGS, (MARKINGS, KERBS), protobuf.LINE, MARKING_PROPERTIES, {"kerb": KERBS}),
        FeatureLayer(AREAS, (AREAS,), protobuf.POLYGON, ("kind", "area_m2", "confidence", "sigma_place_m")),
        FeatureLayer(OBJECTS, (OBJECTS,), protobuf.POINT, OBJECT_PROPERTIES),
    )
}
"""By their names, which are those of the rows' columns too."""
