"""The small stages, with a stage places that leaves a real file of places."""

from places.made_places import random_places
from service_kit import little_stages
from wayloom.places.files import PLACES_FILE, save_places
from wayloom_workers.stage_hooks import StageAttempt, StageHooks, keyed_by_inputs


def leave_places(attempt: StageAttempt) -> None:
    """As `little_stages.run`, and the file."""
    little_stages.run(attempt)
    save_places(random_places(1), attempt.out_dir / PLACES_FILE)


def hooks(stage: str) -> StageHooks:
    """Those of `little_stages`, but for the places."""
    return StageHooks(keyed_by_inputs(leave_places)) if stage == "places" else little_stages.hooks(stage)
