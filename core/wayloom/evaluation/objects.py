"""Objects against those of a simulated city: which are found, which are true, how far off they lie, and by how many sigmas."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wayloom.config.classes import CLASS_ID
from wayloom.logs.simulated_truth import SimulatedTruth
from wayloom.objects.types import KINDS, LIGHT, POLE, SIGN, STANDING, TRUNK, MapObject
from wayloom.simulation.city.city import City
from wayloom.simulation.textures.materials import Material

FloatArray = NDArray[np.float64]
CLASS_OF: Final = {POLE: CLASS_ID["pole"], SIGN: CLASS_ID["traffic sign"], LIGHT: CLASS_ID["traffic light"]}
CLOSE_M: Final = 0.3
"""A true object counts as found where one lies so near."""
SAME_M: Final = 1.0
"""What lies further from every true object is of none."""
LEAST_PX, LEAST_VIEWS, FURTHEST_M = 25, 3, 18.0
"""A drive shows an object where so many keyframes that it searched show so many pixels of it, within so much."""
FOOT_M: Final = 0.05
FACE_TINT: Final = 0.9


@dataclass(frozen=True, slots=True)
class TrueThing:
    """kind, instance in the truth images, place (3,) m enu as `MapObject` has it, and which way a sign faces, rad or NaN."""

    kind: int
    instance: int
    place: FloatArray
    height_m: float
    facing_rad: float


@dataclass(frozen=True, slots=True)
class ObjectScores:
    """Of one kind: numbers, and errors of the F objects that are of a true one.

    found       objects
    true        of them within SAME_M of a true one; close of them within CLOSE_M of one
    doubles     of them of a true one that a nearer one is of, too
    shown, hit  true objects that the drives show, and those of them with an object within CLOSE_M
    errors      (F,) m: in the plane of poles and trunks, else in space
    sigmas      (2 F,) errors east and north over their sigmas
    facing      (S,) rad, errors of signs' directions
    """

    found: int
    true: int
    close: int
    doubles: int
    shown: int
    hit: int
    errors: FloatArray
    sigmas: FloatArray
    facing: FloatArray


def true_things(truth: SimulatedTruth, city: City | None = None) -> list[TrueThing]:
    """Poles, signs and lights of the truth's list; with the city's mesh, trunks and the directions of signs, too."""
    kinds = {class_id: kind for kind, class_id in CLASS_OF.items()}
    faces, trunks = ({}, []) if city is None else _of_mesh(city)
    listed = []
    for one in truth.objects():
        kind = kinds[one.class_id]
        middle = one.foot_enu + np.array([0.0, 0.0, 0.0 if kind == POLE else 0.5 * (one.bottom_m + one.height_m)])
        facing, place = faces.get(one.instance, (np.nan, middle))
        listed.append(TrueThing(kind, one.instance, place, one.height_m, facing))
    return listed + trunks


def _of_mesh(city: City) -> tuple[dict[int, tuple[float, FloatArray]], list[TrueThing]]:
    """Direction and middle of signs' faces by instance, which the list has at their posts; and the trunks: feet of the bark."""
    mesh = city.whole()
    face = (mesh.class_id == CLASS_ID["traffic sign"]) & (mesh.tint[:, 0] > FACE_TINT)
    corners = mesh.corners[face].astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    faces = {}
    for instance in np.unique(mesh.instance[face]).tolist():
        own = mesh.instance[face] == instance
        points = corners[own].reshape(-1, 3)
        n = normal[own].sum(axis=0)
        faces[instance] = float(np.arctan2(n[0], n[1])), 0.5 * (points.min(axis=0) + points.max(axis=0))
    bark = (mesh.class_id == CLASS_ID["vegetation"]) & (mesh.material == int(Material.BARK))
    corners, owner = mesh.corners[bark].astype(np.float64), mesh.instance[bark]
    trunks = []
    for instance in np.unique(owner).tolist():
        points = np.unique(corners[owner == instance].reshape(-1, 3), axis=0)
        ring = points[points[:, 2] < points[:, 2].min() + FOOT_M]
        trunks.append(TrueThing(TRUNK, instance, ring.mean(axis=0), float(np.ptp(points[:, 2])), np.nan))
    return faces, trunks


def shown_in(truth: SimulatedTruth, frames: Sequence[int]) -> set[int]:
    """Instances of all static things that a drive shows in enough of these frames."""
    views: dict[int, int] = {}
    for frame in frames:
        near = (truth.depth_m(frame) > 0.0) & (truth.depth_m(frame) < FURTHEST_M)
        instances, counts = np.unique(truth.instance(frame)[near], return_counts=True)
        for instance in instances[counts >= LEAST_PX].tolist():
            views[instance] = views.get(instance, 0) + 1
    return {instance for instance, count in views.items() if instance and count >= LEAST_VIEWS}


def score_objects(
    found: Sequence[MapObject], things: Sequence[TrueThing], drives_of: Mapping[int, int], kind: int, least_drives: int = 1
) -> ObjectScores:
    """The scores of one kind.

    drives_of    : how many drives show a true thing, by its instance
    least_drives : true things that fewer show are not asked for, and the errors of objects of fewer drives are not told
    """
    own = [one for one in found if one.kind == KINDS[kind]]
    true = [one for one in things if one.kind == kind]
    axes = 2 if kind in STANDING else 3
    places = np.array([one.place for one in true]).reshape(-1, 3)
    positions = np.array([one.position for one in own]).reshape(-1, 3)
    wanted = np.array([drives_of.get(one.instance, 0) >= least_drives for one in true], bool)
    nearest, gap = np.full(len(own), -1), np.full(len(own), np.inf)
    if len(true) and len(own):
        gap, nearest = cKDTree(places[:, :axes]).query(positions[:, :axes])
    owner: dict[int, int] = {}
    for row in np.lexsort((np.arange(len(own)), gap)).tolist():
        if gap[row] < SAME_M:
            owner.setdefault(int(nearest[row]), row)
    of_one = sorted(owner.values())
    hit = {thing for thing, row in owner.items() if gap[row] < CLOSE_M}
    told = [row for row in of_one if len(own[row].drives) >= least_drives]
    off = positions[told] - places[nearest[told]]
    variance = np.array([np.diag(own[row].covariance)[:2] for row in told]).reshape(-1, 2)
    return ObjectScores(
        found=len(own),
        true=int((gap < SAME_M).sum()),
        close=int((gap < CLOSE_M).sum()),
        doubles=int((gap < SAME_M).sum()) - len(of_one),
        shown=int(wanted.sum()),
        hit=sum(bool(wanted[thing]) for thing in hit),
        errors=np.linalg.norm(off[:, :axes], axis=1),
        sigmas=(off[:, :2] / np.sqrt(variance)).ravel(),
        facing=_facing_errors([own[row] for row in told], [true[nearest[row]] for row in told]),
    )


def _facing_errors(found: Sequence[MapObject], true: Sequence[TrueThing]) -> FloatArray:
    pairs = [(one.facing_rad, thing.facing_rad) for one, thing in zip(found, true, strict=True)]
    off = [a - b for a, b in pairs if a is not None and np.isfinite(b)]
    return np.abs((np.array(off, np.float64) + np.pi) % (2.0 * np.pi) - np.pi)
