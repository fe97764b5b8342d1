"""Place index over many drives: candidates for where a place was seen before, by appearance and by surroundings.

Appearance: local features of the keyframes around a station vote for stations with like ones (`bit_tables`); it finds places passed
in the same direction. Surroundings: bird's-eye grids, by packed signatures and then by correlation; they find both directions.
What is held of a drive depends on that drive alone, so the answers do not depend on the order in which drives came.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.places.bit_tables import FULL_WEIGHT, TABLES, BitTables
from wayloom.places.road import road_m
from wayloom.places.surroundings import Surroundings
from wayloom.places.types import Places

FloatArray = NDArray[np.float64]
FEATURES: Final = 128
"""Local features that are held of a keyframe, at most."""
APART_M: Final = 15.0
"""Candidates of one drive nearer to each other along the road are one."""
MORE: Final = 8
"""Stations that are looked at for a candidate, so that enough are left when those beside each other are taken for one."""
APPEARANCE, SURROUNDINGS = "appearance", "surroundings"
GATE_SIGMAS: Final = 3.0
GATE_FLOOR_M: Final = 20.0
"""What a gate forgives beyond its sigmas: stations lie some metres apart, and lanes too."""


@dataclass(frozen=True, slots=True)
class Positions:
    """Where the stations of a drive are: xy_m (N, 2) in a frame that all drives of the index share, sigma_m (N,)."""

    xy_m: FloatArray
    sigma_m: FloatArray


@dataclass(frozen=True, slots=True)
class Gate:
    """Where the query is: only stations that may be there are candidates, and those whose position is not known."""

    xy_m: tuple[float, float]
    sigma_m: float


@dataclass(frozen=True, slots=True)
class Stretch:
    """Road of a drive, m from its first keyframe, whose stations are no candidates: what the query itself stands on."""

    drive_id: str
    from_m: float
    to_m: float


@dataclass(frozen=True, slots=True)
class PlaceQuery:
    """bits (n, 32) local features around a station; grid (3, 32, 24) its bird's-eye descriptor."""

    bits: NDArray[np.uint8]
    grid: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Candidate:
    """A place that may be the query's.

    anchor   row in the drive's Keyframes
    score    to compare candidates of one kind with
    yaw_rad  guess of the candidate's heading against the query's: 0 or pi
    kind     what it was found by: appearance or surroundings
    """

    drive_id: str
    anchor: int
    score: float
    yaw_rad: float
    kind: str


@dataclass(frozen=True, slots=True)
class _Drive:
    """Rows of the index that hold a drive's stations, their keyframes and their road, m."""

    rows: NDArray[np.int32]
    anchor: NDArray[np.int32]
    road: FloatArray


class PlaceIndex:
    """Stations of drives. Rows of removed drives are used again; what is new is merged at the next look-up."""

    def __init__(self) -> None:
        self.drives: dict[str, _Drive] = {}
        self.bits, self.around = BitTables(), Surroundings()
        self._new: list[tuple[NDArray[np.uint8], NDArray[np.int32]]] = []
        self._used = np.zeros(0, bool)
        self._gone = np.zeros(0, bool)
        self._drive_of: list[str] = []
        self._anchor, self._road = np.zeros(0, np.int32), np.zeros(0)
        self._xy, self._sigma = np.zeros((0, 2)), np.zeros(0)

    def __len__(self) -> int:
        """Stations."""
        return int(self._used.sum())

    def add(self, drive_id: str, places: Places, positions: Positions | None = None) -> None:
        """Hold a drive's stations. Raises InputError where it is held already."""
        if drive_id in self.drives:
            raise InputError(f"the place index holds drive {drive_id} already", remedy="remove it first")
        stations = places.stations
        rows = self._free_rows(len(stations))
        road = road_m(places.T_world_keyframe)[stations.keyframe]
        self.drives[drive_id] = _Drive(rows, stations.keyframe, road)
        xy, sigma = (
            (np.zeros((len(rows), 2)), np.full(len(rows), np.inf)) if positions is None else (positions.xy_m, positions.sigma_m)
        )
        self._used[rows], self._anchor[rows], self._road[rows] = True, stations.keyframe, road
        self._xy[rows], self._sigma[rows] = xy, sigma
        for row in rows.tolist():
            self._drive_of[row] = drive_id
        self.around.put(rows, stations.grid)
        chosen, station = held_features(places)
        self._new.append((places.features.bits[chosen], rows[station]))

    def remove(self, drive_id: str) -> None:
        """Forget a drive. Raises InputError where it is not held."""
        if drive_id not in self.drives:
            raise InputError(f"the place index holds no drive {drive_id}")
        self._merge()
        rows = self.drives.pop(drive_id).rows
        self._used[rows] = False
        self._gone[rows] = True
        self._merge()

    def candidates(
        self, query: PlaceQuery, count: int = 10, gate: Gate | None = None, without: Stretch | None = None
    ) -> list[Candidate]:
        """At most `count` places, those found by appearance and by surroundings in turn, the best of each first.

        The kind begins whose best one stands out more from its others.
        """
        self._merge()
        rows = self._allowed(gate, without)
        votes = self.bits.votes(query.bits, len(self._used))[rows]
        like, is_turned = self.around.alike(query.grid, rows)
        lists = [
            self._apart(rows, votes.astype(np.float64), np.zeros(len(rows), bool), APPEARANCE, count),
            self._apart(rows, like, is_turned, SURROUNDINGS, count),
        ]
        return self._in_turn(sorted(lists, key=lambda ranked: _prominence(ranked, count), reverse=True), count)

    def likest(self, query: PlaceQuery) -> float:
        """0 to 2: the share of the query's features that the best station has, and the likeness of the likest surroundings."""
        self._merge()
        rows = self._allowed(None, None)
        if not len(rows):
            return 0.0
        most = max(1, len(query.bits)) * FULL_WEIGHT * TABLES
        share = float(self.bits.votes(query.bits, len(self._used))[rows].max()) / most
        return share + float(self.around.alike(query.grid, rows)[0].max())

    @property
    def nbytes(self) -> int:
        """Memory of all that is held."""
        return (
            self.bits.nbytes
            + self.around.nbytes
            + sum(a.nbytes for a in (self._anchor, self._road, self._xy, self._sigma, self._used))
        )

    def _free_rows(self, count: int) -> NDArray[np.int32]:
        free = np.flatnonzero(~self._used & ~self._gone)
        more = max(0, count - len(free))
        if more:
            more = max(more, len(self._used))
            self._used, self._gone = np.pad(self._used, (0, more)), np.pad(self._gone, (0, more))
            self._anchor, self._road = np.pad(self._anchor, (0, more)), np.pad(self._road, (0, more))
            self._xy, self._sigma = np.pad(self._xy, ((0, more), (0, 0))), np.pad(self._sigma, (0, more))
            self._drive_of += [""] * more
            self.around.grow(len(self._used))
            free = np.flatnonzero(~self._used & ~self._gone)
        return free[:count].astype(np.int32)

    def _merge(self) -> None:
        """Bring the hash tables up to date."""
        if self._new or self._gone.any():
            bits = np.concatenate([np.zeros((0, 32), np.uint8), *(b for b, _ in self._new)])
            owners = np.concatenate([np.zeros(0, np.int32), *(o for _, o in self._new)])
            self.bits.replace(self._gone, bits, owners)
            self._new, self._gone = [], np.zeros(len(self._used), bool)

    def _allowed(self, gate: Gate | None, without: Stretch | None) -> NDArray[np.int64]:
        """Rows that may be candidates, increasing."""
        allowed = self._used.copy()
        if without is not None and without.drive_id in self.drives:
            own = self.drives[without.drive_id]
            allowed[own.rows[(own.road >= without.from_m) & (own.road <= without.to_m)]] = False
        if gate is not None:
            reach = GATE_FLOOR_M + GATE_SIGMAS * np.hypot(self._sigma, gate.sigma_m)
            off = self._xy - np.array(gate.xy_m)
            allowed &= (np.abs(off) <= reach[:, None]).all(axis=1)
        return np.flatnonzero(allowed)

    def _apart(
        self, rows: NDArray[np.int64], score: FloatArray, is_turned: NDArray[np.bool_], kind: str, count: int
    ) -> list[tuple[int, Candidate]]:
        """The best of the rows (r,) with a score, of those near to each other along a drive's road one."""
        scored = np.flatnonzero(score > 0.0)
        enough = min(len(scored), MORE * count)
        floor = np.partition(score[scored], -enough)[-enough] if enough else 0.0
        best = [(-score[i], self._drive_of[rows[i]], int(self._anchor[rows[i]]), int(i)) for i in scored[score[scored] >= floor]]
        found: list[tuple[int, Candidate]] = []
        for negative, drive_id, anchor, i in sorted(best):
            row = int(rows[i])
            if len(found) == count:
                break
            if not self._is_near(row, [other for other, _ in found]):
                yaw = np.pi if is_turned[i] else 0.0
                found.append((row, Candidate(drive_id, anchor, -float(negative), float(yaw), kind)))
        return found

    def _is_near(self, row: int, others: list[int]) -> bool:
        """Whether one of the others lies beside the row, on the road of one drive."""
        return any(
            self._drive_of[row] == self._drive_of[other] and abs(self._road[row] - self._road[other]) < APART_M for other in others
        )

    def _in_turn(self, lists: list[list[tuple[int, Candidate]]], count: int) -> list[Candidate]:
        """One of each list in turn; a place that an earlier one has is left out."""
        rows: list[int] = []
        taken: list[Candidate] = []
        for rank in range(max(map(len, lists))):
            for row, candidate in (ranked[rank] for ranked in lists if rank < len(ranked)):
                if len(taken) < count and not self._is_near(row, rows):
                    rows.append(row)
                    taken.append(candidate)
        return taken


def _prominence(ranked: list[tuple[int, Candidate]], count: int) -> float:
    """0 to 1: how far the best score lies over the middle one of `count`, of which missing ones are 0."""
    scores = [candidate.score for _, candidate in ranked] + [0.0] * (count - len(ranked))
    return 1.0 - float(np.median(scores)) / scores[0] if ranked else 0.0


def query_at(places: Places, station: int) -> PlaceQuery:
    """The query of a station, by its number among the drive's stations."""
    chosen, of = held_features(places)
    return PlaceQuery(places.features.bits[chosen[of == station]], places.stations.grid[station])


def held_features(places: Places) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of the features that an index holds, some of each keyframe, and the nearest station, along the road, of each."""
    f = places.features
    first = np.searchsorted(f.keyframe, f.keyframe)
    number, total = np.arange(len(f)) - first, np.searchsorted(f.keyframe, f.keyframe, side="right") - first
    kept = np.flatnonzero((number * FEATURES) // total != ((number - 1) * FEATURES) // total) if len(f) else np.zeros(0, np.int64)
    road = road_m(places.T_world_keyframe)
    at = road[places.stations.keyframe]
    middle = 0.5 * (at[1:] + at[:-1])
    return kept, np.searchsorted(middle, road[f.keyframe[kept]])
