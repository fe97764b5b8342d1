"""Well-known binary of GeoJSON geometries in the type that a column wants."""

from collections.abc import Mapping
from typing import Any, Final

from wayloom.exports.wkb import wkb

MULTI: Final = "Multi"


def wkb_as(geometry: Mapping[str, Any], kind: str) -> bytes:
    """The geometry's bytes as `kind`, GeoJSON's name with a Z behind it (`MultiLineStringZ`): a single one fills a column of many.

    Raises ValueError for a geometry of another kind.
    """
    name, given = kind.removesuffix("Z"), geometry["type"]
    if given == name:
        return wkb(geometry)
    if f"{MULTI}{given}" != name:
        raise ValueError(f"a {given} is no {name}")
    return wkb({"type": name, "coordinates": [geometry["coordinates"]]})
