"""Tables of the newest versions' features, for programs that read geometry from the database: QGIS, martin, GDAL.

Each has rows of one geometry type with a whole-numbered primary key, the collection's properties as columns of their own, and on
PostgreSQL a GiST index. They are written from the files of the regions (`shown_features`) and nothing of wayloom reads them, so a
migration may empty them: they fill again.

A further collection is an entry in FEATURE_TABLES, with a migration that makes its table.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import BigInteger, Boolean, Column, Float, Index, Integer, String, Table, Text
from sqlalchemy.orm import Mapped, mapped_column
from sqlalchemy.types import TypeEngine

from wayloom.store.spatial.geometry_column import geometry
from wayloom.store.tables.base import DIGEST, Base

INTEGER: Final = BigInteger().with_variant(Integer(), "sqlite")
COLUMN_OF: Final[dict[type, TypeEngine[Any]]] = {str: Text(), float: Float(53), int: INTEGER, bool: Boolean()}


class ShownRegion(Base):
    """A region whose features are in the tables: the digest of the file that they were read from.

    source  the column of `regions` that names such files
    """

    __tablename__ = "shown_regions"
    map_id: Mapped[str] = mapped_column(String(63), primary_key=True)
    source: Mapped[str] = mapped_column(String(32), primary_key=True)
    east: Mapped[int] = mapped_column(primary_key=True)
    north: Mapped[int] = mapped_column(primary_key=True)
    digest: Mapped[str] = mapped_column(DIGEST)


@dataclass(frozen=True, slots=True)
class FeatureTable:
    """A table of features.

    source   the column of `regions` that names their files, GeoJSON feature collections
    kind     of the geometry, as `wkb.wkb_as` takes it
    takes    whether a feature of these files belongs here
    fields   the properties that have columns, and their types
    """

    source: str
    table: Table
    kind: str
    takes: Callable[[Mapping[str, Any]], bool]
    fields: tuple[str, ...]


def _table(name: str, kind: str, fields: Mapping[str, type]) -> Table:
    """id, map, the version since which the map has the region's features so, the region, the properties, the geometry."""
    return Table(
        name, Base.metadata,
        Column("id", INTEGER, primary_key=True, autoincrement=True),
        Column("map_id", String(63), nullable=False),
        Column("since", INTEGER, nullable=False),
        Column("east", INTEGER, nullable=False),
        Column("north", INTEGER, nullable=False),
        *(Column(field, COLUMN_OF[of]) for field, of in fields.items()),
        Column("geometry", geometry(kind), nullable=False),
        Index(f"ix_{name}_map_id_east_north", "map_id", "east", "north"),
    )  # fmt: skip


def _is_kerb(feature: Mapping[str, Any]) -> bool:
    return bool(feature["properties"]["kind"] == "kerb")


def _is_area(feature: Mapping[str, Any]) -> bool:
    return bool(feature["geometry"]["type"] == "Polygon")


def _entry(
    source: str, name: str, kind: str, takes: Callable[[Mapping[str, Any]], bool], fields: Mapping[str, type]
) -> FeatureTable:
    return FeatureTable(source, _table(name, kind, fields), kind, takes, tuple(fields))


PAINT: Final = {
    "kind": str, "width_m": float, "length_m": float, "sigma_m": float, "sigma_place_m": float, "confidence": float,
}  # fmt: skip
KERB: Final = {
    "length_m": float, "height_m": float, "sigma_m": float, "sigma_height_m": float, "sigma_place_m": float, "confidence": float,
}  # fmt: skip
AREA: Final = {"kind": str, "area_m2": float, "confidence": float, "sigma_place_m": float}
OBJECT: Final = {
    "object_id": str, "kind": str, "height_m": float, "bottom_m": float, "width_m": float, "facing_deg": float,
    "facing_sigma_deg": float, "sigma_m": float, "confidence": float, "drive_count": int, "first_ns": int, "last_ns": int,
}  # fmt: skip
PROPERTY_OF: Final = {"object_id": "id"}
"""The property of a column, where it has another name: `id` is the row's."""
FEATURE_TABLES: Final = (
    _entry("objects", "map_objects", "PointZ", lambda _: True, OBJECT),
    _entry("areas", "map_areas", "PolygonZ", lambda _: True, AREA),
    _entry("markings", "map_markings", "MultiLineStringZ", lambda one: not _is_kerb(one) and not _is_area(one), PAINT),
    _entry("markings", "map_marking_areas", "PolygonZ", _is_area, PAINT | {"bars": int, "period_m": float}),
    _entry("markings", "map_kerbs", "MultiLineStringZ", _is_kerb, KERB),
)
