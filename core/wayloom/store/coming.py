"""Result of a drive that is processed anew, while the map and the drive's pages keep the one before: `Drive.coming`.

    asked          settings instead of the service's
    since          when it was asked for
    facts, placed, track   what the pages shall show, as the columns of `Drive`
    verdict        grade, reasons and gate of the new geo-reference
    before         columns of the verdict that the pages show until the publication, once the new one counts
    stitch         the map's job whose version takes the new result in
    error          why the run failed; the result before stays

None of a drive that is not processed anew: what its stages find is the drive's at once. The functions below write to one or the
other, so that the hooks of the stages need not know.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from wayloom.store.tables.drives import Drive

KEEPS_ITS_STATE: Final = ("done", "held", "quarantined")
"""Of a drive that has a result: it stays what it is while it is processed anew, and where that fails."""
VERDICT: Final = (
    "grade", "gate", "reasons", "sound", "admitted", "map_verdict", "released_at", "released_by", "released_why",
)  # fmt: skip


def facts_of(drive: Drive) -> dict[str, Any]:
    """The facts of the run that is under way, or was the last one."""
    found: dict[str, Any] = drive.facts if drive.coming is None else drive.coming.get("facts", {})
    return found


def note(drive: Drive, **facts: Any) -> None:
    """Add facts."""
    if drive.coming is None:
        drive.facts = {**drive.facts, **facts}
    else:
        drive.coming = {**drive.coming, "facts": {**facts_of(drive), **facts}}


def note_place(drive: Drive, placed: bool, track: Sequence[Sequence[float]] | None) -> None:
    """Whether the drive has a place on Earth, and where it went."""
    if drive.coming is None:
        drive.placed, drive.track = placed, None if track is None else [*track]
    else:
        drive.coming = {**drive.coming, "placed": placed, "track": track}


def fail(drive: Drive, error: str, finished_at: float) -> None:
    """A stage of the drive was given up. What the drive had before stays, and its state with it."""
    if drive.coming is not None:
        drive.coming = {**drive.coming, "error": error}
    if drive.coming is None or drive.state not in KEEPS_ITS_STATE:
        drive.state, drive.error, drive.finished_at = "failed", error, finished_at


def resume(drive: Drive) -> None:
    """The stages that were given up are tried again."""
    if drive.coming is not None:
        drive.coming = {name: value for name, value in drive.coming.items() if name != "error"}
    if drive.coming is None or drive.state not in KEEPS_ITS_STATE:
        drive.state, drive.error, drive.finished_at = "queued", None, None


def shown_verdict(drive: Drive) -> Mapping[str, Any]:
    """The columns of VERDICT that belong to the result that the map shows."""
    return (drive.coming or {}).get("before") or {name: getattr(drive, name) for name in VERDICT}
