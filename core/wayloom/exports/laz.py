"""LAZ, written batch by batch."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import laspy

from wayloom.exports.las import Projection, las_header, las_records
from wayloom.exports.points import PointBatch
from wayloom.files.atomic import replacing


def write_laz(path: Path, batches: Iterable[PointBatch], projection: Projection, provenance: Mapping[str, Any]) -> int:
    """Write the points as LAZ 1.4 (`las_records`); how many there are.

    Raises InputError where the geoid does not reach, OSError.
    """
    header = las_header(projection, provenance)
    with replacing(path) as stream:
        writer = laspy.LasWriter(stream, header, do_compress=True, laz_backend=laspy.LazBackend.Lazrs, closefd=False)
        for batch in batches:
            writer.write_points(las_records(batch, projection, writer.header))
        writer.close()
        return int(writer.header.point_count)
