"""Sparse graph of the submap poses of many drives in one map frame, joined by the drives' meetings.

The places are a function of the set of drives and meetings: both are put into one order first, and every part starts from the
drives' own places, so that the order of arrival and what was solved before change no bit.

Drives that meet, directly or by others, are solved as one up to `whole_up_to` submaps. Beyond, the map is cut into cells by the
drives' own places: each cell is solved with its surroundings, and what lies further out is integrated out of the drives' own
distributions (`wayloom.stitching.drive_chain`): the border is held by its own covariance, and meetings out there are not heard. A
drive that comes changes only the cells that it and its meetings lie in or near; the others are known by their digest and not solved
again.
"""

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from wayloom.errors import InputError
from wayloom.geometry import se3
from wayloom.geometry.probability import chi_square_quantile
from wayloom.stitching.city_window import Solved, Window, solve_window
from wayloom.stitching.drive_chain import DriveChain, across, drive_chain
from wayloom.stitching.joining import Joined, join_drives
from wayloom.stitching.settings import CityGraphSettings
from wayloom.stitching.types import AlignedDrive, City, DrivePlaces, JudgedMeeting, Meeting

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
NO_PLACE = "a drive that it joins has no GNSS, and its meetings do not agree on a place"


class CityMemory:
    """What earlier calls of `optimise_city` found, by digests of all that it rests on; never needed for the result."""

    def __init__(self) -> None:
        self.chains: dict[str, DriveChain] = {}
        self.windows: dict[str, Solved] = {}


@dataclass(frozen=True, slots=True)
class Nodes:
    """N submaps of all placed drives, drive after drive; start (D + 1,) rows of the drives; M meetings, ends (M, 2) rows."""

    chains: list[DriveChain]
    start: IntArray
    T0: FloatArray
    before: IntArray
    ends: IntArray
    T_a_b: FloatArray
    covariance: FloatArray


def optimise_city(
    drives: Iterable[DrivePlaces],
    meetings: Iterable[Meeting],
    settings: CityGraphSettings = CityGraphSettings(),
    memory: CityMemory | None = None,
) -> City:
    """Places of all submaps, and what became of each meeting.

    Drives without GNSS are placed where at least `least_agreeing` meetings agree; others of them stay in their own frame.
    Raises InputError: two drives of one id, meetings of unknown submaps, covariances that are none.
    """
    memory = memory or CityMemory()
    given = sorted(drives, key=lambda drive: drive.drive_id)
    heard = sorted(meetings, key=canonical)
    _check(given, heard)
    joined = join_drives(given, heard, settings)
    usable = [meeting for meeting in heard if meeting.drive_a in joined and meeting.drive_b in joined]
    own = {name: drive_chain(one.drive, settings, memory.chains) for name, one in joined.items()}
    nodes = _nodes([_with_place(chain, joined[name]) for name, chain in own.items()], usable)
    T, covariance = nodes.T0.copy(), np.concatenate([np.zeros((0, 6, 6)), *(chain.drive.covariance for chain in nodes.chains)])
    used, chi2, cycle = np.zeros(len(usable), np.bool_), np.zeros(len(usable)), np.zeros(len(usable))
    windows, solved = _windows(nodes, settings), {}
    for core, around in windows:
        here, published = (np.bincount(rows, minlength=len(T)) > 0 for rows in (around, core))
        inside = np.flatnonzero(here[nodes.ends].all(axis=1))
        digest = _digest(nodes, around, inside, settings)
        solved[digest] = memory.windows.get(digest) or solve_window(_window(nodes, around, inside), settings.confidence)
        result, rows = solved[digest], np.searchsorted(around, core)
        T[core], covariance[core] = result.T_map_submap[rows], result.covariance[rows]
        mine = published[nodes.ends[inside, 0]]
        rows = inside[mine]
        used[rows], chi2[rows], cycle[rows] = result.used[mine], result.chi2[mine], result.cycle_chi2[mine]
    fresh = sum(digest not in memory.windows for digest in solved)
    memory.windows, memory.chains = solved, {chain.digest: chain for chain in own.values()}
    limit = float(chi_square_quantile(settings.confidence, 6))
    verdicts = iter([_judged(*one, limit) for one in zip(usable, used, chi2, cycle, strict=True)])
    judged = [
        next(verdicts) if one.drive_a in joined and one.drive_b in joined else JudgedMeeting(one, np.nan, NO_PLACE) for one in heard
    ]
    return City(_placed(given, nodes, T, covariance), judged, fresh, len(windows))


def canonical(meeting: Meeting) -> tuple[str, int, str, int, bytes, bytes]:
    """What meetings are sorted by."""
    ends = meeting.drive_a, int(meeting.submap_a), meeting.drive_b, int(meeting.submap_b)
    return *ends, meeting.T_a_b.tobytes(), meeting.covariance.tobytes()


def _with_place(chain: DriveChain, one: Joined) -> DriveChain:
    """The chain with what is known of the places before meetings are joined."""
    if one.covariance is one.drive.covariance:
        return chain
    Ad = se3.adjoint(se3.from_rotation_translation(np.tile(np.eye(3), (len(chain.T0), 1, 1)), -chain.T0[:, :3, 3]))
    around = Ad @ one.covariance @ np.swapaxes(Ad, 1, 2)
    return replace(chain, around=around, digest=chain.digest + hashlib.sha256(around.tobytes()).hexdigest())


def _nodes(chains: list[DriveChain], meetings: Sequence[Meeting]) -> Nodes:
    start = np.concatenate([[0], np.cumsum([len(chain.T0) for chain in chains], dtype=np.int64)])
    row = {chain.drive.drive_id: first for chain, first in zip(chains, start[:-1].tolist(), strict=True)}
    before = np.arange(start[-1]) - 1
    before[start[:-1]] = -1
    ends = [(row[one.drive_a] + one.submap_a, row[one.drive_b] + one.submap_b) for one in meetings]
    return Nodes(
        chains,
        start,
        _all(chains, lambda chain: chain.T0, 4),
        before,
        np.array(ends, np.int64).reshape(-1, 2),
        np.array([one.T_a_b for one in meetings]).reshape(-1, 4, 4),
        np.array([one.covariance for one in meetings]).reshape(-1, 6, 6),
    )


def _all(chains: Sequence[DriveChain], part: Callable[[DriveChain], FloatArray], size: int) -> FloatArray:
    return np.concatenate([np.zeros((0, size, size)), *(part(chain) for chain in chains)])


def _windows(nodes: Nodes, settings: CityGraphSettings) -> list[tuple[IntArray, IntArray]]:
    """Rows that are published, and rows that are solved for them: each submap is published by one window."""
    n = len(nodes.T0)
    if n == 0:
        return []
    follows = np.flatnonzero(nodes.before >= 0)
    a, b = np.concatenate([nodes.ends, np.stack([nodes.before[follows], follows], axis=1)]).T
    _, part = connected_components(coo_matrix((np.ones(len(a)), (a, b)), shape=(n, n)), directed=False)
    size = np.bincount(part)
    order = np.argsort(part, kind="stable")
    whole = [rows for rows in np.split(order, np.cumsum(size)[:-1]) if len(rows) <= settings.whole_up_to]
    large = np.flatnonzero(size[part] > settings.whole_up_to)
    xy = nodes.T0[:, :2, 3]
    cell = np.floor(xy / settings.cell_m).astype(np.int64)
    out = [(rows, rows) for rows in whole]
    by_cell: dict[tuple[int, int], IntArray] = {}
    for rows in _grouped(large, cell[large]):
        by_cell[tuple(cell[rows[0]].tolist())] = rows
    reach = int(np.ceil(settings.halo_m / settings.cell_m))
    offsets = list(product(range(-reach, reach + 1), repeat=2))
    for (i, j), core in by_cell.items():
        around = np.concatenate([by_cell[i + di, j + dj] for di, dj in offsets if (i + di, j + dj) in by_cell])
        low = np.array([i, j]) * settings.cell_m - settings.halo_m
        near = ((xy[around] >= low) & (xy[around] < low + settings.cell_m + 2.0 * settings.halo_m)).all(axis=1)
        out.append((core, np.sort(around[near])))
    return out


def _grouped(rows: IntArray, cell: IntArray) -> list[IntArray]:
    """Rows (k,) by their cell (k, 2), in the order of the cells."""
    if len(rows) == 0:
        return []
    order = np.lexsort((rows, cell[:, 1], cell[:, 0]))
    change = np.flatnonzero(np.diff(cell[order], axis=0).any(axis=1)) + 1
    return np.split(rows[order], change)


def _window(nodes: Nodes, around: IntArray, inside: IntArray) -> Window:
    """Submaps `around` (k,), sorted, and meetings `inside`."""
    drive = np.searchsorted(nodes.start, around, side="right") - 1
    there = np.unique(drive)
    chains = [nodes.chains[d] for d in there]
    first = np.concatenate([[0], np.cumsum([len(chain.T0) for chain in chains])])
    at = first[np.searchsorted(there, drive)] + around - nodes.start[drive]
    follows = np.concatenate([[False], drive[1:] == drive[:-1]])
    ahead, information = (_all(chains, part, 6)[at] for part in (lambda one: one.ahead, lambda one: one.information))
    step = _all(chains, lambda chain: chain.step, 6)[at]
    for row in np.flatnonzero(follows & (np.diff(around, prepend=-1) > 1)).tolist():  # a drive that comes back
        chain, first_row = nodes.chains[drive[row]], nodes.start[drive[row]]
        ahead[row], information[row] = across(chain, int(around[row - 1] - first_row), int(around[row] - first_row))
        step[row] = np.nan
    return Window(
        np.where(follows, np.arange(len(around)) - 1, -1),
        nodes.T0[around],
        ahead,
        information,
        _all(chains, lambda chain: chain.alone, 6)[at],
        _all(chains, lambda chain: chain.around, 6)[at],
        step,
        np.searchsorted(around, nodes.ends[inside]),
        nodes.T_a_b[inside],
        nodes.covariance[inside],
    )


def _digest(nodes: Nodes, around: IntArray, inside: IntArray, settings: CityGraphSettings) -> str:
    """SHA-256 of all that a window rests on."""
    drive = np.searchsorted(nodes.start, around, side="right") - 1
    text = hashlib.sha256(settings.model_dump_json().encode())
    for d in np.unique(drive).tolist():
        chain = nodes.chains[d]
        text.update(chain.digest.encode() + (around[drive == d] - nodes.start[d]).tobytes())
    text.update(np.searchsorted(around, nodes.ends[inside]).tobytes())
    text.update(nodes.T_a_b[inside].tobytes() + nodes.covariance[inside].tobytes())
    return text.hexdigest()


def _judged(meeting: Meeting, used: np.bool_, chi2: float, cycle: float, limit: float) -> JudgedMeeting:
    if used:
        return JudgedMeeting(meeting, float(chi2), "")
    if cycle > limit:
        why = f"its cycle does not close: chi-square {cycle:.0f} of at most {limit:.0f}"
    else:
        why = f"the other evidence contradicts it: chi-square {chi2:.0f} of at most {limit:.0f}"
    return JudgedMeeting(meeting, float(chi2), why)


def _placed(given: Sequence[DrivePlaces], nodes: Nodes, T: FloatArray, covariance: FloatArray) -> dict[str, AlignedDrive]:
    row = {chain.drive.drive_id: d for d, chain in enumerate(nodes.chains)}
    out = {}
    for drive in given:
        name, nowhere = drive.drive_id, np.full((len(drive), 3), np.nan)
        if name not in row:
            out[name] = AlignedDrive(name, drive.T_map_submap, drive.covariance, nowhere, False)
            continue
        mine = slice(nodes.start[row[name]], nodes.start[row[name] + 1])
        shift = T[mine, :3, 3] - drive.T_map_submap[:, :3, 3] if drive.located else nowhere
        out[name] = AlignedDrive(name, T[mine], covariance[mine], shift, True)
    return out


def _check(drives: Sequence[DrivePlaces], meetings: Sequence[Meeting]) -> None:
    size: dict[str, int] = {}
    for drive in drives:
        if drive.drive_id in size:
            raise InputError(f"drive {drive.drive_id} comes twice", remedy="give each drive once")
        size[drive.drive_id] = len(drive)
    for k, meeting in enumerate(meetings):
        for name, submap in ((meeting.drive_a, meeting.submap_a), (meeting.drive_b, meeting.submap_b)):
            if not 0 <= submap < size.get(name, 0):
                what = f"names submap {submap} of drive {name}, which has {size.get(name, 0)}"
                raise InputError(what, record=f"meeting {k}", remedy="find the meetings of these drives again")
        if meeting.drive_a == meeting.drive_b and meeting.submap_a == meeting.submap_b:
            raise InputError("joins a submap with itself", record=f"meeting {k}", remedy="leave it out")
    if meetings:
        both = np.array([np.hstack([np.vstack([one.T_a_b, np.zeros((2, 4))]), one.covariance]) for one in meetings])
        wrong = ~np.isfinite(both).all(axis=(1, 2))
        wrong[~wrong] = np.linalg.eigvalsh(both[~wrong, :, 4:])[:, 0] <= 0.0
        if wrong.any():
            raise InputError("has no pose or no covariance", record=f"meeting {int(np.argmax(wrong))}", remedy="leave it out")
