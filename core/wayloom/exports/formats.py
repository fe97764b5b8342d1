"""Export formats, one entry each: what it is guessed from, what it holds, and its writer."""

import difflib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from wayloom.config.progress import Progress, silent
from wayloom.errors import InputError, UnknownFormatError
from wayloom.exports.archive import MEDIA_TYPES, VECTOR, write_archive
from wayloom.exports.city_picture import write_city_picture
from wayloom.exports.cog import ORTHO, UNITS_M, write_ground_cog
from wayloom.exports.copc import write_copc
from wayloom.exports.features import COLLECTIONS
from wayloom.exports.foxglove import write_foxglove
from wayloom.exports.geojson import write_geojson
from wayloom.exports.geopackage import write_geopackage
from wayloom.exports.geoparquet import write_feature_parquet, write_point_parquet
from wayloom.exports.las import MOST_VLR_BYTES, Projection, projection_at
from wayloom.exports.laz import write_laz
from wayloom.exports.ply import write_ply
from wayloom.exports.points import map_batches
from wayloom.exports.provenance import cut_to
from wayloom.exports.qgis import write_qgis
from wayloom.exports.rerun import write_rerun
from wayloom.exports.source import MapSource
from wayloom.exports.tileset_folder import write_tile_folder, write_tileset
from wayloom.files.atomic import write_atomically
from wayloom.geodesy.antimeridian import Box
from wayloom.geodesy.geoid import GeoidGrid

POINTS: Final = "points"


@dataclass(frozen=True)
class Export:
    """One export.

    box     that it is cut to; None: all
    layers  which are asked for, of `ExportFormat.layers`; none: the format's usual ones
    geoid   heights are above it, where the format can tell
    """

    source: MapSource
    out: Path
    box: Box | None = None
    layers: tuple[str, ...] = ()
    geoid: GeoidGrid | None = None
    progress: Progress = silent

    @cached_property
    def provenance(self) -> dict[str, Any]:
        """That of the map, and the box."""
        return cut_to(self.source.provenance(), self.box)

    def layer(self, usual: str) -> str:
        """The one layer that is asked for. Raises InputError for several."""
        if len(self.layers) > 1:
            raise InputError(f"holds one layer, not {', '.join(self.layers)}", file=self.out, remedy="export them one by one")
        return self.layers[0] if self.layers else usual


@dataclass(frozen=True, slots=True)
class ExportFormat:
    """A format.

    suffixes : of the file names that it is guessed from, the longest counts
    about    : a few words
    layers   : what can be asked for
    write    : writes it; what was written, in words
    geoid    : whether its heights can be above one
    """

    suffixes: tuple[str, ...]
    about: str
    layers: tuple[str, ...]
    write: Callable[[Export], str]
    geoid: bool = False


Batches = Callable[[Path, Any, Projection, Mapping[str, Any]], int]


def _cloud(write: Batches) -> Callable[[Export], str]:
    """A writer of LAS points. Provenance that does not fit into the file lies beside it."""

    def export(job: Export) -> str:
        projection = projection_at(job.source.place, job.source.frame, job.geoid)
        count = write(job.out, _checked(job), projection, job.provenance)
        if len(json.dumps(job.provenance)) > MOST_VLR_BYTES:
            _write_beside(job)
        return f"{count} points"

    return export


def _ply(job: Export) -> str:
    count = write_ply(job.out, _checked(job), job.source.place, job.source.frame)
    _write_beside(job)
    return f"{count} points"


def _checked(job: Export) -> Any:
    return map_batches(job.source, job.box, job.progress)


def _write_beside(job: Export) -> None:
    write_atomically(job.out.with_name(f"{job.out.name}.json"), json.dumps(job.provenance, indent=1).encode())


Features = Callable[[Path, MapSource, Box | None, Sequence[str], Mapping[str, Any], Progress], dict[str, int]]


def _features(write: Features) -> Callable[[Export], str]:
    def export(job: Export) -> str:
        counts = write(job.out, job.source, job.box, job.layers, job.provenance, job.progress)
        return ", ".join(f"{count} {name}" for name, count in counts.items())

    return export


def _parquet(job: Export) -> str:
    if job.layers == (POINTS,):
        return f"{write_point_parquet(job.out, _checked(job), job.source.frame, job.provenance)} points"
    return _features(write_feature_parquet)(job)


def _archive(job: Export) -> str:
    layer = job.layer(VECTOR)
    return f"{write_archive(job.out, job.source, job.box, layer, job.provenance)} tiles of {layer}"


def _cog(job: Export) -> str:
    layer = job.layer(ORTHO)
    width, height = write_ground_cog(job.out, job.source, job.box, layer, job.provenance)
    return f"{layer} of {width} x {height} pixels"


def _picture(job: Export) -> str:
    return write_city_picture(job.out, job.source, job.box, job.provenance)


def _tileset(job: Export) -> str:
    return f"{write_tileset(job.out, job.source, job.box, job.provenance)} tiles"


def _tiles(job: Export) -> str:
    return f"{write_tile_folder(job.out, job.source, job.box, job.provenance)} tiles"


def _recording(write: Callable[[Path, MapSource, Box | None, Mapping[str, Any]], int], what: str) -> Callable[[Export], str]:
    return lambda job: f"{write(job.out, job.source, job.box, job.provenance)} {what}"


EXPORT_FORMATS: Final = {
    "laz": ExportFormat((".laz",), "points, LAS 1.4 in UTM", (POINTS,), _cloud(write_laz), geoid=True),
    "copc": ExportFormat((".copc.laz",), "points with levels of detail", (POINTS,), _cloud(write_copc), geoid=True),
    "ply": ExportFormat((".ply",), "points near a local origin", (POINTS,), _ply),
    "geojson": ExportFormat((".geojson", ".json"), "features", (*COLLECTIONS,), _features(write_geojson)),
    "gpkg": ExportFormat((".gpkg",), "features, one table each", (*COLLECTIONS,), _features(write_geopackage)),
    "qgis": ExportFormat((".qgz", ".qgs"), "a QGIS project with its GeoPackage", (*COLLECTIONS,), _features(write_qgis)),
    "parquet": ExportFormat((".parquet",), "features, or points", (*COLLECTIONS, POINTS), _parquet),
    "pmtiles": ExportFormat((".pmtiles",), "tiles of one kind", (*MEDIA_TYPES,), _archive),
    "3dtiles": ExportFormat((".3dtiles",), "points with levels of detail, a folder", (POINTS,), _tileset),
    "cog": ExportFormat((".tif", ".tiff"), "orthophoto or heights", (*UNITS_M,), _cog),
    "png": ExportFormat((".png",), "an overview with insets", (), _picture),
    "mcap": ExportFormat((".mcap",), "a recording for Foxglove", (), _recording(write_foxglove, "messages")),
    "rrd": ExportFormat((".rrd",), "a recording for Rerun", (), _recording(write_rerun, "drives")),
    "tiles": ExportFormat(("",), "all tiles, a folder", (), _tiles),
}


def format_of(out: Path, name: str | None) -> ExportFormat:
    """The format of this name, or, for None, the one that the file's name asks for. Raises UnknownFormatError."""
    known = ", ".join(EXPORT_FORMATS)
    if name is not None:
        if name not in EXPORT_FORMATS:
            what, remedy = f"{name} is no format that is written", f"known are {known}"
            raise UnknownFormatError(what, file=out, record="--format", remedy=remedy)
        return EXPORT_FORMATS[name]
    fitting = [
        (len(suffix), one) for one in EXPORT_FORMATS.values() for suffix in one.suffixes if suffix and out.name.endswith(suffix)
    ]
    if fitting:
        return max(fitting, key=lambda item: item[0])[1]
    if not out.suffix:
        return EXPORT_FORMATS["tiles"]
    suffixes = [suffix for one in EXPORT_FORMATS.values() for suffix in one.suffixes if suffix]
    likely = difflib.get_close_matches(out.suffix, suffixes, n=1)
    remedy = f"{f'did you mean {likely[0]}? ' if likely else ''}give --format, one of {known}"
    raise UnknownFormatError(f"{out.suffix} is no format that is written", file=out, remedy=remedy)


def checked_format(out: Path, name: str | None, layers: Sequence[str] = (), above_geoid: bool = False) -> ExportFormat:
    """`format_of`, once it is known that the format can hold what is asked for. Raises UnknownFormatError, InputError."""
    form = format_of(out, name)
    for layer in layers:
        if layer not in form.layers:
            known = ", ".join(form.layers) or "none"
            what, remedy = f"{layer} is no layer that this format holds", f"known are {known}"
            raise InputError(what, file=out, record="--layers", remedy=remedy)
    if above_geoid and not form.geoid:
        raise InputError("states no heights above a geoid", file=out, remedy="write a .laz, or leave --geoid away")
    return form


def export_map(job: Export, name: str | None = None) -> str:
    """Write a map in the format of this name, or the one that the file's name asks for; what was written, in words.

    Raises UnknownFormatError, InputError for what the format cannot hold, OSError that names the file.
    """
    return checked_format(job.out, name, job.layers, job.geoid is not None).write(job)
