"""Poses and points of a drive for its downloads: their memory is bounded, and what is gone is told before the first byte."""

import dataclasses
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from wayloom.errors import NotFoundError
from wayloom.store.blobs import BlobStore
from wayloom.submaps.submap import Submap
from wayloom_services.drive_points import DrivePoints
from wayloom_workers.submap_rows import submap_row
from workers.test_stitching import placed

POINTS = 20_000
DOWNLOADS: dict[str, Callable[[DrivePoints], int]] = {
    "poses": lambda points: len(points.trajectory()),
    "points": lambda points: sum(map(len, points.cloud()[1])),
}


def long_submap(submap: Submap) -> Submap:
    """With more points."""
    often = np.arange(POINTS) % len(submap.xyz)
    columns = {name: getattr(submap, name)[often] for name in ("xyz", "label", "variance", "grey", "seen_ns", "keyframe")}
    votes = {"vote_start": np.arange(POINTS + 1, dtype=np.uint32), "vote_class": columns["label"]}
    return dataclasses.replace(submap, **columns, **votes, vote_weight=np.full(POINTS, 0.1, np.float32))


def drive_of(blobs: BlobStore, count: int) -> DrivePoints:
    """So many submaps."""
    items = [placed("d" * 64, seed) for seed in range(count)]
    items = [dataclasses.replace(item, submap=long_submap(item.submap)) for item in items]
    for item in items:
        blobs.put(item.submap.encoded)
    return DrivePoints(blobs, [submap_row("d" * 64, "city", k, item) for k, item in enumerate(items)])


def peak_of(download: Callable[[DrivePoints], int], points: DrivePoints) -> int:
    tracemalloc.start()
    try:
        download(points)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("what", DOWNLOADS)
def test_a_download_of_a_long_drive_takes_no_more_memory_than_that_of_a_short_one(tmp_path: Path, what: str) -> None:
    points = drive_of(BlobStore(tmp_path), 24)
    short = peak_of(DOWNLOADS[what], DrivePoints(points.blobs, points.rows[:3]))
    assert peak_of(DOWNLOADS[what], points) < 1.5 * short


def test_the_length_that_is_told_is_that_of_the_bytes(tmp_path: Path) -> None:
    size, blocks = drive_of(BlobStore(tmp_path), 3).cloud()
    assert sum(map(len, blocks)) == size


@pytest.mark.parametrize("begin", [DrivePoints.trajectory, DrivePoints.cloud])
def test_a_submap_that_is_gone_is_told_before_the_first_byte(tmp_path: Path, begin: Callable[[DrivePoints], object]) -> None:
    points = drive_of(BlobStore(tmp_path), 2)
    points.blobs.delete(points.rows[1].digest)
    with pytest.raises(NotFoundError, match=points.rows[1].digest):
        begin(points)
