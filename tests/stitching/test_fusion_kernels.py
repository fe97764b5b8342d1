"""Each kernel against a slow twin."""

from collections import defaultdict
from fractions import Fraction

import numpy as np
import pytest

from stitching.made_walls import street_submap
from wayloom.stitching import fusion
from wayloom.stitching.fusion import GROUP_OF_CLASS
from wayloom.stitching.grid import hash_table, neighbour_steps, pack, unpack
from wayloom.stitching.kernels import cells, neighbours, surfaces
from wayloom.stitching.points import Box, canonical, map_points
from wayloom.stitching.settings import MergeSettings
from wayloom.stitching.voxels import MAX_WEIGHT, OFFSET_STEPS, WEIGHT_STEPS, pooled, voxels_of

pytestmark = pytest.mark.kernels
SETTINGS = MergeSettings()
EVERYWHERE = Box(*(np.full(2, side * 1e6) for side in (-1, 1, -1, 1)))
POINTS = map_points(canonical([street_submap(seed, 400) for seed in (0, 3, 6)]), EVERYWHERE, SETTINGS)


def covariance_of(p):
    ray = POINTS.ray[p]
    return POINTS.common[p] + POINTS.across2[p] * np.eye(3) + (POINTS.sigma2[p] - POINTS.across2[p]) * np.outer(ray, ray)


def naive_planes(points, options):
    """The definition of `fit`, cell by cell, in the map's own coordinates less a common origin."""
    cell_m, group = options.surface_cell_m, GROUP_OF_CLASS[points.label]
    at = np.floor(points.xyz / cell_m).astype(int)
    members = defaultdict(list)
    for p in np.flatnonzero((group > 0) & (points.sigma2 <= options.surface_sigma_m**2)):
        members[(int(group[p]), *at[p].tolist())].append(p)
    weight = {p: 1 / (points.sigma2[p] + np.trace(points.common[p]) / 3) for rows in members.values() for p in rows}
    robust = dict.fromkeys(weight, 1.0)
    for _ in range(3):
        planes = {}
        for key in members:
            rows, scale = [], []
            for step in neighbour_steps()[:, 1:]:
                near = members.get((key[0], *(np.array(key[1:]) + step).tolist()), [])
                rows += near
                scale += [0.5 ** np.abs(step).sum()] * len(near)
            w, count = np.array([weight[p] for p in rows]) * scale, float(np.dot([robust[p] for p in rows], scale))
            x = points.xyz[rows]
            mean = w @ x / w.sum()
            values, vectors = np.linalg.eigh((w[:, None] * (x - mean)).T @ (x - mean) / w.sum())
            flat = values[1] >= max(4 * values[0], (0.25 * cell_m) ** 2)
            if count >= options.surface_points and flat:
                scatter2 = max(values[0] - count / w.sum(), 0) + options.surface_floor_m**2
                planes[key] = (mean, vectors[:, 0], scatter2, values[0] / count + 1 / w.sum(), count)
        for key, rows in members.items():
            for p in rows:
                robust[p], weight[p] = 1.0, 1 / (points.sigma2[p] + np.trace(points.common[p]) / 3)
                if key in planes:
                    mean, n, scatter2, *_ = planes[key]
                    variance = n @ covariance_of(p) @ n
                    r = n @ (points.xyz[p] - mean)
                    robust[p] = 1 / (1 + r**2 / (4 * (variance + scatter2))) ** 2
                    weight[p] = robust[p] / variance
    return planes


@pytest.fixture(scope="module")
def twin():
    return naive_planes(POINTS, SETTINGS)


def test_planes_are_what_their_naive_twin_says(twin):
    planes = fusion.fit(POINTS, SETTINGS)
    found = np.flatnonzero(planes.plane[:, 6] > 0)
    group = planes.key // cells.CELLS_PER_AXIS**3
    assert {(int(group[c]), *planes.cells[c].tolist()) for c in found} == set(twin)
    assert len(twin) > 20
    for c in found:
        mean, n, scatter2, place2, count = twin[(int(group[c]), *planes.cells[c].tolist())]
        sign = np.sign(n @ planes.plane[c, :3])
        assert np.allclose(planes.plane[c, :3] * sign, n, atol=1e-6)
        offset = n @ (mean - planes.cells[c] * SETTINGS.surface_cell_m)
        assert np.allclose(planes.plane[c, 3] * sign, offset, atol=1e-6)
        assert np.allclose(planes.plane[c, 4:], [scatter2, place2, count], rtol=1e-4, atol=1e-9)


def test_a_point_moves_onto_its_plane_as_a_kalman_filter_would_move_it(twin):
    fused = fusion.fuse(POINTS, SETTINGS)
    moved = np.flatnonzero(fused.surface >= 0)
    assert len(moved) > 200
    for p in moved[::7]:
        c = fused.surface[p]
        plane = fused.planes.plane[c]
        n, d = plane[:3], plane[3] + plane[:3] @ (fused.planes.cells[c] * SETTINGS.surface_cell_m)
        S = covariance_of(p)
        total = n @ S @ n + plane[4] + plane[5]
        assert (d - n @ POINTS.xyz[p]) ** 2 <= SETTINGS.gate_sigma**2 * total * (1 + 1e-9)
        assert np.allclose(fused.xyz[p], POINTS.xyz[p] + S @ n * (d - n @ POINTS.xyz[p]) / total, atol=1e-6)
        assert np.isclose(fused.variance[p], (n @ S @ n) * (plane[4] + plane[5]) / total, rtol=1e-6)
    assert (np.abs(fused.xyz - POINTS.xyz) <= SETTINGS.reach_m).all()


def test_a_point_is_refuted_by_a_surface_that_its_ray_crosses(twin):
    fused = fusion.fuse(POINTS, SETTINGS)
    group, half = GROUP_OF_CLASS[POINTS.label], 0.5 * SETTINGS.surface_cell_m
    for p in range(0, len(POINTS), 3):
        expected, unsure = False, False
        for (of_group, *cell), (mean, n, *_) in twin.items():
            t = n @ (mean - POINTS.xyz[p]) / (n @ POINTS.ray[p])
            met = POINTS.xyz[p] + t * POINTS.ray[p] - np.array(cell) * SETTINGS.surface_cell_m
            walked = np.arange(-5, 6)[:, None] * half * POINTS.ray[p] + POINTS.xyz[p]
            visited = (np.floor(walked / SETTINGS.surface_cell_m).astype(int) == cell).all(axis=1).any()
            near = of_group == group[p] and visited and abs(n @ POINTS.ray[p]) > surfaces.LEAST_SINE
            expected |= bool(near and abs(t) <= SETTINGS.reach_m and (met >= -half).all() and (met <= 3 * half).all())
            unsure |= bool(
                near and (np.abs(np.concatenate([met + half, met - 3 * half, [abs(t) - SETTINGS.reach_m]])) < 1e-5).any()
            )
        if not unsure:
            assert fused.refuted[p] == (expected and fused.surface[p] < 0 and group[p] > 0)


def test_eigenvectors_of_symmetric_matrices_are_those_of_lapack():
    rng = np.random.default_rng(0)
    for _ in range(50):
        B = rng.normal(size=(3, 3)) * rng.choice([1e-3, 1.0, 30.0], 3)
        A, V, values = B @ B.T, np.empty((3, 3)), np.empty(3)
        expected, vectors = np.linalg.eigh(A)
        surfaces.smallest_direction(A.copy(), values, V)
        assert np.allclose(values, expected, rtol=1e-9, atol=1e-12 * expected[2])
        assert abs(V[:, 0] @ vectors[:, 0]) > 1 - 1e-6


def test_voxels_are_what_their_naive_twin_says():
    fused = fusion.fuse(POINTS, SETTINGS)
    rows = np.arange(0, len(POINTS), 2)
    voxels = voxels_of(POINTS, fused, rows, 0.5)
    twin = defaultdict(lambda: {"w": 0, "p": [Fraction(0)] * 3, "votes": [0] * 19, "rows": []})
    for p in rows:
        key = tuple(np.floor(fused.xyz[p] / 0.5).astype(int).tolist())
        v = twin[key]
        w = int(np.clip(np.rint(WEIGHT_STEPS / fused.variance[p]), 1, MAX_WEIGHT))
        v["w"] += w
        for axis in range(3):
            step = min(int(np.floor((fused.xyz[p][axis] / 0.5 - key[axis]) * OFFSET_STEPS)), OFFSET_STEPS - 1)
            v["p"][axis] += w * Fraction(2 * step + 1, 2 * OFFSET_STEPS)
        for k in range(POINTS.vote_start[p], POINTS.vote_start[p + 1]):
            v["votes"][POINTS.vote_class[k]] += int(POINTS.vote_weight[k])
        v["rows"].append(p)
    assert [tuple(key) for key in unpack(voxels.key).tolist()] == sorted(twin)
    for i, key in enumerate(sorted(twin)):
        v = twin[key]
        assert np.allclose(voxels.xyz[i], [0.5 * (key[a] + float(v["p"][a] / v["w"])) for a in range(3)], atol=1e-9)
        assert voxels.votes[i].tolist() == v["votes"]
        assert voxels.count[i] == len(v["rows"])
        assert voxels.variance[i] == fused.variance[v["rows"]].min()
        assert (voxels.first_ns[i], voxels.last_ns[i]) == (POINTS.seen_ns[v["rows"]].min(), POINTS.seen_ns[v["rows"]].max())
        own = voxels.drive[voxels.drive_start[i] : voxels.drive_start[i + 1]]
        assert own.tolist() == sorted(set(POINTS.drive[v["rows"]].tolist()))


def drives_of(voxels, row):
    return voxels.drive[voxels.drive_start[row] : voxels.drive_start[row + 1]].tolist()


def test_pooled_votes_are_what_their_naive_twin_says():
    fused = fusion.fuse(POINTS, SETTINGS)
    voxels = voxels_of(POINTS, fused, np.arange(len(POINTS)), 0.1)
    wanted = np.arange(3, len(voxels), 5)
    pool = pooled(voxels, wanted, fused, len(POINTS.drive_ids), SETTINGS)
    for i, v in enumerate(wanted):
        plane = voxels.surface[v] >= 0
        reach = SETTINGS.vote_reach_m if plane else SETTINGS.lone_vote_reach_m
        away = voxels.xyz - voxels.xyz[v]
        weight = np.maximum(1 - (away**2).sum(axis=1) / reach**2, 0) ** 2
        if plane:
            weight[np.abs(away @ fused.planes.plane[voxels.surface[v], :3]) > SETTINGS.surface_thickness_m] = 0
        steps = (neighbours.KERNEL_STEPS * weight).astype(int)
        own, own_weight = set(drives_of(voxels, v)), np.where(np.arange(len(voxels)) == v, neighbours.OWN_WEIGHT, 1)
        adds = np.array([u == v or bool(set(drives_of(voxels, u)) - own) if steps[u] else False for u in range(len(voxels))])
        assert np.allclose(pool.votes[i], (steps * adds * own_weight) @ voxels.votes, rtol=1e-3, atol=2 * voxels.votes.max())
        seen = np.flatnonzero(steps > neighbours.LEAST_WEIGHT)
        drives = {d for u in seen for d in voxels.drive[voxels.drive_start[u] : voxels.drive_start[u + 1]].tolist()}
        assert drives <= set(pool.drive[pool.drive_start[i] : pool.drive_start[i + 1]].tolist())
        assert pool.first_ns[i] <= voxels.first_ns[seen].min()
        assert pool.last_ns[i] >= voxels.last_ns[seen].max()
        near = np.flatnonzero(steps >= neighbours.LEAST_WEIGHT - 1)
        assert set(pool.drive[pool.drive_start[i] : pool.drive_start[i + 1]].tolist()) <= set(
            voxels.drive[np.concatenate([np.arange(voxels.drive_start[u], voxels.drive_start[u + 1]) for u in near])].tolist()
        )


def test_a_table_finds_every_key_and_no_other():
    key = np.unique(np.random.default_rng(1).integers(-(2**60), 2**60, 3000))
    table = hash_table(key)
    assert [cells.find(k, key, table) for k in key] == list(range(len(key)))
    assert cells.find(np.int64(12345), key, table) == -1
    assert cells.find(np.int64(0), key[:0], hash_table(key[:0])) == -1


def test_packed_keys_sort_as_the_keys_do_and_come_back():
    rng = np.random.default_rng(0)
    keys = rng.integers(-(2**18), 2**18, (1000, 3)) * [8, 8, 1]
    packed = pack(keys)
    assert np.array_equal(unpack(packed), keys)
    assert np.array_equal(np.argsort(packed), np.lexsort((keys[:, 2], keys[:, 1], keys[:, 0])))
