"""Table of bounds: what is asked of one globally consistent drive beside what the benchmark measured, with verdicts."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

Row = tuple[str, str, str, bool, str]
"""What, bound, measured, whether it is met, and why not."""
FIRST_TABLE = (
    "clock 50 ms late", "clock 50 ms late, straight at 15 m/s", "lever arm not given", "lever arm not given, straight at 10 m/s",
    "1 km, two outages, bursts of 8 and 15 m", "last third shifted by 1.5 m", "float, last 40 % shifted by 100 m",
    "single point that claims 2 cm",
)  # fmt: skip
"""The cases in which a drive was off by much more than it said."""
GAP = "a burst of 20 s is a gap of 20 s, over which this odometry errs by as much with the wrong fixes known"


def bounds_table(numbers: Mapping[str, Any]) -> str:
    """Markdown: a row for each bound, from benchmarks/georeference.json."""
    lines = ["| what | bound | measured | verdict |", "| --- " * 4 + "|"]
    for what, bound, measured, met, why in [*_long(numbers), *_cases(numbers), *_others(numbers)]:
        lines.append(f"| {what} | {bound} | {measured} | {'met' if met else f'**missed**: {why}'} |")
    return "\n".join(lines) + "\n"


def _long(numbers: Mapping[str, Any]) -> Iterator[Row]:
    long = {row["name"]: row for row in numbers["long"]}
    for name, bound_m in (("RTK, outside outages", 0.05), ("RTK, inside outages of 30 s", 0.3)):
        error_m = float(np.hypot(long[name]["level_m"], long[name]["height_m"]))
        yield f"5 km: {name}", f"{bound_m:g} m", f"{error_m:.3f} m", error_m <= bound_m, "see the parts, level and in height, below"
    single = long["single point"]
    known = [row for row in numbers["bound"] if "odometry as made" in row["name"]]
    error_m, sigma_m = (float(np.mean([row[key] for row in known])) for key in ("level_m", "level_sigma_m"))
    why = f"one who knows all noise is {error_m:.2f} m off, {sigma_m:.2f} m stated (`--only bound`)"
    yield "5 km: single point, level", "0.5 m", f"{single['level_m']:.2f} m", single["level_m"] <= 0.5, why


def _cases(numbers: Mapping[str, Any]) -> Iterator[Row]:
    both = [*numbers["cases"], *numbers["fresh"]]
    first = [row for row in both if row["name"] in FIRST_TABLE]
    yield _within("the drives that were off by much more than they said", first)
    for kind in ("constant", "wandering"):
        bursts = [row for row in both if row["name"].startswith("bursts") and row["name"].endswith(kind)]
        large = [row for row in bursts if float(row["name"].split()[1]) >= 2.0]
        for short in (True, False):
            rows = [row for row in large if ("20 s" not in row["name"]) == short]
            length, worst_m = "4 and 10 s" if short else "20 s", max(row["worst_rms_m"] for row in rows)
            what = f"RTK, bursts of 2 to 50 m, {length}, {kind}: error rms, worst drive"
            yield what, "0.1 m", f"{worst_m:.3f} m", worst_m <= 0.1, GAP
        yield _within(f"RTK, bursts of 0.5 to 50 m, 4 to 20 s, {kind}", bursts)
    yield _within("ramps to 1, 3 and 15 m over 8 s", [row for row in both if row["name"].startswith("ramp")])
    yield _within("all cases", both)


def _within(what: str, rows: Iterable[Mapping[str, Any]]) -> Row:
    """Every error within three stated sigmas."""
    rows = list(rows)
    drives, beyond, ratio = (
        sum(row["seeds"] for row in rows),
        sum(row["beyond"] for row in rows),
        max(row["ratio"] for row in rows),
    )
    named = ", ".join(sorted({row["name"] for row in rows if row["beyond"]}))
    measured = f"{beyond} of {drives} drives beyond, at worst {ratio:.1f} sigmas"
    return f"{what}: every error", "3 stated sigmas", measured, beyond == 0, named


def _others(numbers: Mapping[str, Any]) -> Iterator[Row]:
    nees, ratios = (np.array([row[key] for row in numbers["random"]]) for key in ("nees", "ratio"))
    mean = float(np.nanmean(nees))
    yield f"{len(nees)} random drives, unseen: mean NEES / 3", "0.7 to 1.4", f"{mean:.2f}", 0.7 <= mean <= 1.4, "too careful"
    beyond = int((ratios > 3.0).sum())
    yield "the same: every error", "3 stated sigmas", f"{beyond} beyond, at worst {np.nanmax(ratios):.1f}", beyond == 0, "by chance"
    wheel = numbers["wheel"]
    yield "smartLoc, median", "8 m", f"{wheel['median_m']:.1f} m", wheel["median_m"] <= 8.0, "street canyons"
    yield "smartLoc, every error", "3 stated sigmas", f"{wheel['ratio']:.1f}", wheel["ratio"] <= 3.0, "street canyons"
    found = numbers["receiver"]
    clock_ms, level_m, height_m = 1e3 * found["clock_s"], found["lever_level_m"], found["lever_height_m"]
    yield "clock 50 to 200 ms late, drives that turn: worst error", "10 ms", f"{clock_ms:.1f} ms", clock_ms <= 10.0, "noise"
    yield "lever arm not given, drives that turn: worst, level", "0.1 m", f"{level_m:.2f} m", level_m <= 0.1, "noise"
    unknown = "a flat road does not tell how high an antenna is; within its sigma"
    yield "the same in height", "0.1 m", f"{height_m:.2f} m", height_m <= 0.1, unknown
