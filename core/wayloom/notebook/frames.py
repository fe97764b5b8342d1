"""GeoDataFrames of points and features. The only import of geopandas, which is an extra."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_NAMES, VOID
from wayloom.config.extras import from_extra
from wayloom.exports.points import ALL_VOTES, PointBatch
from wayloom.exports.source import Feature

if TYPE_CHECKING:
    import geopandas

CRS: Final = "EPSG:4979"
"""WGS84 with ellipsoidal heights; geopandas takes longitude first."""


def of_points(points: PointBatch, lon_lat_height: NDArray[np.float64]) -> "geopandas.GeoDataFrame":
    """One row a point: class, confidence from 0 to 1, sigma_m, drives, first_seen, last_seen; geometry is a Point Z."""
    geo = _geopandas()
    names = np.array([*CLASS_NAMES, "void"])
    columns = {
        "class": names[np.where(points.label == VOID, len(CLASS_NAMES), points.label)],
        "confidence": points.confidence / np.float32(ALL_VOTES),
        "sigma_m": points.sigma_m,
        "drives": points.drives,
        "first_seen": points.first_ns.astype("datetime64[ns]"),
        "last_seen": points.seen_ns.astype("datetime64[ns]"),
    }
    return geo.GeoDataFrame(columns, geometry=geo.points_from_xy(*lon_lat_height.T), crs=CRS)


def of_features(features: Sequence[Feature], columns: Mapping[str, Any]) -> "geopandas.GeoDataFrame":
    """One row a feature with its properties; a column for each that the collection knows, whatever these features have."""
    geo = _geopandas()
    if not features:
        return geo.GeoDataFrame({name: [] for name in columns}, geometry=[], crs=CRS)
    found = geo.GeoDataFrame.from_features(features, crs=CRS)
    return found.reindex(columns=["geometry", *columns])


def _geopandas() -> Any:
    with from_extra("geo", "a GeoDataFrame"):
        import geopandas
    return geopandas
