import dataclasses
import gc
import hashlib
import json
import weakref
from dataclasses import replace

import numpy as np
import pytest

from submaps.made_submaps import FRAME, NamedLog, made_geo, made_labels, made_odometry, random_submap
from wayloom.config.classes import CLASS_ID, PERSONS, SKY
from wayloom.errors import InputError, StageError
from wayloom.geometry import se3
from wayloom.georeference.types import Anchors
from wayloom.georeference.uncertainty import position_covariance
from wayloom.submaps.files import StoredSubmaps, load_submaps, save_submaps
from wayloom.submaps.settings import SubmapSettings
from wayloom.submaps.split import anchor_frames, make_submaps, split_road
from wayloom.submaps.submap import decode_submap


@pytest.fixture
def odometry():
    return made_odometry()


@pytest.fixture
def labels(odometry):
    return made_labels(len(odometry.points))


@pytest.fixture
def placed(odometry, labels):
    return list(make_submaps(NamedLog(), odometry, labels, made_geo(odometry)))


@pytest.mark.parametrize("road_m", [30, 60, 99, 101, 149, 151, 200, 524])
def test_submaps_are_50_to_100_metres_long_where_the_drive_is(road_m):
    odometry = made_odometry(road_m, points_a_keyframe=1)
    lengths = [stretch.length_m for stretch in split_road(odometry, SubmapSettings())]
    assert sum(lengths) == pytest.approx(odometry.keyframes.T_world_cam[-1, 2, 3])
    assert max(lengths) <= 100.0
    assert min(lengths) >= min(50.0, road_m - 1)


def test_a_loss_of_track_always_ends_a_submap():
    odometry = made_odometry(200, 1, segments=3)
    stretches = split_road(odometry, SubmapSettings())
    for stretch in stretches:
        assert len(set(odometry.keyframes.segment[stretch.keyframes])) == 1
    assert sorted(np.concatenate([s.keyframes for s in stretches])) == list(range(len(odometry.keyframes)))


def test_submaps_end_where_steps_are_broken_and_the_road_within_is_one_of_its_own():
    whole = made_odometry(road_m=120.0)
    covariance = np.full((len(whole.keyframes), 6, 6), np.nan, np.float32)
    covariance[1:] = np.diag([0.01**2] * 3 + [1e-6] * 3)
    covariance[20:25, 2, 2] = 0.3**2
    covariance[40, 2, 2] = 0.3**2
    broken = replace(whole, keyframes=replace(whole.keyframes, step_covariance=covariance))
    pieces = [stretch.keyframes.tolist() for stretch in split_road(broken, SubmapSettings())]
    assert pieces == [[*range(20)], [*range(20, 24)], [*range(24, 40)], [*range(40, 61)]]
    assert [stretch.keyframes.tolist() for stretch in split_road(broken, SubmapSettings(broken_step_m=0.5))] == [
        stretch.keyframes.tolist() for stretch in split_road(whole, SubmapSettings())
    ]


def test_points_lie_where_odometry_and_place_put_them(odometry, labels, placed):
    in_map = np.concatenate([item.points_enu() for item in placed])
    T_enu_world = made_geo(odometry).T_enu_cam[0]
    expected = se3.transform(T_enu_world, odometry.points_world())
    distance = np.linalg.norm(in_map[:, None] - expected[None], axis=2)
    assert distance.min(axis=1).max() < 1e-4


def test_every_point_is_kept_once_or_left_out_for_a_reason(odometry, labels, placed):
    kept = sum(len(item.submap) for item in placed)
    left_out = sum(sum(item.submap.points_left_out.values()) for item in placed)
    assert kept + left_out == len(odometry.points)
    assert sum(item.submap.points_left_out["sky"] for item in placed) == (labels.stereo == SKY).sum()
    assert all(SKY not in item.submap.label for item in placed)


def test_points_are_judged_in_blocks_as_all_at_once(odometry, labels, placed, monkeypatch):
    monkeypatch.setattr("wayloom.submaps.split.POINTS_AT_ONCE", 37)
    again = list(make_submaps(NamedLog(), odometry, labels, made_geo(odometry)))
    assert [one.submap.digest for one in again] == [one.submap.digest for one in placed]


def test_points_without_depth_too_far_or_too_uncertain_are_left_out(odometry, labels):
    p = odometry.points
    p.inverse_depth[:5] = [0.0, -0.1, np.nan, np.inf, 1.0 / 61.0]
    p.inverse_depth[5], p.variance[5] = 0.05, (0.06 * 0.05) ** 2  # 6 % of 20 m: 1.2 m
    p.inverse_depth[6], p.variance[6] = 0.2, (0.06 * 0.2) ** 2  # 6 % of 5 m is 0.3 m: kept
    labels.stereo[:7] = 0
    first = next(make_submaps(NamedLog(), odometry, labels, made_geo(odometry))).submap
    assert first.points_left_out["without depth"] == 4
    assert first.points_left_out["too far"] == 1
    assert first.points_left_out["depth too uncertain"] == 1


def test_votes_stay_with_their_points(odometry, labels, placed):
    item = placed[1].submap
    at = {(round(float(x), 3), round(float(y), 3)): i for i, (x, y) in enumerate(odometry.points.uv_host)}
    K = odometry.rig.camera.K
    for row in range(0, len(item), 37):
        in_cam = se3.transform(se3.inverse(item.T_submap_cam[item.keyframe[row]]), item.xyz[row : row + 1].astype(float))[0]
        uv = K @ in_cam / in_cam[2]
        nearest = min(at, key=lambda key: abs(key[0] - uv[0]) + abs(key[1] - uv[1]))
        old = at[nearest]
        a, b = item.vote_start[row], item.vote_start[row + 1]
        c, d = labels.vote_start[old], labels.vote_start[old + 1]
        assert item.label[row] == labels.stereo[old]
        kept = ~np.isin(labels.vote_class[c:d], PERSONS)
        assert item.vote_class[a:b].tolist() == labels.vote_class[c:d][kept].tolist()
        assert item.vote_weight[a:b].tolist() == labels.vote_weight[c:d][kept].tolist()


def test_no_point_and_no_vote_of_a_person_is_in_a_submap_unless_they_are_asked_for(odometry, labels):
    labels.stereo[::7] = CLASS_ID["person"]
    labels.stereo[3::7] = CLASS_ID["rider"]
    geo = made_geo(odometry)
    placed = list(make_submaps(NamedLog(), odometry, labels, geo))
    for item in placed:
        assert not np.isin(item.submap.label, PERSONS).any()
        assert not np.isin(item.submap.vote_class, PERSONS).any()
        assert item.submap.vote_start[-1] == len(item.submap.vote_class) == len(item.submap.vote_weight)
    all_points = sum(len(item.submap) + sum(item.submap.points_left_out.values()) for item in placed)
    assert all_points == len(odometry.points)
    left_out = sum(item.submap.points_left_out["persons"] for item in placed)
    assert left_out == np.isin(labels.stereo, PERSONS).sum()
    kept = list(make_submaps(NamedLog(), odometry, labels, geo, SubmapSettings(keep_persons=True)))
    assert sum(np.isin(item.submap.label, PERSONS).sum() for item in kept) > 0.5 * left_out
    assert any(np.isin(item.submap.vote_class, PERSONS).any() for item in kept)
    assert all("persons" not in item.submap.points_left_out for item in kept)


def test_moving_the_drive_moves_the_place_and_not_the_content(odometry, labels, placed):
    geo = made_geo(odometry)
    moved = dataclasses.replace(geo, T_enu_cam=se3.exp(np.array([5.0, 1.0, 0.3, 0.0, 0.0, 1e-5])) @ geo.T_enu_cam)
    again = list(make_submaps(NamedLog(), odometry, labels, moved))
    assert [item.submap.digest for item in again] == [item.submap.digest for item in placed]
    assert not np.allclose(again[0].T_enu_submap, placed[0].T_enu_submap)


def test_a_changed_point_is_another_submap(placed):
    submap = placed[0].submap
    label = submap.label.copy()
    label[0] ^= 1
    assert dataclasses.replace(submap, label=label).digest != submap.digest


def test_a_submap_survives_its_bytes_bit_for_bit(placed):
    for item in placed:
        back = decode_submap(item.submap.encoded)
        assert back.digest == item.submap.digest
        assert np.array_equal(back.xyz, item.submap.xyz)
        assert back.points_left_out == item.submap.points_left_out


@pytest.mark.parametrize(
    "damage", [lambda d: d[:100], lambda d: d[:-1], lambda d: d + b"x", lambda d: b"", lambda d: b"PK" + d[2:]]
)
def test_damaged_bytes_are_refused_in_one_line(placed, damage):
    with pytest.raises(InputError, match="is no submap") as caught:
        decode_submap(damage(placed[0].submap.encoded), "x.submap")
    assert "\n" not in str(caught.value)


def test_another_version_is_refused_by_number(placed):
    data = bytearray(placed[0].submap.encoded)
    data[8] = 9
    with pytest.raises(InputError, match="version 9, this program reads 1"):
        decode_submap(bytes(data))


def test_a_folder_of_submaps_comes_back_as_it_was(placed, tmp_path):
    save_submaps(placed, tmp_path / "submaps")
    back = load_submaps(tmp_path / "submaps")
    for one, other in zip(placed, back, strict=True):
        assert one.submap.digest == other.submap.digest
        assert np.array_equal(one.T_enu_submap, other.T_enu_submap)
        assert np.array_equal(one.covariance, other.covariance)
        assert (one.drive_id, one.frame) == (other.drive_id, other.frame) == ("made", FRAME)


def test_stored_submaps_are_those_of_the_folder_and_few_of_them_stay_in_memory(placed, tmp_path, monkeypatch):
    save_submaps(placed, tmp_path)
    monkeypatch.setattr("wayloom.submaps.files.SUBMAPS_HELD", 2)
    stored, names = StoredSubmaps(tmp_path), [one.submap.digest for one in placed]
    assert len(stored) == len(names) > 2
    assert [one.submap.digest for one in stored] == names
    assert [hashlib.sha256(one.submap.encoded).hexdigest() for one in stored] == names
    assert stored[-1].submap.digest == names[-1]
    assert [one.submap.digest for one in stored[1:3]] == names[1:3]
    assert stored[0] is stored[0]
    with pytest.raises(IndexError):
        stored[len(names)]
    gc.collect()
    gc.disable()
    try:
        seen = [weakref.ref(one.submap) for one in stored]
        assert sum(one() is not None for one in seen) == 2
        del stored
        assert not any(one() for one in seen)  # at once, not when cycles are looked for
    finally:
        gc.enable()


def test_a_stored_submap_that_is_gone_is_named_when_it_is_asked_for(placed, tmp_path):
    save_submaps(placed, tmp_path)
    stored = StoredSubmaps(tmp_path)
    (tmp_path / f"{placed[1].submap.digest}.submap").unlink()
    assert stored[0].submap.digest == placed[0].submap.digest
    with pytest.raises(InputError, match=placed[1].submap.digest):
        stored[1]


def test_saving_twice_gives_the_same_bytes(placed, tmp_path):
    save_submaps(placed, tmp_path / "a")
    save_submaps(placed, tmp_path / "b")
    names = sorted(p.name for p in (tmp_path / "a").iterdir())
    assert names == sorted(p.name for p in (tmp_path / "b").iterdir())
    assert all((tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes() for name in names)


def test_a_drive_without_gnss_keeps_no_frame_and_no_covariance(odometry, labels, tmp_path):
    save_submaps(make_submaps(NamedLog(), odometry, labels, made_geo(odometry, None)), tmp_path)
    back = load_submaps(tmp_path)
    assert back[0].frame is None
    assert np.isnan(back[0].covariance).all()


def test_what_joins_submaps_comes_from_the_drives_graph_and_back_from_the_folder(odometry, labels, tmp_path):
    anchors = anchor_frames(odometry, split_road(odometry, SubmapSettings()))
    cross = np.random.default_rng(3).normal(size=(len(anchors) - 1, 6, 6))
    geo = dataclasses.replace(made_geo(odometry), anchors=Anchors(anchors, cross, np.arange(len(cross)) != 1))
    save_submaps(make_submaps(NamedLog(), odometry, labels, geo), tmp_path)
    first, *others = load_submaps(tmp_path)
    assert first.before is None
    for k, item in enumerate(others):
        assert np.array_equal(item.before.cross, cross[k])
        assert item.before.connected == (k != 1)


def test_submaps_of_other_anchors_than_the_graph_was_asked_of_tell_nothing_of_their_neighbours(odometry, labels):
    anchors = anchor_frames(odometry, split_road(odometry, SubmapSettings()))
    told = Anchors(anchors + 2, np.zeros((len(anchors) - 1, 6, 6)), np.ones(len(anchors) - 1, bool))
    placed = list(make_submaps(NamedLog(), odometry, labels, dataclasses.replace(made_geo(odometry), anchors=told)))
    assert all(item.before is None for item in placed)


def test_folders_of_before_tell_nothing_of_neighbours(placed, tmp_path):
    save_submaps(placed, tmp_path)
    index = json.loads((tmp_path / "index.json").read_text())
    for entry in index["submaps"]:
        del entry["before"]
    (tmp_path / "index.json").write_text(json.dumps(index))
    assert all(item.before is None for item in load_submaps(tmp_path))


def test_a_submap_is_as_uncertain_as_the_drives_graph_bends_it(odometry, labels, placed):
    """The graph swings the drive 5 cm to either side, every 4 m: a rigid submap follows none of it."""
    geo = made_geo(odometry)
    swing = np.zeros((len(geo.T_enu_cam), 6))
    swing[:, 0] = 0.05 * np.where(np.arange(len(swing)) // 4 % 2, 1.0, -1.0)
    bent = list(make_submaps(NamedLog(), odometry, labels, dataclasses.replace(geo, T_enu_cam=se3.exp(swing) @ geo.T_enu_cam)))
    for item, stiff in zip(bent, placed, strict=True):
        assert np.linalg.norm(item.T_enu_submap[:3, 3] - stiff.T_enu_submap[:3, 3]) < 0.01
        more = position_covariance(item.T_enu_submap[None], (item.covariance - stiff.covariance)[None])[0]
        assert np.sqrt(more[0, 0]) == pytest.approx(0.05, rel=0.05)


def broken(geo, before_frame, by_m):
    """The drive's graph puts all frames before that one by_m further back along the road than the odometry."""
    T = geo.T_enu_cam.copy()
    T[:before_frame, 1, 3] -= by_m
    return dataclasses.replace(geo, T_enu_cam=T)


def test_a_break_of_the_odometry_within_a_submap_is_told_of_each_keyframe_and_kept_in_the_folder(odometry, labels, tmp_path):
    geo = broken(made_geo(odometry), 20, 2.0)
    placed = list(make_submaps(NamedLog(), odometry, labels, geo))
    save_submaps(placed, tmp_path)
    first, *others = load_submaps(tmp_path)
    by_graph = first.T_enu_submap @ se3.exp(first.bend) @ first.submap.T_submap_cam
    np.testing.assert_allclose(by_graph, geo.T_enu_cam[first.submap.keyframe_frame], atol=2e-3)
    step = np.diff(first.bend[:, 2])
    assert first.submap.keyframe_frame[int(np.argmax(step)) + 1] == 20
    assert step.max() == pytest.approx(2.0, abs=1e-3)
    for item in others:
        assert np.abs(item.bend).max() < 1e-5


def test_folders_of_before_tell_of_no_bend(placed, tmp_path):
    save_submaps(placed, tmp_path)
    index = json.loads((tmp_path / "index.json").read_text())
    for entry in index["submaps"]:
        del entry["bend"]
    (tmp_path / "index.json").write_text(json.dumps(index))
    assert all(item.bend is None for item in load_submaps(tmp_path))


def test_missing_and_swapped_blobs_are_named(placed, tmp_path):
    save_submaps(placed, tmp_path)
    blobs = sorted(tmp_path.glob("*.submap"))
    blobs[0].write_bytes(blobs[1].read_bytes())
    with pytest.raises(InputError, match="does not hold what its name says"):
        load_submaps(tmp_path)
    blobs[0].unlink()
    with pytest.raises(InputError, match=blobs[0].name):
        load_submaps(tmp_path)


def test_a_folder_without_index_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"index\.json"):
        load_submaps(tmp_path)
    (tmp_path / "index.json").write_text(json.dumps({"format": "other"}))
    with pytest.raises(InputError, match="no wayloom-submaps of version 1"):
        load_submaps(tmp_path)


def test_labels_of_another_run_are_refused(odometry):
    with pytest.raises(StageError, match="different runs"):
        list(make_submaps(NamedLog(), odometry, made_labels(3), made_geo(odometry)))


def test_the_track_of_a_submap_is_its_keyframes_in_the_map(odometry, placed):
    geo = made_geo(odometry)
    track = np.concatenate([item.track_enu() for item in placed])
    assert np.allclose(track, geo.T_enu_cam[odometry.keyframes.frame, :3, 3], atol=1e-9)


def test_random_submaps_survive_their_bytes():
    for seed in range(5):
        submap = random_submap(seed, points=50 * seed + 1).submap
        assert decode_submap(submap.encoded).digest == submap.digest


def test_other_poses_of_the_drive_move_submaps_and_change_nothing_inside(odometry, labels, placed):
    geo = made_geo(odometry)
    bend = se3.exp(np.linspace(0.0, 1.0, len(geo.T_enu_cam))[:, None] * np.array([3.0, -1.0, 0.5, 0.01, 0.02, 0.3]))
    moved = list(make_submaps(NamedLog(), odometry, labels, dataclasses.replace(geo, T_enu_cam=bend @ geo.T_enu_cam)))
    assert [item.submap.digest for item in moved] == [item.submap.digest for item in placed]
    assert all(not np.allclose(a.T_enu_submap, b.T_enu_submap) for a, b in zip(moved[1:], placed[1:], strict=True))


def test_another_odometry_makes_other_submaps(odometry, labels, placed):
    points = dataclasses.replace(odometry.points, inverse_depth=odometry.points.inverse_depth * np.float32(1.001))
    again = list(make_submaps(NamedLog(), dataclasses.replace(odometry, points=points), labels, made_geo(odometry)))
    assert not {item.submap.digest for item in again} & {item.submap.digest for item in placed}
