"""Objects of the map out of the sightings of drives: positions by information, confidence by the odds of drives.

The result is a function of the set of sightings: they are put into a canonical order first, so every order of arrival gives the
same bits. A drive counts once: what it saw in two of its submaps hangs on one place, and its evidence is bounded.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wayloom.geometry import se3
from wayloom.objects.facing import azimuth
from wayloom.objects.grouping import NEAR_M, NEAR_OF_KIND_M, groups
from wayloom.objects.placed import AllSightings, all_sightings
from wayloom.objects.settings import ObjectFusionSettings
from wayloom.objects.types import KINDS, SIGN, STANDING, MapObject, PlacedSightings

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
MOST_OF_A_DRIVE: Final = 4.0
"""Log-odds: what one drive says at most, for or against."""
MISSED: Final = np.array([1.0, 1.6, 1.0, 0.25])
"""By kind, log-odds against an object that a drive looked at without seeing it: by the shares of true ones that a drive misses."""
ROUNDS: Final = 4
CAUCHY2: Final = 9.0
"""Square of the sigmas at which a drive's place counts half."""
BELIEVED: Final = 9.0
ID_CELL_M: Final = 0.25


def fuse(sightings: Sequence[PlacedSightings], settings: ObjectFusionSettings = ObjectFusionSettings()) -> list[MapObject]:
    """The objects that the sightings of drives, placed in one frame, tell of; by kind and id."""
    seen = all_sightings(sightings)
    columns = Columns(seen)
    found = [_fused(seen, columns, rows) for rows in groups(seen, settings)]
    odds = _log_odds(seen, columns, found, settings)
    confidence = 1.0 / (1.0 + np.exp(-odds))
    sure = np.flatnonzero(confidence >= settings.least_confidence)
    kept = _without_doubles([found[k] for k in sure], odds[sure])
    objects = [_map_object(seen, columns, found[k], float(confidence[k])) for k in sure[kept]]
    return sorted(objects, key=lambda one: (one.kind, one.id))


class Columns:
    """The columns of all sightings that are not places, each (M, ...)."""

    def __init__(self, seen: AllSightings) -> None:
        for name in ("bottom_m", "top_m", "width_m", "facing_sigma", "evidence_for", "evidence_against"):
            setattr(self, name, seen.column(name).astype(np.float64))
        self.looks, self.first_ns, self.last_ns = (seen.column(name).astype(np.int64) for name in ("looks", "first_ns", "last_ns"))
        rotations = np.array([one.T_enu_submap[:3, :3] for one in seen.placed]).reshape(-1, 3, 3)
        self.facing = np.einsum("nij,nj->ni", rotations[seen.source], seen.column("facing").astype(np.float64))

    bottom_m: FloatArray
    top_m: FloatArray
    width_m: FloatArray
    facing_sigma: FloatArray
    evidence_for: FloatArray
    evidence_against: FloatArray


@dataclass(frozen=True, slots=True)
class Fused:
    """Rows of the sightings of one object, its kind, and where they have it: position (3,) m and covariance (3, 3) m^2."""

    rows: IntArray
    kind: int
    position: FloatArray
    covariance: FloatArray


def _fused(seen: AllSightings, columns: Columns, rows: IntArray) -> Fused:
    """The object of a group of sightings: of each drive by their own covariances, then of the drives by their places', too."""
    places, covariances = [], []
    for drive in np.unique(seen.drive[rows]):
        own = rows[seen.drive[rows] == drive]
        position, covariance = robust_mean(seen.position[own], seen.own[own])
        best = own[np.lexsort((own, np.trace(seen.total[own], axis1=1, axis2=2)))[0]]
        places.append(position)
        covariances.append(covariance + seen.place[best])
    return Fused(rows, int(seen.kind[rows[0]]), *robust_mean(np.array(places), np.array(covariances)))


def robust_mean(places: FloatArray, covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (3,) of places (n, 3) by covariances (n, 3, 3), with Cauchy weights, and its covariance.

    Where the places differ by more than their sigmas tell, the covariance grows by as much (Birge's ratio, held to 1 as by
    BELIEVED numbers that agree).
    """
    information = np.linalg.inv(covariances)
    weight, d2 = np.ones(len(places)), np.zeros(len(places))
    mean, covariance = places[0], covariances[0]
    for _ in range(ROUNDS if len(places) > 1 else 1):
        weighted = weight[:, None, None] * information
        covariance = np.linalg.inv(weighted.sum(axis=0))
        mean = covariance @ np.einsum("nij,nj->i", weighted, places)
        off = places - mean
        d2 = np.einsum("ni,nij,nj->n", off, information, off)
        weight = 1.0 / (1.0 + d2 / CAUCHY2)
    ratio = (BELIEVED + float((weight * d2).sum())) / (BELIEVED + 3.0 * (len(places) - 1))
    return mean, covariance * max(1.0, ratio)


def _log_odds(seen: AllSightings, columns: Columns, found: list[Fused], settings: ObjectFusionSettings) -> FloatArray:
    """(F,) that each object is there: of the drives that saw it, less what those say that looked there and saw nothing."""
    by_drive = np.zeros((len(found), len(seen.drives)))
    saw = np.zeros(by_drive.shape, bool)
    net = columns.evidence_for - columns.evidence_against
    for k, one in enumerate(found):
        np.add.at(by_drive[k], seen.drive[one.rows], net[one.rows])
        saw[k, seen.drive[one.rows]] = True
    looked = _looks_at(seen, np.array([one.position for one in found]).reshape(-1, 3))
    kinds = np.array([one.kind for one in found], np.int64)
    missed = np.where(looked >= settings.looked, -MISSED[kinds][:, None], 0.0)
    return np.asarray(np.where(saw, by_drive.clip(-MOST_OF_A_DRIVE, MOST_OF_A_DRIVE), missed).sum(axis=1))


def _looks_at(seen: AllSightings, places: FloatArray) -> IntArray:
    """(F, D) keyframes of each drive whose view went through each of places (F, 3)."""
    out = np.zeros((len(places), len(seen.drives)), np.int64)
    for one in seen.placed:
        in_submap = se3.transform(se3.inverse(one.T_enu_submap), places)
        out[:, seen.drives.index(one.drive_id)] += one.sightings.looked_at(in_submap)
    return out


def _without_doubles(found: list[Fused], odds: FloatArray) -> IntArray:
    """Which to keep so that no two that may be taken for each other lie near each other: the likelier stays."""
    kept, widest = np.ones(len(found), bool), max(NEAR_OF_KIND_M.values())
    for kinds in (STANDING, tuple(set(range(len(KINDS))) - set(STANDING))):
        rows = np.array([k for k, one in enumerate(found) if one.kind in kinds], np.int64)
        if not len(rows):
            continue
        axes = 2 if kinds == STANDING else 3
        places = np.array([found[k].position[:axes] for k in rows])
        tree = cKDTree(places)
        rank = np.lexsort((*places.T, -odds[rows]))
        for at in rank.tolist():
            if kept[rows[at]]:
                kind = found[rows[at]].kind
                for other in tree.query_ball_point(places[at], widest):
                    limit = NEAR_OF_KIND_M[kind] if found[rows[other]].kind == kind else NEAR_M
                    if other != at and np.linalg.norm(places[other] - places[at]) <= limit:
                        kept[rows[other]] = False
    return np.flatnonzero(kept)


def _map_object(seen: AllSightings, columns: Columns, one: Fused, confidence: float) -> MapObject:
    rows, kind = one.rows, KINDS[one.kind]
    faces = azimuth(columns.facing[rows], columns.facing_sigma[rows]) if one.kind == SIGN else None
    return MapObject(
        id=_identity(kind, one.position),
        kind=kind,
        position=one.position,
        covariance=one.covariance,
        bottom_m=float(np.median(columns.bottom_m[rows])),
        height_m=float(np.median(columns.top_m[rows])),
        width_m=float(np.median(columns.width_m[rows])),
        facing_rad=None if faces is None else faces[0],
        facing_sigma_rad=None if faces is None else faces[1],
        confidence=confidence,
        drives=tuple(seen.drives[k] for k in np.unique(seen.drive[rows])),
        looks=int(columns.looks[rows].sum()),
        first_ns=int(columns.first_ns[rows].min()),
        last_ns=int(columns.last_ns[rows].max()),
    )


def _identity(kind: str, position: FloatArray) -> str:
    """Of its kind and the cell that it lies in: no two objects of a kind share one, as doubles are taken out."""
    cell = np.floor(position / ID_CELL_M).astype(np.int64)
    return f"{kind}-{hashlib.sha256(':'.join(map(str, cell.tolist())).encode()).hexdigest()[:12]}"
