"""Points of persons and riders reach no blob, tile, answer or export of a drive that saw many."""

import re
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import laspy
import numpy as np
import pytest

from submaps.made_submaps import NamedLog, made_geo, made_labels, made_odometry
from wayloom.config.classes import CLASS_ID, PALETTE, PERSONS
from wayloom.pipeline.drive_map import drive_map
from wayloom.pipeline.exports import _write_clouds
from wayloom.pipeline.settings import WayloomSettings
from wayloom.segmentation.overlay import overlay, without_persons
from wayloom.stitching.region_files import decode_region
from wayloom.store import drives, gate, maps
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.tables.maps import TileRow
from wayloom.submaps.settings import SubmapSettings
from wayloom.submaps.split import make_submaps
from wayloom.submaps.submap import PlacedSubmap, decode_submap
from wayloom_workers import production
from wayloom_workers.stage_hooks import WorkerContext
from wayloom_workers.submap_rows import submap_row
from workers.test_stitching import attempt, published

CAR = CLASS_ID["car"]


@pytest.fixture(scope="module")
def seen() -> tuple[object, object]:
    """A drive of 120 m, a third of whose points are persons and riders, and a tenth cars."""
    odometry = made_odometry(120.0, points_a_keyframe=60)
    labels = made_labels(len(odometry.points))
    label = labels.stereo.copy()
    label[::3], label[1::9], label[2::10] = PERSONS[0], PERSONS[1], CAR
    return odometry, replace(labels, baseline=label, mono=label, stereo=label)


def submaps(seen: tuple[object, object], keep_persons: bool = False) -> list[PlacedSubmap]:
    odometry, labels = seen
    settings = SubmapSettings(keep_persons=keep_persons)
    return list(make_submaps(NamedLog(), odometry, labels, made_geo(odometry), settings, "d" * 64))  # type: ignore[arg-type]


def in_map(context: WorkerContext, items: list[PlacedSubmap], folder: Path) -> None:
    """The drive, in the newest version."""
    with context.database.write() as session:
        manifest = Manifest(name="drive", files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive_id = drives.register(session, manifest, "city")[0].id
        for item in items:
            context.blobs.put(item.submap.encoded)
        maps.place_submaps(session, drive_id, [submap_row(drive_id, "city", k, item) for k, item in enumerate(items)])
        gate.judge(session, drive_id, "A", [], "merge")
    published(context, folder)


def shown_persons(context: WorkerContext) -> Iterator[str]:
    """Blobs that show or count persons, by their kind."""
    with context.database.read() as session:
        layers = {row.digest: row.layer for row in session.query(TileRow)}
    for digest in context.blobs.older_than(0.0):
        content = context.blobs.get(digest)
        if content.startswith(b"WLSUBMAP"):
            submap = decode_submap(content)
            if np.isin(submap.label, PERSONS).any() or np.isin(submap.vote_class, PERSONS).any():
                yield "submap"
        elif content.startswith(b"WLREGION"):
            for name, layer in decode_region(content).layers.items():
                if np.isin(layer.label, PERSONS).any() or layer.votes[:, list(PERSONS)].any():
                    yield f"region {name}"
        elif content.startswith(b"\x89PNG"):
            picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)[:, :, 2::-1]
            if any((picture == PALETTE[c]).all(axis=2).any() for c in PERSONS):
                yield f"tile {layers.get(digest)}"
        elif re.search(rb"\b(person|rider)\b", unpacked(content)):
            yield f"words of {layers.get(digest)}"


def unpacked(content: bytes) -> bytes:
    try:
        return zlib.decompress(content, 47)
    except zlib.error:
        return content


def test_no_blob_of_a_map_shows_a_person(context: WorkerContext, tmp_path: Path, seen: tuple[object, object]) -> None:
    items = submaps(seen)
    assert sum(item.submap.points_left_out["persons"] for item in items) > 500
    assert any((item.submap.label == CAR).any() for item in items)
    in_map(context, items, tmp_path / "1")
    assert len([*context.blobs.older_than(0.0)]) > 20
    assert [*shown_persons(context)] == []


def test_the_search_finds_persons_that_are_there_and_layers_never_have_them(
    context: WorkerContext, tmp_path: Path, seen: tuple[object, object]
) -> None:
    """Of submaps as they were cut before: the map was rid of points of persons then, and is of votes for them now."""
    in_map(context, submaps(seen, keep_persons=True), tmp_path / "1")
    assert {*shown_persons(context)} == {"submap"}


def test_products_of_one_drive_show_no_person_unless_they_are_asked_for(tmp_path: Path, seen: tuple[object, object]) -> None:
    for keep in (False, True):
        items, folder = submaps(seen, keep), tmp_path / str(keep)
        folder.mkdir()
        _write_clouds(items, folder, items[0].frame, None, {})
        classes = np.asarray(laspy.read(folder / "cloud.laz")["label"])
        assert np.isin(classes, PERSONS).any() == keep
        vertices = (folder / "cloud.ply").read_bytes()
        assert (b"\xdc\x14\x3c" in vertices) == keep
        picture = drive_map(made_geo(seen[0]), items)  # type: ignore[arg-type]
        assert any((picture == PALETTE[c]).all(axis=2).any() for c in PERSONS) == keep


def test_pictures_of_labels_paint_persons_over(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    image, labels = rng.integers(0, 256, (100, 500), np.uint8), np.zeros((100, 500), np.uint8)
    labels[40:60, 200:220], labels[70:80, 300:310] = PERSONS
    shown = without_persons(image, labels)
    assert (shown[36:64, 196:224][4:-4, 4:-4] == PALETTE[PERSONS[0]]).all()
    assert (shown[50, 197] == PALETTE[PERSONS[0]]).all()  # the margin of 4 px
    assert (shown[50, 190] == image[50, 190]).all()
    assert np.ptp(overlay(shown, labels)[45:55, 205:215].reshape(-1, 3), axis=0).max() == 0


def test_a_service_keeps_no_persons_whatever_its_settings_say(context: WorkerContext, tmp_path: Path) -> None:
    asked = WayloomSettings(data_dir=context.folders.root, submaps=SubmapSettings(keep_persons=True, length_m=60.0))
    with context.database.write() as session:
        manifest = Manifest(name="drive", files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive_id = drives.register(session, manifest, "city")[0].id
    of_drive = attempt(replace(context, settings=asked), "submaps", tmp_path)
    told = production._settings(replace(of_drive, claim=replace(of_drive.claim, drive_id=drive_id))).submaps
    assert (told.keep_persons, told.length_m) == (False, 60.0)


def test_what_is_asked_of_submaps_when_processing_anew_counts_but_for_persons(context: WorkerContext, tmp_path: Path) -> None:
    with context.database.write() as session:
        manifest = Manifest(name="drive", files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive = drives.register(session, manifest, "city")[0]
        drive.coming = {"asked": {"submaps": {"length_m": 60.0, "keep_persons": True}}, "since": 0.0, "facts": {}}
        drive_id = drive.id
    of_drive = attempt(context, "submaps", tmp_path)
    told = production._settings(replace(of_drive, claim=replace(of_drive.claim, drive_id=drive_id))).submaps
    assert (told.keep_persons, told.length_m) == (False, 60.0)
