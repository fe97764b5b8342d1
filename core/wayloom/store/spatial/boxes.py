"""Look-up of submaps by boxes: the GiST index of PostGIS, the R*Tree of SQLite.

Either finds a few more than touch, since it holds boxes of single precision, and the box of a place on both sides of the
antimeridian goes round the Earth on PostGIS; the caller asks the columns as well. The database itself keeps both indices from these
columns (`derived`).
"""

from typing import Any, Final

from sqlalchemy import ColumnElement, Select, and_, column, func, literal_column, select, table, tuple_, union_all
from sqlalchemy.orm import Session
from sqlalchemy.orm.util import AliasedClass

from wayloom.store.tables.drives import SubmapRow

Box = tuple[float, float, float, float]
"""West, south, east, north in degrees; across the antimeridian east is over 180."""
TURNS: Final = (0.0, 360.0, -360.0)
REACH_DEG: Final = (-540.0, 540.0)
"""Between which the longitudes of all boxes lie."""


def indexed(session: Session, box: Box) -> ColumnElement[bool]:
    """Of a submap: the index finds that its box may touch this one."""
    if session.get_bind().dialect.name == "postgresql":
        return literal_column("submaps.footprint").op("&&", is_comparison=True)(func.wayloom_box(*box))
    west, south, east, north = box
    turns = [turn for turn in TURNS if west + turn <= REACH_DEG[1] / 1.5 and east + turn >= REACH_DEG[0] / 1.5]
    return _among("submap_boxes", [(west + turn, south, east + turn, north) for turn in turns])


def indexed_near(session: Session, own: "AliasedClass[SubmapRow] | type[SubmapRow]") -> ColumnElement[bool]:
    """Of a submap: the index finds that the box around it may touch that around `own`."""
    west, south, east, north = own.near_min_lon, own.near_min_lat, own.near_max_lon, own.near_max_lat
    if session.get_bind().dialect.name == "postgresql":
        row = SubmapRow
        around = func.wayloom_box(row.near_min_lon, row.near_min_lat, row.near_max_lon, row.near_max_lat)
        return around.op("&&", is_comparison=True)(func.wayloom_box(west, south, east, north))
    return _among("submap_near_boxes", [(west + turn, south, east + turn, north) for turn in TURNS])


def _among(name: str, boxes: list[tuple[Any, Any, Any, Any]]) -> ColumnElement[bool]:
    """Of a submap: it is among those that an R*Tree finds in any of the boxes."""
    tree = table(name, *(column(of) for of in ("drive_id", "position", "min_lon", "min_lat", "max_lon", "max_lat")))
    found: list[Select[Any]] = [
        select(tree.c.drive_id, tree.c.position).where(
            and_(tree.c.min_lon <= east, tree.c.max_lon >= west, tree.c.min_lat <= north, tree.c.max_lat >= south)
        )
        for west, south, east, north in boxes
    ]
    return tuple_(SubmapRow.drive_id, SubmapRow.position).in_(found[0] if len(found) == 1 else union_all(*found))
