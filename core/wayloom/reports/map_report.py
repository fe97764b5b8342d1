"""Map report: one self-contained page of a map with its overview, three views of its cloud, drives, classes and objects."""

import tempfile
from collections import Counter
from pathlib import Path
from typing import Any, Final

import jinja2
import numpy as np

from wayloom import __version__
from wayloom.config.classes import CLASS_COUNT, CLASS_NAMES, PALETTE
from wayloom.config.progress import Progress, silent
from wayloom.evaluation.trajectory import path_length
from wayloom.exports.city_picture import write_city_picture
from wayloom.exports.features import read_collection
from wayloom.exports.source import MapSource
from wayloom.files.atomic import write_atomically
from wayloom.geodesy.antimeridian import Box
from wayloom.pipeline.drive_map import read_image
from wayloom.rendering.scene import scene_of_map
from wayloom.reports import views
from wayloom.reports.drive_report import Picture, data_uri, number, thousands
from wayloom.reports.triple import scene_views

OVERVIEW_WIDTH_PX: Final = 2000
SCENE, FEATURES = 0.8, 0.9


def write_map_report(source: MapSource, out: Path, title: str, box: Box | None = None, progress: Progress = silent) -> str:
    """Write the page; what it shows, in words. Legends and tables list what is there alone.

    Raises InputError where there is nothing to show, OSError.
    """
    scene = scene_of_map(source, box, lambda share, what: progress(SCENE * share, what))
    progress(SCENE, "drawing")
    shown = {
        "overview": _overview(source, box),
        "views": [Picture(data_uri(views.jpeg_bytes(image), "jpeg"), words) for words, image in scene_views(scene).items()],
    }
    progress(FEATURES, "counting")
    facts = map_facts(source, scene.label, box)
    write_atomically(out, _page(title, facts, shown).encode())
    progress(1.0, "written")
    return f"{len(facts['drives'])} drives, {len(scene)} points"


def map_facts(source: MapSource, labels: np.ndarray[Any, np.dtype[np.uint8]], box: Box | None = None) -> dict[str, Any]:
    """Drives with their road in m, longest first; points of each class; features of each kind, and kerbs.

    labels : (N,) train ids of the map's points
    """
    road: dict[str, float] = {}
    for track in source.tracks():
        road[track.drive_id] = road.get(track.drive_id, 0.0) + path_length(track.points_enu)
    counts = np.bincount(labels, minlength=256)[:CLASS_COUNT]
    most = max(int(counts.max()), 1)
    classes = [
        {
            "name": CLASS_NAMES[i], "colour": f"#{PALETTE[i].tobytes().hex()}", "points": int(counts[i]),
            "width": 100.0 * int(counts[i]) / most,
        }
        for i in np.argsort(-counts, kind="stable").tolist() if counts[i]
    ]  # fmt: skip
    return {
        "wayloom": __version__,
        "drives": [{"id": name, "road_m": road[name]} for name in sorted(road, key=lambda name: (-road[name], name))],
        "road_m": sum(road.values()),
        "points": len(labels),
        "voxel_m": source.voxel_m,
        "classes": classes,
        "things": _things(source, box),
        "doubts": {name: list(words) for name, words in sorted(source.doubts().items())},
        "origin": None if source.frame is None else {"lon": source.frame.lon_deg, "lat": source.frame.lat_deg},
    }


def _things(source: MapSource, box: Box | None) -> list[tuple[str, int]]:
    """How many there are of each kind of object and marking, and of kerbs; a drive's own frame has none."""
    if source.frame is None:
        return []
    counted: Counter[str] = Counter()
    for name in ("objects", "markings", "kerbs"):
        for feature in read_collection(name, source, box):
            counted[str(feature["properties"].get("kind", name)).replace("_", " ")] += 1
    return counted.most_common()


def _overview(source: MapSource, box: Box | None) -> Picture:
    """The picture of `wayloom export --out NAME.png`."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "overview.png"
        words = write_city_picture(file, source, box, {})
        image = views.shrunk(read_image(file), OVERVIEW_WIDTH_PX)
    return Picture(data_uri(views.jpeg_bytes(image), "jpeg"), words)


def _page(title: str, facts: dict[str, Any], shown: dict[str, Any]) -> str:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("wayloom.reports"), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True
    )
    environment.filters |= {"number": number, "thousands": thousands}
    return environment.get_template("map.html.j2").render(title=title, facts=facts, shown=shown)
