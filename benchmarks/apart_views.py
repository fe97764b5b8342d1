"""Views of different cities, each falsely put where the other is: how many registrations are taken; all would be false.

    python benchmarks/apart_views.py CITY=OUT [CITY=OUT ...] [--pairs N] [--spacing M] [--write NAME]

OUT is what `wayloom process` left of a drive, CITY a name that drives of one city share. Views so far apart along the road are
compared with those of drives of other cities, one pair of drives after the other, until there are so many pairs. A pair's prior
puts the one view within some metres of the other, with its direction or against it, as sure of that as a metre and a degree: no
place or appearance has to find it first. The placements are drawn anew for each pair. Agreement between neighbours, which a meeting
needs beside, is not asked for.
"""

import argparse
import os
import sys
import time
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy loads its BLAS
    os.environ.setdefault(name, "1")
ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "core"))

import numpy as np  # noqa: E402

from pages import DOCS, put_between_marks  # noqa: E402
from wayloom.geometry import se3  # noqa: E402
from wayloom.places.files import load_places  # noqa: E402
from wayloom.places.road import road_m, spaced  # noqa: E402
from wayloom.places.views import LOOK_AHEAD_M, view_at  # noqa: E402
from wayloom.registration.register import Prior, register_scenes  # noqa: E402
from wayloom.registration.scene import Scene, prepare  # noqa: E402
from wayloom.stitching.meeting_settings import MeetingSettings  # noqa: E402

PAGE = DOCS / "benchmarks" / "meetings.md"
SETTINGS = MeetingSettings().registration
COVARIANCE = np.diag([1.0] * 3 + [np.deg2rad(1.0) ** 2] * 3)
ALONG_M, ACROSS_M = 8.0, 1.0
"""Spread of the placements."""
HEAD = """| cities | pairs of drives | pairs of views | fit | CPU s |
| --- | --- | --- | --- | --- |"""


@dataclass
class Tally:
    """Of two cities: pairs of drives and of views, those that fit."""

    drives: int = 0
    views: int = 0
    fit: int = 0
    seconds: float = 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drives", nargs="+", metavar="CITY=OUT")
    parser.add_argument("--pairs", type=int, default=10_000)
    parser.add_argument("--spacing", type=float, default=24.0)
    parser.add_argument("--write", metavar="NAME", help="put the table between the marks of this name on the page")
    options = parser.parse_args()
    named = [one.partition("=")[::2] for one in options.drives]
    tallies = compared([(city, Path(out)) for city, out in named], options.pairs, options.spacing)
    text = "\n".join([HEAD, *(row(cities, tally) for cities, tally in sorted(tallies.items())), row(("all", ""), total(tallies))])
    print(text)
    if options.write:
        put_between_marks(PAGE, options.write, text)


def compared(drives: list[tuple[str, Path]], wanted: int, spacing_m: float) -> dict[tuple[str, str], Tally]:
    """By cities. Pairs of drives are taken in a drawn order, so that fewer pairs of views are of all cities too."""
    pairs = [(a, b) for a, b in combinations(drives, 2) if a[0] != b[0]]
    rng = np.random.default_rng(0)
    tallies: dict[tuple[str, str], Tally] = {}
    for k in rng.permutation(len(pairs)).tolist():
        if sum(tally.views for tally in tallies.values()) >= wanted:
            break
        (city_a, out_a), (city_b, out_b) = pairs[k]
        began = time.process_time()
        fits = [fit(a, b, rng) for a in scenes(out_a, spacing_m) for b in scenes(out_b, spacing_m)]
        tally = tallies.setdefault((min(city_a, city_b), max(city_a, city_b)), Tally())
        tally.drives, tally.views, tally.fit = tally.drives + 1, tally.views + len(fits), tally.fit + sum(fits)
        tally.seconds += time.process_time() - began
        print(out_a, out_b, len(fits), sum(fits), flush=True)
    return tallies


@lru_cache(64)
def scenes(out: Path, spacing_m: float) -> list[Scene]:
    """Prepared views of a drive, so far apart along its road."""
    places = load_places(out / "stages" / "places" / "drive.places")
    rows = np.flatnonzero(spaced(road_m(places.T_world_keyframe), places.segment, spacing_m))
    return [prepare(view_at(places, int(i)), SETTINGS) for i in rows]


def fit(a: Scene, b: Scene, rng: np.random.Generator) -> bool:
    """Whether b is registered to a, put near it."""
    yaw = rng.choice([0.0, np.pi]) + np.deg2rad(rng.normal())
    T = np.eye(4)
    T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    T[:2, 3] = rng.normal(0.0, (ACROSS_M, ALONG_M))
    if yaw > 1.0:  # against it: the two look at one place from both ends
        T[1, 3] += 2.0 * LOOK_AHEAD_M
    Ad = se3.adjoint(se3.from_rotation_translation(np.eye(3), T[:3, 3]))
    return not register_scenes(a, b, Prior(T, Ad @ COVARIANCE @ Ad.T), SETTINGS).refused


def total(tallies: dict[tuple[str, str], Tally]) -> Tally:
    each = list(tallies.values())
    return Tally(*(sum(getattr(one, name) for one in each) for name in Tally.__dataclass_fields__))


def row(cities: tuple[str, str], tally: Tally) -> str:
    return f"| {', '.join(filter(None, cities))} | {tally.drives} | {tally.views} | {tally.fit} | {tally.seconds:.0f} |"


if __name__ == "__main__":
    main()
