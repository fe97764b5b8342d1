"""Search for pairs of views of two drives: scouts along the one, candidates of the other, then along the shared road."""

from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.loops.priors import Closure, around
from wayloom.places.views import view_at
from wayloom.registration.register import Prior, bend_covariance, register_scenes
from wayloom.registration.scene import Scene, prepare
from wayloom.registration.types import Registration
from wayloom.stitching.meeting_settings import MeetingSettings
from wayloom.stitching.placed_drive import PlacedDrive

FloatArray = NDArray[np.float64]
SCENES: Final = 24
"""Prepared views of a drive that are kept; each takes some megabytes."""
MOST_MISSES: Final = 2
"""Neighbours in a row that fail before a shared road is no longer followed."""


@dataclass(slots=True)
class PairSearch:
    """What is known while two drives are compared.

    anchors     of drive a, by which views of b are compared
    scenes      prepared views, by drive and keyframe
    tried       why the pair of keyframes (i of a, j of b) was refused, empty where it was not
    found       pairs of views that fit, between the keyframes in the middle of both views
    T_world_cam, road  of the keyframes of a and behind them those of b: (Ka + Kb, 4, 4), (Ka + Kb,)
    """

    a: PlacedDrive
    b: PlacedDrive
    settings: MeetingSettings
    anchors: NDArray[np.int64]
    steps: NDArray[np.int64]
    T_world_cam: FloatArray
    road: FloatArray
    scenes: tuple[OrderedDict[int, Scene], OrderedDict[int, Scene]] = field(default_factory=lambda: (OrderedDict(), OrderedDict()))
    tried: dict[tuple[int, int], str] = field(default_factory=dict)
    found: list[Closure] = field(default_factory=list)

    def scene(self, which: int, keyframe: int) -> Scene:
        """The prepared view of a keyframe of drive a (which 0) or b (1)."""
        scenes = self.scenes[which]
        if keyframe not in scenes:
            places = (self.a, self.b)[which].places
            scenes[keyframe] = prepare(view_at(places, keyframe), self.settings.registration)
            if len(scenes) > SCENES:
                scenes.popitem(last=False)
        scenes.move_to_end(keyframe)
        return scenes[keyframe]


def start_search(a: PlacedDrive, b: PlacedDrive, settings: MeetingSettings) -> PairSearch:
    """Nothing tried yet."""
    return PairSearch(
        a,
        b,
        settings,
        a.anchors(settings.spacing_m),
        b.anchors(settings.spacing_m),
        np.concatenate([a.places.T_world_keyframe, b.places.T_world_keyframe]),
        np.concatenate([a.road, b.road]),
    )


def search_pairs(
    search: PairSearch, candidates: Callable[[int], Iterable[tuple[int, Callable[[], Prior]]]], are_guesses: bool = False
) -> None:
    """Try each scout of b with its candidates, and follow what fits along the road.

    candidates  : of a keyframe of b the keyframes of a that may see the same place, the likeliest first, with priors T_i_j of the
                  cameras
    are_guesses : the priors are no evidence
    """
    settings = search.settings
    for j in search.b.anchors(settings.scout_alone_m if are_guesses else settings.scout_m).tolist():
        for i, prior in candidates(j):
            if not is_covered(search, i, j) and (i, j) not in search.tried:
                closure = attempt(search, i, j, prior(), are_guesses)
                if closure is not None:
                    follow(search, closure)


def is_covered(search: PairSearch, i: int, j: int) -> bool:
    """Whether a pair nearby fits already: then its road was followed to here, or ends before."""
    a, b, reach = search.a, search.b, search.settings.loops.agreeing_road_m
    for closure in search.found:
        second = closure.second - len(a.places)
        beside = abs(b.road[second] - b.road[b.middle[j]]) < search.settings.scout_m
        if beside and abs(a.road[closure.first] - a.road[a.middle[i]]) < reach:
            return True
    return False


def attempt(search: PairSearch, i: int, j: int, prior: Prior, is_guess: bool = False) -> Closure | None:
    """Register b's view at keyframe j to a's at i, prior T_i_j of the cameras; None where the pair is refused or was tried.

    is_guess : the prior says where to search, but is no evidence, so that the views must fit as well as without one
    """
    if (i, j) in search.tried:
        return None
    one, other = search.scene(0, i), search.scene(1, j)
    settings = search.settings.registration
    if is_guess:
        settings = settings.model_copy(update={"min_soundness": settings.min_soundness_alone})
    found = register_scenes(one, other, level_prior(prior, one, other), settings)
    search.tried[i, j] = found.refused
    if found.refused:
        return None
    closure = closure_of_middles(search, i, j, found, one, other)
    search.found.append(closure)
    return closure


def level_prior(prior: Prior, one: Scene, other: Scene) -> Prior:
    """The prior of two cameras as one of their level frames."""
    T_one, T_other = one.view.T_level_cam, other.view.T_level_cam
    Ad = se3.adjoint(T_one)
    return Prior(T_one @ prior.T_a_b @ se3.inverse(T_other), Ad @ prior.covariance @ Ad.T)


def closure_of_middles(search: PairSearch, i: int, j: int, found: Registration, one: Scene, other: Scene) -> Closure:
    """The registration of two level frames as one of the cameras in the middle of both views.

    What both saw lies around these, so that the drift within the views bends it least there.
    """
    a, b = search.a, search.b
    first, second = int(a.middle[i]), int(b.middle[j])
    T_first_level = a.between(first, i) @ se3.inverse(one.view.T_level_cam)
    T_level_second = other.view.T_level_cam @ b.between(j, second)
    T = T_first_level @ found.T_a_b @ T_level_second
    Ad = se3.adjoint(T_first_level)
    points = found.covariance - bend_covariance(found.T_a_b)
    return Closure(first, len(a.places) + second, T, Ad @ points @ Ad.T + bend_covariance(T))


def follow(search: PairSearch, start: Closure) -> None:
    """Try b's anchors before and behind the pair, a stride apart, each with the place where the last pair puts it."""
    b, stride = search.b, search.settings.stride
    at = int(np.argmin(np.abs(b.road[b.middle[search.steps]] - b.road[start.second - len(search.a.places)])))
    for steps in (range(at + stride, len(search.steps), stride), range(at - stride, -1, -stride)):
        last, misses = start, 0
        for step in steps:
            j = int(search.steps[step])
            i = partner(search, last, j)
            if i is None or misses >= MOST_MISSES:
                break
            closure = attempt(search, i, j, prior_around(search, last, i, j))
            last, misses = (last, misses + 1) if closure is None else (closure, 0)


def partner(search: PairSearch, closure: Closure, j: int) -> int | None:
    """The anchor of a the middle of whose view is nearest to that of j's, by the closure; None where none is near."""
    a, b, second = search.a, search.b, closure.second - len(search.a.places)
    if b.places.segment[j] != b.places.segment[second]:
        return None
    i = search.anchors[a.places.segment[search.anchors] == a.places.segment[closure.first]]
    beside = np.abs(a.road[a.middle[i]] - a.road[closure.first]) <= search.settings.loops.agreeing_road_m
    if not beside.any():
        return None
    i = i[beside]
    T_first_middle = closure.T_first_second @ b.between(second, int(b.middle[j]))
    T_world_middle = a.places.T_world_keyframe[closure.first] @ T_first_middle
    distance = np.linalg.norm(a.places.T_world_keyframe[a.middle[i], :3, 3] - T_world_middle[:3, 3], axis=1)
    best = int(np.argmin(distance))
    return int(i[best]) if distance[best] <= search.settings.near_m else None


def prior_around(search: PairSearch, closure: Closure, i: int, j: int) -> Prior:
    """T_i_j of the cameras by way of a pair that fits and both odometries."""
    return around(closure, search.T_world_cam, search.road, (i, len(search.a.places) + j), search.settings.loops)
