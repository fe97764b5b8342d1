"""Search for loops within a drive: scouts along the road, and from each place found along the road that is driven again."""

from collections import Counter, OrderedDict
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.progress import Progress, silent
from wayloom.geometry import se3
from wayloom.loops.consistency import consistent
from wayloom.loops.priors import Closure, around, by_odometry, odometry_chi2
from wayloom.loops.recognition import recognition
from wayloom.loops.settings import LoopSettings
from wayloom.loops.types import LoopClosures
from wayloom.places.road import road_m, spaced
from wayloom.places.types import Places
from wayloom.places.views import view_at
from wayloom.registration.feature_evidence import feature_evidence
from wayloom.registration.matches import match, pose_of_matches
from wayloom.registration.register import Prior, register_scenes
from wayloom.registration.scene import Scene, prepare
from wayloom.registration.types import Registration
from wayloom.registration.verification import features_suffice

FloatArray = NDArray[np.float64]
SCENES: Final = 24
"""Prepared views that are kept; each takes some megabytes."""
APART_M: Final = 1e6
"""Road that is put between segments: what the odometry knows of one from another is nothing."""
MOST_MISSES: Final = 2
"""Neighbours in a row that fail before a road is no longer followed."""


@dataclass(slots=True)
class Search:
    """What is known while a drive is searched; K keyframes."""

    places: Places
    settings: LoopSettings
    road: FloatArray
    anchors: NDArray[np.int64]
    scenes: OrderedDict[int, Scene] = field(default_factory=OrderedDict)
    tried: dict[tuple[int, int], str] = field(default_factory=dict)
    closures: list[Closure] = field(default_factory=list)

    @property
    def T_world_cam(self) -> FloatArray:
        """(K, 4, 4) of the odometry."""
        return self.places.T_world_keyframe

    def scene(self, keyframe: int) -> Scene:
        """The prepared view of a keyframe."""
        if keyframe not in self.scenes:
            self.scenes[keyframe] = prepare(view_at(self.places, keyframe), self.settings.registration)
            if len(self.scenes) > SCENES:
                self.scenes.popitem(last=False)
        self.scenes.move_to_end(keyframe)
        return self.scenes[keyframe]


def find_loops(places: Places, settings: LoopSettings = LoopSettings(), progress: Progress = silent) -> LoopClosures:
    """The closures of a drive, those that neighbours confirm."""
    road = road_m(places.T_world_keyframe)
    search = Search(places, settings, road, np.flatnonzero(spaced(road, places.segment, settings.spacing_m)))
    scouts = np.flatnonzero(spaced(road, places.segment, settings.scout_m))
    for count, j in enumerate(scouts.tolist()):
        for i in candidates(search, j):
            closure = attempt(search, i, j, by_odometry(search.T_world_cam, road, i, j, settings))
            if closure is not None:
                follow(search, closure)
                break
        progress((count + 1) / len(scouts), f"{len(search.closures)} pairs of places fit, {len(search.tried)} tried")
    recognise(search)
    kept = consistent(search.closures, search.T_world_cam, road + APART_M * places.segment, settings)
    closures = sorted((c for c, is_kept in zip(search.closures, kept, strict=True) if is_kept), key=lambda c: (c.second, c.first))
    return loop_closures(closures, report(search, len(closures)))


def recognise(search: Search) -> None:
    """Closures that the place index proposes where the odometry cannot, if local features alone know the pose: registered without a
    prior streets of other shape but like width pass for one. Each candidate is tried, so that look-alike places deny each other."""
    places, settings, road = search.places, search.settings, search.road
    known = recognition(places, settings)
    if known is None:
        return
    for station, j in enumerate(places.stations.keyframe.tolist()):
        for i in known.candidates(places, road, station, settings):
            if any(is_beside(search, c, i, j) for c in search.closures) or not features_agree(search, i, j):
                continue
            closure = attempt(search, i, j, None)
            if closure is not None and closure.alone and is_possible(search, closure):
                follow(search, closure)
            elif closure is not None:
                search.closures.remove(closure)


def features_agree(search: Search, i: int, j: int) -> bool:
    """Whether the local features of two views suffice for a pose of one in the other."""
    settings = search.settings.registration
    matches = match(search.scene(i).view, search.scene(j).view)
    pose = pose_of_matches(*matches)
    if pose is None or pose[1] < settings.many_matches:
        return False
    return features_suffice(feature_evidence(*matches, pose[0]), settings)


def is_beside(search: Search, closure: Closure, i: int, j: int) -> bool:
    """Whether a pair is near a closure at both ends of the road."""
    road = search.road
    return bool(max(abs(road[closure.first] - road[i]), abs(road[closure.second] - road[j])) < search.settings.scout_m)


def is_possible(search: Search, closure: Closure) -> bool:
    """Whether the odometry does not deny a closure that was found without it; across a loss it says nothing."""
    first, second, segment = closure.first, closure.second, search.places.segment
    if segment[first] != segment[second]:
        return True
    return odometry_chi2(closure, search.T_world_cam, search.road, search.settings) <= search.settings.max_cycle_chi2


def candidates(search: Search, j: int) -> list[int]:
    """Anchors well before j that may be the same place by the odometry, the likeliest first, none where j is closed already."""
    settings, road, T = search.settings, search.road, search.T_world_cam
    if any(abs(road[c.second] - road[j]) < settings.scout_m for c in search.closures):
        return []
    i = search.anchors[(search.places.segment[search.anchors] == search.places.segment[j])]
    i = i[road[j] - road[i] >= settings.min_road_m]
    sigma = settings.drift_share * (road[j] - road[i])
    distance = np.linalg.norm(T[i, :3, 3] - T[j, :3, 3], axis=1)
    near = distance < settings.near_m + settings.registration.prior_sigmas * sigma
    i, distance = i[near & (sigma < settings.max_prior_sigma_m)], distance[near & (sigma < settings.max_prior_sigma_m)]
    chosen: list[int] = []
    for row in np.argsort(distance, kind="stable"):
        if all(abs(road[i[row]] - road[k]) >= settings.scout_m for k in chosen):
            chosen.append(int(i[row]))
    return chosen[: settings.candidates]


def attempt(search: Search, i: int, j: int, prior: Prior | None) -> Closure | None:
    """Register keyframe j's view to keyframe i's, prior T_i_j of the cameras; None where the pair is refused or was tried."""
    if (i, j) in search.tried:
        return None
    a, b = search.scene(i), search.scene(j)
    T_a, T_b = a.view.T_level_cam, b.view.T_level_cam
    Ad = se3.adjoint(T_a)
    level = None if prior is None else Prior(T_a @ prior.T_a_b @ se3.inverse(T_b), Ad @ prior.covariance @ Ad.T)
    found = register_scenes(a, b, level, search.settings.registration)
    search.tried[i, j] = found.refused
    if found.refused:
        return None
    closure = closure_of(i, j, found, T_a, T_b, features_suffice(found.evidence, search.settings.registration))
    search.closures.append(closure)
    return closure


def closure_of(i: int, j: int, found: Registration, T_level_i: FloatArray, T_level_j: FloatArray, alone: bool) -> Closure:
    """The registration of level frames as one of cameras; alone : whether features suffice for it."""
    T_i_level = se3.inverse(T_level_i)
    Ad = se3.adjoint(T_i_level)
    return Closure(i, j, T_i_level @ found.T_a_b @ T_level_j, Ad @ found.covariance @ Ad.T, alone)


def follow(search: Search, start: Closure) -> None:
    """Try the anchors before and behind the closure's second keyframe, each with the place where the last closure puts it."""
    at = int(np.searchsorted(search.anchors, start.second))
    for steps in (range(at, len(search.anchors)), range(at - 1, -1, -1)):
        last, misses = start, 0
        for step in steps:
            j = int(search.anchors[step])
            i = partner(search, last, j)
            if i is None or misses >= MOST_MISSES:
                break
            if (i, j) in search.tried and search.tried[i, j] == "":
                continue
            closure = attempt(search, i, j, around(last, search.T_world_cam, search.road, (i, j), search.settings))
            last, misses = (last, misses + 1) if closure is None else (closure, 0)


def partner(search: Search, closure: Closure, j: int) -> int | None:
    """The anchor nearest to where the closure puts j; None where none is near, or only such as are too near along the road."""
    T, road, settings = search.T_world_cam, search.road, search.settings
    i = search.anchors[
        (search.places.segment[search.anchors] == search.places.segment[closure.first])
        & (road[j] - road[search.anchors] >= settings.min_road_m)
    ]
    if not len(i) or search.places.segment[j] != search.places.segment[closure.second]:
        return None
    T_world_j = T[closure.first] @ closure.T_first_second @ se3.inverse(T[closure.second]) @ T[j]
    distance = np.linalg.norm(T[i, :3, 3] - T_world_j[:3, 3], axis=1)
    # Where the odometry has drifted, other parts of the drive may lie there; only those beside the closure's first count.
    distance = np.where(np.abs(road[i] - road[closure.first]) <= settings.agreeing_road_m, distance, np.inf)
    best = int(np.argmin(distance))
    return int(i[best]) if distance[best] <= settings.near_m else None


def loop_closures(closures: list[Closure], facts: dict[str, Any]) -> LoopClosures:
    """As arrays."""
    return LoopClosures(
        np.array([c.first for c in closures], np.int32),
        np.array([c.second for c in closures], np.int32),
        np.array([c.T_first_second for c in closures]).reshape(-1, 4, 4),
        np.array([c.covariance for c in closures]).reshape(-1, 6, 6),
        facts,
    )


def report(search: Search, accepted: int) -> dict[str, Any]:
    """JSON-ready: pairs tried, fitting, accepted, and why the others were refused, numbers left out of the words."""
    words = Counter("".join(c for c in text if not c.isdigit()) for text in search.tried.values() if text)
    return {
        "tried": len(search.tried),
        "fitting": len(search.closures),
        "accepted": accepted,
        "refused": dict(sorted(words.items())),
    }
