"""GeoParquet 1.1 of a map's features or points: row groups with boxes, provenance as metadata. The only import of pyarrow."""

import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np

from wayloom.config.classes import CLASS_NAMES, VOID
from wayloom.config.extras import missing_extra
from wayloom.config.progress import Progress, silent
from wayloom.errors import InputError
from wayloom.exports.features import Kind, places_of, read_collection, wanted_collections
from wayloom.exports.points import ALL_VOTES, PointBatch, together
from wayloom.exports.source import Feature, MapSource
from wayloom.exports.wkb import wkb, wkb_points
from wayloom.files.atomic import replacing_by_name
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import Box
from wayloom.geodesy.map_frame import MapFrame

try:
    import pyarrow
    import pyarrow.parquet
except ModuleNotFoundError:  # an optional extra: 45 MB
    pyarrow = None

ROW_GROUP, POINTS_TOGETHER = 10_000, 100_000
VERSION: Final = "1.1.0"
BOX: Final = ("xmin", "ymin", "xmax", "ymax")
CLASS_NAME: Final = [*CLASS_NAMES, *[""] * (VOID - len(CLASS_NAMES)), "void"]


def check_pyarrow(path: Path) -> None:
    """Raises MissingExtraError where pyarrow is not installed."""
    if pyarrow is None:
        raise missing_extra("parquet", "GeoParquet", path)


def write_feature_parquet(
    path: Path, source: MapSource, box: Box | None, names: Sequence[str], provenance: Mapping[str, Any], progress: Progress = silent
) -> dict[str, int]:
    """Write the collections of these names, all for none, as one table: the column `collection` tells which, and a column that a
    collection has not is null. How many features each has. Raises InputError, OSError."""
    check_pyarrow(path)
    wanted = wanted_collections(names)
    columns: dict[str, Kind] = {name: kind for one in wanted.values() for name, kind in one.columns.items()}
    types = {"text": pyarrow.string(), "real": pyarrow.float64(), "whole": pyarrow.int64(), "json": pyarrow.string()}
    fields = [("collection", pyarrow.string()), *((name, types[kind]) for name, kind in columns.items())]
    counts = dict.fromkeys(wanted, 0)
    with _Table(path, fields, provenance) as table:
        for name in wanted:
            features = read_collection(name, source, box, progress)
            while rows := [*islice(features, ROW_GROUP)]:
                table.add(_feature_columns(name, rows, columns), *_geometries(rows))
                counts[name] += len(rows)
    return counts


def write_point_parquet(path: Path, batches: Iterable[PointBatch], frame: MapFrame | None, provenance: Mapping[str, Any]) -> int:
    """Write points as one table; how many. Raises InputError where they have no place on Earth, OSError."""
    check_pyarrow(path)
    if frame is None:
        raise InputError("is of places on Earth, and this drive has none", file=path, remedy="process it with --gnss")
    time = pyarrow.timestamp("ns", tz="UTC")
    fields = [
        ("class", pyarrow.dictionary(pyarrow.int8(), pyarrow.string())), ("label", pyarrow.uint8()),
        ("confidence", pyarrow.float32()), ("intensity", pyarrow.uint8()), ("sigma_m", pyarrow.float32()),
        ("drives", pyarrow.uint16()), ("first_seen", time), ("last_seen", time),
    ]  # fmt: skip
    count = 0
    with _Table(path, fields, provenance) as table:
        for batch in together(batches, POINTS_TOGETHER):
            places = wgs84.lonlatheight_from_enu(batch.points, frame)
            table.add(_point_columns(batch, time), _binary(wkb_points(places)), np.hstack([places[:, :2]] * 2), {"Point Z"})
            count += len(batch)
    return count


def _feature_columns(name: str, rows: Sequence[Feature], columns: Mapping[str, Kind]) -> list[Any]:
    told = [[row["properties"].get(column) for row in rows] for column in columns]
    as_text = [
        [json.dumps(value) if kind == "json" and value is not None else value for value in values]
        for values, kind in zip(told, columns.values(), strict=True)
    ]
    return [[name] * len(rows), *as_text]


def _geometries(rows: Sequence[Feature]) -> tuple[Any, np.ndarray[Any, np.dtype[np.float64]], set[str]]:
    """Geometries, boxes (N, 4), and the types that there are."""
    places = [np.array([place[:2] for place in places_of(row["geometry"])], np.float64) for row in rows]
    boxes = np.array([[*one.min(axis=0), *one.max(axis=0)] for one in places])
    kinds = {f"{row['geometry']['type']} Z" for row in rows}
    return pyarrow.array([wkb(row["geometry"]) for row in rows], pyarrow.binary()), boxes, kinds


def _point_columns(batch: PointBatch, time: Any) -> list[Any]:
    used, index = np.unique(batch.label, return_inverse=True)
    names = pyarrow.DictionaryArray.from_arrays(
        pyarrow.array(index.astype(np.int8)), [CLASS_NAME[label] for label in used.tolist()]
    )
    confidence = (batch.confidence / np.float32(ALL_VOTES)).astype(np.float32)
    times = (pyarrow.array(one, pyarrow.int64()).cast(time) for one in (batch.first_ns, batch.seen_ns))
    return [names, batch.label, confidence, batch.grey, batch.sigma_m, batch.drives, *times]


def _binary(rows: np.ndarray[Any, np.dtype[np.void]]) -> Any:
    """An array of binary values of equal length, without a copy of each."""
    offsets = np.arange(len(rows) + 1, dtype=np.int32) * rows.dtype.itemsize
    buffers = [None, pyarrow.py_buffer(offsets), pyarrow.py_buffer(rows.tobytes())]
    return pyarrow.Array.from_buffers(pyarrow.binary(), len(rows), buffers)


class _Table:
    """A file of one geometry column that is written row group by row group; in place when the block ends well."""

    def __init__(self, path: Path, fields: Sequence[tuple[str, Any]], provenance: Mapping[str, Any]) -> None:
        self._replacing = replacing_by_name(path)
        box = pyarrow.struct([(name, pyarrow.float64()) for name in BOX])
        self._schema = pyarrow.schema([*fields, ("bbox", box), ("geometry", pyarrow.binary())])
        self._provenance, self._kinds = provenance, set[str]()
        self._bounds = np.array([np.inf, np.inf, -np.inf, -np.inf])

    def __enter__(self) -> "_Table":
        self._writer = pyarrow.parquet.ParquetWriter(self._replacing.__enter__(), self._schema, compression="zstd")
        return self

    def add(self, columns: Sequence[Any], geometry: Any, boxes: Any, kinds: set[str]) -> None:
        """Append a row group: values of the fields, geometries, their boxes (N, 4)."""
        box = pyarrow.StructArray.from_arrays([pyarrow.array(boxes[:, k]) for k in range(4)], [*BOX])
        types = [self._schema.field(k).type for k in range(len(columns))]
        arrays = [
            column if isinstance(column, pyarrow.Array) else pyarrow.array(column, kind)
            for column, kind in zip(columns, types, strict=True)
        ]
        self._writer.write_table(pyarrow.Table.from_arrays([*arrays, box, geometry], schema=self._schema))
        self._kinds |= kinds
        low, high = np.minimum(self._bounds[:2], boxes[:, :2].min(axis=0)), np.maximum(self._bounds[2:], boxes[:, 2:].max(axis=0))
        self._bounds = np.concatenate([low, high])

    def __exit__(self, *error: Any) -> None:
        with closing(self._writer):
            if error[0] is None:
                self._writer.add_key_value_metadata({"geo": json.dumps(self._geo()), "wayloom": json.dumps(self._provenance)})
        self._replacing.__exit__(*error)

    def _geo(self) -> dict[str, Any]:
        """The standard's metadata; coordinates are OGC:CRS84, its default: longitude, latitude, and heights above the ellipsoid."""
        geometry = {
            "encoding": "WKB",
            "geometry_types": sorted(self._kinds),
            "covering": {"bbox": {name: ["bbox", name] for name in BOX}},
        }
        if self._kinds:
            geometry["bbox"] = self._bounds.tolist()
        return {"version": VERSION, "primary_column": "geometry", "columns": {"geometry": geometry}}
