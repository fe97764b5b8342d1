"""Segmentation stage: class labels and scores of every image that votes.

Leaves left/ and right/ (PNG, named by frame), their scores and small grey images, and model.json.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from wayloom.config.progress import Progress
from wayloom.labelling.voting_frames import right_images_vote, voting_frames
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.tracked_drive import tracked_drive
from wayloom.segmentation.catalogue import DEFAULT_MODEL, find_model, locate
from wayloom.segmentation.network import Network
from wayloom.segmentation.providers import resolved_device
from wayloom.segmentation.stage import segment_keyframes

if TYPE_CHECKING:
    from wayloom.pipeline.settings import ProcessSettings

MOST_AT_ONCE: Final = 4
"""Keyframes that are labelled at a time: each holds what the network computes on the way. More threads share one's work."""


def run(context: StageContext, out_dir: Path, progress: Progress) -> None:
    """Raises ModelError for a network that cannot be used."""
    settings, ahead = context.settings, context.ahead
    folder = None if ahead is None else ahead.finished()
    network = context.network or network_of(settings)
    frames = voting_frames(tracked_drive(context, "way"), settings.labelling)
    right = right_images_vote(len(frames), settings.labelling)
    segment_keyframes(context.log, frames, network, out_dir, progress, right, at_once(settings), folder)
    network.give_back()


def at_once(settings: "ProcessSettings") -> int:
    """Keyframes that are labelled at a time."""
    return min(settings.threads, MOST_AT_ONCE)


def network_of(settings: "ProcessSettings") -> Network:
    """The network of the settings, on whose images the threads work that keyframes at a time leave. Raises ModelError."""
    chosen = settings.segmentation
    return Network(find_model(chosen.model or DEFAULT_MODEL), settings.threads // at_once(settings), chosen.device)


def key_parts(context: StageContext) -> dict[str, Any]:
    """The network by content: another file under the same name is another network. Raises ModelError."""
    chosen = context.settings.segmentation
    description = find_model(chosen.model or DEFAULT_MODEL)
    return {
        "description": description.model_dump(mode="json", exclude={"folder"}),
        "sha256": locate(description)[1],
        "device": resolved_device(chosen.device),
    }
