"""Registration of the drives of a map, pair by pair: which may have seen the same street, and what they have in common.

Drives whose places are known are compared where these are near each other, a drive without GNSS with the drives that it looks most
like. What two drives have in common depends on the two alone and is kept.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Final

import structlog

from wayloom.errors import WayloomError
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.georeference.uncertainty import moved_covariance
from wayloom.pipeline.code_version import code_version
from wayloom.pipeline.digests import sha256_of_json
from wayloom.places.files import load_places
from wayloom.stitching.appearance_pairs import likeness
from wayloom.stitching.meeting_files import encode_meetings
from wayloom.stitching.meetings import find_meetings
from wayloom.stitching.placed_drive import PlacedDrive
from wayloom.store import jobs, maps, meetings
from wayloom.store.tables.maps import MeetingRow
from wayloom.submaps.files import load_submaps
from wayloom.submaps.submap import PlacedSubmap
from wayloom_workers.stage_hooks import StageAttempt

log = structlog.get_logger()
SHARE: Final = 0.4
"""Of the progress, when all pairs are registered."""
HELD_DRIVES: Final = 4
COMPARED_BY: Final = "wayloom.stitching.meetings"
"""The module whose code registers a pair; that which tells how alike two drives are is below it."""
Pair = tuple[str, str]
"""Ids of two drives, the lesser first."""


@dataclass(frozen=True, slots=True)
class Candidates:
    """The drives that a stitch looks at, by their ids.

    submaps  drive and position of those that the map's frame reaches
    guests   those that are in the map only where their meetings place them; loose: of these, those without GNSS
    """

    submaps: frozenset[tuple[str, int]]
    guests: frozenset[str]
    loose: frozenset[str]

    @property
    def reached(self) -> frozenset[str]:
        """Those that the map's frame reaches."""
        return frozenset(drive_id for drive_id, _ in self.submaps)


class PairRegistry:
    """The pairs of drives of one map, read and registered in one stitch. loose: ids of the drives without a place."""

    def __init__(self, attempt: StageAttempt, frame: MapFrame, loose: frozenset[str]) -> None:
        self._attempt, self._frame, self._map_id, self._loose = attempt, frame, str(attempt.claim.map_id), loose
        self._database, self._blobs = attempt.context.database, attempt.context.blobs
        self._settings = attempt.context.settings.meetings
        self._drive = lru_cache(HELD_DRIVES)(self._loaded)

    def register(self, pairs: Sequence[Pair]) -> None:
        """Compare the drives of each pair, where that was not done before. What is found is kept at once."""
        for count, pair in enumerate(pairs):
            self._attempt.progress(SHARE * count / len(pairs), f"pair {count + 1} of {len(pairs)} drives")
            inputs, known = self._inputs(pair), self._known(pair)
            if inputs is None or self._is_done(known, inputs):
                continue
            one, other = (self._drive(drive_id) for drive_id in pair)
            if one is None or other is None:
                continue
            found = find_meetings(one, other, self._settings)
            digest = self._blobs.put(encode_meetings(found))
            names = {"drive_a": pair[0][:12], "drive_b": pair[1][:12]}
            log.info("drives compared", **names, meetings=len(found.meetings), tried=found.report["tried"])
            self._keep(pair, inputs, digest, len(found.meetings), None if known is None else known.likeness)

    def meet(self, pair: Pair) -> bool:
        """Whether drives that were compared have something in common."""
        known = self._known(pair)
        return known is not None and known.count > 0

    def alike(self, loose: str, others: Sequence[str]) -> list[str]:
        """Those of the others that a drive without a place looks most like, the most first: `compared_drives` of them at most."""
        found = {other: self._likeness(loose, other) for other in others}
        ranked = sorted((-value, other) for other, value in found.items() if value)
        return [other for _, other in ranked[: self._settings.compared_drives]]

    def _likeness(self, loose: str, other: str) -> float:
        """Looked up, or found and kept; 0 where one of the drives cannot be read."""
        pair = pair_of(loose, other)
        if other in self._loose:  # either may ask: what is kept must not depend on who did
            loose, other = pair
        inputs, known = self._inputs(pair), self._known(pair)
        if inputs is None:
            return 0.0
        if known is not None and known.inputs == inputs and known.likeness is not None:
            return known.likeness
        asking, held = self._drive(loose), self._drive(other)
        if asking is None or held is None:
            return 0.0
        value = likeness(held.places, asking.places)
        self._keep(pair, inputs, "", 0, value)
        return value

    def _is_done(self, known: MeetingRow | None, inputs: str) -> bool:
        """Whether the pair was compared, and its file is there."""
        return known is not None and known.digest != "" and known.inputs == inputs and self._blobs.has(known.digest)

    def _known(self, pair: Pair) -> MeetingRow | None:
        with self._database.read() as session:
            return session.get(MeetingRow, (self._map_id, *pair))

    def _keep(self, pair: Pair, inputs: str, digest: str, count: int, like: float | None) -> None:
        row = MeetingRow(
            map_id=self._map_id, drive_a=pair[0], drive_b=pair[1], inputs=inputs, digest=digest, count=count, likeness=like
        )
        with self._database.write() as session:
            meetings.keep(session, [row])

    def _inputs(self, pair: Pair) -> str | None:
        """Digest of all that the meetings of two drives depend on; None where one was processed before there were places."""
        with self._database.read() as session:
            keys = [jobs.keys_of_outputs(session, drive_id, ("places", "submaps")) for drive_id in pair]
        if any(len(found) < 2 for found in keys):
            return None
        return sha256_of_json({
            "drives": list(pair),
            "outputs": keys,
            "frame": [self._frame.lon_deg, self._frame.lat_deg, self._frame.height_m],
            "settings": self._settings.model_dump(mode="json"),
            "code": code_version(COMPARED_BY).text,
        })  # fmt: skip

    def _loaded(self, drive_id: str) -> PlacedDrive | None:
        """A drive with its own places, as its stages left it; None, and a warning, where they are gone or are of different runs."""
        with self._database.read() as session:
            keys = jobs.keys_of_outputs(session, drive_id, ("places", "submaps"))
        stages = self._attempt.context.folders.drive(drive_id) / "stages"
        try:
            places = load_places(_only(stages / "places" / keys["places"]))
            own = load_submaps(stages / "submaps" / keys["submaps"])
            return PlacedDrive(drive_id, places, tuple(_in_frame(item, self._frame, drive_id) for item in own))
        except (WayloomError, KeyError) as error:
            log.warning("drive cannot be compared with others", drive_id=drive_id, error=str(error))
            return None


def register_pairs(
    attempt: StageAttempt, frame: MapFrame, changed: Sequence[str], candidates: Candidates
) -> dict[str, frozenset[str]]:
    """Register the changed drives with those near them, and drives without a place with those that they are like, with each other
    too.

    Returns for each drive without a place the ids of these: it is to be heard with no others, so that who came first decides
    nothing.
    """
    registry = PairRegistry(attempt, frame, candidates.loose)
    located, loose = sorted(candidates.reached - candidates.loose), sorted(candidates.loose)
    registry.register(_near_pairs(attempt, changed, frozenset(located)))
    alike = {drive_id: set(registry.alike(drive_id, located)) for drive_id in loose}
    registry.register(sorted({pair_of(one, other) for one, others in alike.items() for other in others}))
    met = {one for one, others in alike.items() if any(registry.meet(pair_of(one, other)) for other in others)}
    for one, other in _register_from(
        registry, met, {one: registry.alike(one, [two for two in loose if two != one]) for one in loose}
    ):
        alike[one].add(other)
        alike[other].add(one)
    return {drive_id: frozenset(others) for drive_id, others in alike.items()}


def _register_from(registry: PairRegistry, met: set[str], alike: Mapping[str, Sequence[str]]) -> list[Pair]:
    """Register drives without a place with each other, beginning at those that meet one with a place: others could place nobody.

    alike : which other one each looks most like; a pair of which either names the other is compared. Returns these pairs, sorted.
    """
    left = {pair_of(one, other) for one, others in alike.items() for other in others}
    done: list[Pair] = []
    while near := sorted(pair for pair in left if met & set(pair)):
        registry.register(near)
        met = met | {name for pair in near if registry.meet(pair) for name in pair}
        left -= set(near)
        done += near
    return sorted(done)


def pair_of(one: str, other: str) -> Pair:
    """The two ids, the lesser first."""
    return min(one, other), max(one, other)


def _near_pairs(attempt: StageAttempt, changed: Sequence[str], located: frozenset[str]) -> list[Pair]:
    """Pairs of a changed drive with one that may have seen the same street, sorted."""
    pairs: set[Pair] = set()
    with attempt.context.database.read() as session:
        for drive_id in located & frozenset(changed):
            for other in located & frozenset(maps.candidates_near(session, drive_id)):
                pairs.add(pair_of(drive_id, other))
    return sorted(pairs)


def _only(folder: Path) -> Path:
    """The file of places in the stage's folder."""
    return next(iter(sorted(folder.glob("*.places"))), folder / "drive.places")


def _in_frame(item: PlacedSubmap, frame: MapFrame, drive_id: str) -> PlacedSubmap:
    """A submap in the map's frame, or, without a place, as it is."""
    if item.frame is None:
        return replace(item, drive_id=drive_id, before=None)
    T = wgs84.T_enu_enu(frame, item.frame)
    covariance = moved_covariance(T, item.covariance[None])[0]
    return replace(item, T_enu_submap=T @ item.T_enu_submap, covariance=covariance, drive_id=drive_id, frame=frame, before=None)
