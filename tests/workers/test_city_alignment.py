"""Drives that meet are joined when the map is stitched: in every order of arrival alike, and until one of them goes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loops.made_drives import there
from registration.made_streets import made_street
from stitching.made_placed_drives import made_drive
from wayloom.config.gate import gate_of
from wayloom.geometry import se3
from wayloom.georeference.uncertainty import moved_covariance
from wayloom.places.files import save_places
from wayloom.stitching.placed_drive import PlacedDrive
from wayloom.store import drives, gate, map_versions, maps, meetings
from wayloom.store.jobs import new_job
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.submaps.files import save_submaps
from wayloom.submaps.submap import StepBefore
from wayloom_workers.city_alignment import rounded_covariance, rounded_place
from wayloom_workers.completion import complete_drive
from wayloom_workers.stage_hooks import WorkerContext
from wayloom_workers.submap_rows import submap_row
from workers.conftest import NewService
from workers.test_stitching import newest, published

STREET = made_street(0)
WAYS = {"one": there(30.0, 130.0), "two": there(60.0, 170.0), "three": there(20.0, 110.0)}
SEEDS = {"one": 1, "two": 2, "three": 3}


@pytest.fixture(scope="module")
def made() -> dict[str, PlacedDrive]:
    return {name: made_drive(name, STREET, way, SEEDS[name]) for name, way in WAYS.items()}


def add(context: WorkerContext, drive: PlacedDrive, grade: str | None = "A", sound: bool = True) -> str:
    """A processed drive of a grade, with what its stages left: it asks for the map as its last stage does."""
    with context.database.write() as session:
        manifest = Manifest(name=drive.drive_id, files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive_id = drives.register(session, manifest, "city")[0].id
        stages = context.folders.drive(drive_id) / "stages"
        for stage in ("places", "submaps"):
            (stages / stage / "key").mkdir(parents=True)
            session.add(new_job(stage, 0.0, state="done", drive_id=drive_id, position=0, payload={"key": "key"}))
        save_places(drive.places, stages / "places" / "key" / "drive.places")
        save_submaps(drive.submaps, stages / "submaps" / "key")
        for item in drive.submaps:
            context.blobs.put(item.submap.encoded)
        maps.place_submaps(session, drive_id, [submap_row(drive_id, "city", i, item) for i, item in enumerate(drive.submaps)])
        drives.get(session, drive_id).placed = drive.is_located
        gate.judge(session, drive_id, grade, ["why"], gate_of(grade, sound=sound), sound)
        complete_drive(session, drive_id)
    return drive_id


def places(context: WorkerContext) -> dict[str, np.ndarray]:
    """T_enu_submap (n, 4, 4) of each drive, by its name."""
    with context.database.read() as session:
        rows = maps.submaps(session, "city")
        found: dict[str, list[tuple[int, list[list[float]]]]] = {}
        for row in rows:
            found.setdefault(drives.get(session, row.drive_id).name, []).append((row.position, row.T_enu_submap))
    return {name: np.array([T for _, T in sorted(items)]) for name, items in found.items()}


def apart(one: np.ndarray, other: np.ndarray, names: tuple[str, str], made: dict[str, PlacedDrive]) -> float:
    """m rms: by how much the second drive lies elsewhere against the first than in truth."""
    ways = [
        WAYS[name][[int(item.submap.keyframe_frame[len(item.submap.keyframe_frame) // 2]) for item in made[name].submaps]]
        for name in names
    ]
    errors = []
    for i in range(len(one)):
        for j in range(len(other)):
            truth, found = se3.inverse(ways[0][i]) @ ways[1][j], se3.inverse(one[i]) @ other[j]
            errors.append(np.linalg.norm(truth[:3, 3] - found[:3, 3]))
    return float(np.sqrt(np.mean(np.square(errors))))


def test_drives_that_meet_are_joined_and_every_order_of_arrival_gives_the_same_bits(
    context: WorkerContext, new_service: NewService, tmp_path: Path, made: dict[str, PlacedDrive]
) -> None:
    for name in ("one", "two", "three"):
        add(context, made[name])
    own = places(context)
    at_once = published(context, tmp_path / "1")
    joined = places(context)
    for names in (("one", "two"), ("one", "three")):
        before = apart(own[names[0]], own[names[1]], names, made)
        after = apart(joined[names[0]], joined[names[1]], names, made)
        assert before > 0.5
        assert after < 0.35 * before
    with context.database.read() as session:
        facts = maps.version(session, "city").facts["aligned"]
    assert facts["meetings"] > 2
    assert max(facts["moved_m"].values()) > 0.3

    other = new_service(tmp_path / "other")
    for name in ("three", "one", "two"):
        add(other, made[name])
        one_by_one = published(other, tmp_path / f"2{name}")
    assert one_by_one == at_once


def test_a_drive_that_goes_leaves_the_places_that_there_would_be_without_it(
    context: WorkerContext, tmp_path: Path, made: dict[str, PlacedDrive]
) -> None:
    add(context, made["one"])
    alone = published(context, tmp_path / "1")
    own = places(context)
    gone = add(context, made["two"])
    published(context, tmp_path / "2")
    assert not np.array_equal(places(context)["one"], own["one"])
    with context.database.write() as session:
        drives.request_removal(session, gone)
    assert published(context, tmp_path / "3") == alone
    with context.database.write() as session:
        drives.delete_rows(session, gone)
    assert published(context, tmp_path / "4") == alone
    assert np.array_equal(places(context)["one"], own["one"])
    with context.database.read() as session:
        assert meetings.of_drives(session, "city", [gone]) == []


def stiff(drive: PlacedDrive) -> PlacedDrive:
    """The drive with submaps that its own graph holds together as one."""
    first, *others = drive.submaps
    told = [replace(item, before=StepBefore((1.0 - 1e-9) * item.covariance, True)) for item in others]
    return PlacedDrive(drive.drive_id, drive.places, (first, *told))


def test_what_a_drive_tells_of_neighbouring_submaps_holds_them_together(
    context: WorkerContext, new_service: NewService, tmp_path: Path, made: dict[str, PlacedDrive]
) -> None:
    def bent(service: WorkerContext, folder: str) -> float:
        own = places(service)["two"]
        published(service, tmp_path / folder)
        joined = places(service)["two"]
        steps = [se3.inverse(T[:-1]) @ T[1:] for T in (own, joined)]
        return float(np.abs(steps[0] - steps[1])[:, :3, 3].max())

    for name in ("one", "two"):
        add(context, made[name])
    derived = bent(context, "1")
    other = new_service(tmp_path / "told")
    for name in ("one", "two"):
        add(other, stiff(made[name]))
    told = bent(other, "2")
    assert derived > 0.01
    assert told < 0.002  # places are rounded to a millimetre


def test_a_pair_is_registered_once(context: WorkerContext, tmp_path: Path, made: dict[str, PlacedDrive], monkeypatch) -> None:
    from wayloom_workers import drive_pairs

    compared: list[tuple[str, str]] = []
    real = drive_pairs.find_meetings

    def counted(one, other, settings):
        compared.append((one.drive_id, other.drive_id))
        return real(one, other, settings)

    monkeypatch.setattr(drive_pairs, "find_meetings", counted)
    add(context, made["one"])
    published(context, tmp_path / "1")
    add(context, made["two"])
    published(context, tmp_path / "2")
    assert len(compared) == 1
    add(context, made["three"])
    published(context, tmp_path / "3")
    assert len(compared) == 3
    before = newest(context)
    published(context, tmp_path / "4")
    assert newest(context) == before
    assert len(compared) == 3


def test_a_drive_whose_files_are_gone_stays_where_its_own_geo_reference_put_it(
    context: WorkerContext, tmp_path: Path, made: dict[str, PlacedDrive]
) -> None:
    add(context, made["one"])
    second = add(context, made["two"])
    (context.folders.drive(second) / "stages" / "places" / "key" / "drive.places").unlink()
    own = places(context)
    published(context, tmp_path / "1")
    assert all(np.array_equal(places(context)[name], own[name]) for name in own)


def test_rounded_places_and_covariances_are_near_what_they_round_and_stay_when_rounded_again() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        own = se3.exp(rng.normal(0.0, 1.0, 6))
        T = se3.exp(rng.normal(0.0, 0.01, 6)) @ own
        rounded = rounded_place(T, own)
        assert np.abs(rounded[:3, 3] - T[:3, 3]).max() <= 0.5e-3 + 1e-12
        assert np.abs(se3.log(rounded @ se3.inverse(T))[3:]).max() < 2e-5
        assert np.allclose(rounded_place(rounded, own), rounded, atol=1e-12)
        root = rng.normal(0.0, 0.1, (6, 6))
        covariance = root @ root.T + 1e-4 * np.eye(6)
        near = rounded_covariance(covariance, np.eye(4))
        assert (np.linalg.eigvalsh(near) > 0).all()
        ratio = np.sqrt(np.diag(near) / np.diag(covariance))
        assert (ratio >= 0.99).all()
        assert (ratio <= 1.16).all()
        far = np.eye(4)
        far[:3, 3] = rng.normal(0.0, 3e4, 3)  # a frame's origin lies 50 km away, and every turn about it is a shift
        moved = moved_covariance(far, covariance[None])[0]
        assert np.allclose(moved_covariance(se3.inverse(far), rounded_covariance(moved, far)[None])[0], near, rtol=1e-3, atol=1e-5)


def test_the_stitch_of_a_map_without_changes_moves_nothing(
    context: WorkerContext, tmp_path: Path, made: dict[str, PlacedDrive]
) -> None:
    add(context, made["one"])
    add(context, made["two"])
    before = published(context, tmp_path / "1")
    assert published(context, tmp_path / "2") == before
    with context.database.read() as session:
        assert map_versions.changed_drives(session, "city") == []
