"""Evidence for and against a track: how often it was seen, whether it stands free, what was seen through it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.objects.bars import FREE_PX, FREE_SHARE
from wayloom.objects.measurements import Measurements
from wayloom.objects.tracks import Track
from wayloom.objects.triangulation import Cameras, projected
from wayloom.objects.types import POLE, STANDING
from wayloom.objects.view import ObjectView

FloatArray = NDArray[np.float64]
PATCH_PX: Final = 4
"""Half the height of the patch in which a view is asked whether it sees through."""
CARRIED_M: Final = 0.4
"""In the plane, from a post to the middle of what it carries."""
MARGIN_PX: Final = 3
"""Nearer to the image's border, nothing is asked."""


@dataclass(frozen=True, slots=True)
class Facts:
    """What the views say of a track.

    looks      views that show it
    unseen     views that look there, as far as it is, without its label
    through    views that see further there
    free       mean over the views and both sides, -1 (attached) to 1 (free)
    least_free the same of the side where it is less
    nearest    m, of the nearest view that shows it
    height     m, that is seen of it
    foot       m over the ground, where what is seen of it begins
    carries    whether a sign or light is over it
    goes_on    share of the views in which something as near stands above where its label ends
    """

    looks: int
    unseen: int
    through: int
    free: float
    least_free: float
    nearest: float
    height: float
    foot: float
    carries: bool
    goes_on: float


def unseen_views(track: Track, seen: Measurements, views: list[ObjectView], cameras: Cameras, reach_m: float) -> tuple[int, int]:
    """How many views that do not show a track look as far as it is, and how many look further."""
    others = np.setdiff1d(np.arange(len(views)), seen.view[track.rows])
    middle = track.place.copy()
    if track.kind in STANDING:
        middle[2] = 0.5 * float(np.median(seen.low[track.rows]) + np.median(seen.high[track.rows]))
    uvd, _ = projected(cameras, others, np.tile(middle, (len(others), 1)))
    z = np.einsum("nj,nj->n", cameras.R[others][:, :, 2], middle - cameras.centre[others])
    half = 0.5 * np.median(seen.width[track.rows]) * cameras.numbers[0] / np.maximum(z, 1.0)
    height, width = views[0].label.shape
    inside = (
        (z > 3.0) & (z < 0.8 * reach_m) & (uvd[:, 0] - half > MARGIN_PX) & (uvd[:, 0] + half < width - MARGIN_PX)
        & (uvd[:, 1] > MARGIN_PX + PATCH_PX) & (uvd[:, 1] < height - MARGIN_PX - PATCH_PX)
    )  # fmt: skip
    same = further = 0
    for k in np.flatnonzero(inside).tolist():
        u, v, d = uvd[k]
        u0, u1 = int(np.floor(u - half[k] - 1)), int(np.ceil(u + half[k] + 2))
        box = np.array([[u0, int(v) - PATCH_PX, u1, int(v) + PATCH_PX]])
        found = float(views[others[k]].match(box)[0][0])
        limit = FREE_PX + FREE_SHARE * d
        further += found < d - limit
        same += abs(found - d) <= limit
    return same, further


def carries(track: Track, seen: Measurements, others: Sequence[Track]) -> bool:
    """Whether one of other tracks is a sign or light over a pole."""
    if track.kind != POLE:
        return False
    low = float(np.median(seen.low[track.rows]))
    return any(
        one.kind not in STANDING and one.place[2] > low and np.hypot(*(one.place - track.place)[:2]) < CARRIED_M for one in others
    )


def facts_of(
    track: Track, seen: Measurements, unseen: tuple[int, int], cameras: Cameras, ground: float, others: Sequence[Track] = ()
) -> Facts:
    """The facts of a track.

    ground : height under it, m, level frame
    others : the tracks of all that was seen
    """
    own = seen.take(track.rows)
    free = own.free.mean(axis=0)
    nearest = np.linalg.norm(cameras.centre[own.view] - track.place, axis=1).min()
    low, high = float(np.percentile(own.low, 20)), float(np.percentile(own.high, 80))
    free_of = float(free.mean()), float(free.min())
    told = own.goes_on[np.isfinite(own.goes_on)]
    above = float(told.mean()) if len(told) else 0.0
    return Facts(len(own), *unseen, *free_of, float(nearest), high - low, low - ground, carries(track, seen, others), above)
