"""`wayloom export`: submaps of one drive or many, merged into one cloud, picture or folder of tiles."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wayloom.errors import InputError, UnknownFormatError

if TYPE_CHECKING:
    from wayloom.geodesy.geoid import GeoidGrid
    from wayloom.ground.placed_sheet import PlacedSheet
    from wayloom.stitching.voxel_map import VoxelMap
    from wayloom.submaps.submap import PlacedSubmap

HELD_SHEETS = 48
SUBMAP_FOLDERS = (".", "submaps", "stages/submaps")
KNOWN = ".laz, .ply, .png, .geojson (markings and kerbs), or a name without suffix for a folder of tiles"


def export_command(
    folders: Annotated[list[Path], typer.Argument(help="Folders of submaps, or folders that `wayloom process` wrote.")],
    out: Annotated[Path, typer.Option(help=f"File or folder to write: {KNOWN}.")],
    voxel: Annotated[float, typer.Option(min=0.01, max=10.0, help="Edge of a voxel of the merged map, m.")] = 0.1,
    geoid: Annotated[Path | None, typer.Option(help="Geoid grid (.gtx, .tif): a LAZ states heights above it.")] = None,
) -> None:
    """Merge submaps into the static map, and write it as LAZ, PLY, a picture from above, or XYZ tiles; or markings and kerbs of the
    merged ground as GeoJSON."""
    if out.suffix not in ("", ".laz", ".ply", ".png", ".geojson"):
        raise UnknownFormatError(f"{out.suffix} is no format that is written", file=out, remedy=f"known are {KNOWN}")
    from wayloom.geodesy.geoid import GeoidGrid
    from wayloom.stitching.merge import merge
    from wayloom.stitching.settings import MergeSettings
    from wayloom.submaps.files import load_submaps

    if geoid is not None and out.suffix != ".laz":
        raise InputError("states no heights above a geoid", file=out, remedy="write a .laz, or leave --geoid away")
    grid = None if geoid is None else GeoidGrid(geoid)
    if out.suffix == ".geojson":
        typer.echo(_write_markings(folders, out))
        return
    placed = [item for folder in folders for item in load_submaps(submap_folder(folder))]
    voxel_map = merge(placed, MergeSettings(voxel_m=voxel))
    written = _write(voxel_map, placed, out, grid)
    typer.echo(f"{len(voxel_map)} voxels of {len(placed)} submaps and {len({p.drive_id for p in placed})} drives: {written}")


def submap_folder(folder: Path) -> Path:
    """The folder with `index.json` in or under a folder. Raises InputError when there is none."""
    for name in SUBMAP_FOLDERS:
        if (folder / name / "index.json").is_file():
            return folder / name
    raise InputError("holds no submaps", file=folder, remedy="give the folder that `wayloom process` wrote")


def _write_markings(folders: list[Path], out: Path) -> str:
    """Write the markings and kerbs of the merged ground of all drives; what was written, in words."""
    from wayloom.files.atomic import write_atomically
    from wayloom.stitching.drive_markings import markings_of_sheets
    from wayloom.stitching.marking_files import encode_features
    from wayloom.submaps.files import load_submaps

    places = [(submap_folder(folder), item) for folder in folders for item in load_submaps(submap_folder(folder))]
    frame = places[0][1].frame if places else None
    if frame is None or any(item.frame != frame for _, item in places):
        raise InputError(
            "has no place on Earth, or not that of the others", file=folders[0], remedy="give drives of one map with GNSS"
        )
    features = markings_of_sheets(_placed_sheets(places), frame)
    write_atomically(out, encode_features(features))
    kerbs = sum(one["properties"]["kind"] == "kerb" for one in features)
    return f"{len(features) - kerbs} markings and {kerbs} kerbs of {len({item.drive_id for _, item in places})} drives: {out}"


def _placed_sheets(places: "list[tuple[Path, PlacedSubmap]]") -> "list[PlacedSheet]":
    """The ground sheets beside the folders of submaps, where these lie. Raises InputError for a folder without."""
    from functools import lru_cache, partial

    from wayloom.ground.files import load_sheet, read_index
    from wayloom.ground.placed_sheet import PlacedSheet

    load, found = lru_cache(HELD_SHEETS)(load_sheet), []
    indices = {submaps: read_index(submaps.parent / "ground") for submaps in dict.fromkeys(submaps for submaps, _ in places)}
    for submaps, item in places:
        digest = indices[submaps].get(item.submap.digest)
        if digest is not None:
            read = partial(load, submaps.parent / "ground", digest)
            found.append(PlacedSheet(item.drive_id, digest, read, item.T_enu_submap, item.covariance))
    return found


def _write(voxel_map: "VoxelMap", placed: list["PlacedSubmap"], out: Path, geoid: "GeoidGrid | None") -> str:
    """Write in the format that the suffix names; what was written, in words."""
    from wayloom.tiles import exports
    from wayloom.tiles.pyramid import tracks_of

    points, labels, frame = voxel_map.points_enu, voxel_map.label, voxel_map.frame
    if out.suffix == ".laz":
        exports.export_laz(out, points, labels, frame, geoid)
    elif out.suffix == ".ply":
        exports.export_ply(out, points, labels, frame)
    elif out.suffix == ".png":
        exports.export_preview(out, points, labels, frame, tuple(track.points_enu for track in tracks_of(placed)))
    else:
        return f"{exports.export_tiles(out, voxel_map, tracks_of(placed))} tiles in {out}"
    return str(out)
