"""Segmentation stage: label images, class scores and small grey images of both cameras at every keyframe, as files."""

import hashlib
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import VOID
from wayloom.config.progress import Progress, silent
from wayloom.config.side_by_side import in_order
from wayloom.files.atomic import write_atomically
from wayloom.files.label_png import encode_label_png
from wayloom.logs.sidecars.sidecar import SIMULATED_RIG
from wayloom.logs.types import DriveLog
from wayloom.segmentation.keyframe_labels import (
    MODEL_FILE,
    SIDES,
    SMALL,
    KeyframeLabels,
    Labels,
    label_path,
    read_labels,
    read_scores,
    read_small,
    scores_path,
    small_path,
)
from wayloom.segmentation.network import Network
from wayloom.segmentation.scores import encode_scores

FORMAT_VERSION: Final = 3
_FOLDERS: Final = (*SIDES, *(f"{side}_small" for side in SIDES), *(f"{side}_scores" for side in SIDES))


def segment_keyframes(
    log: DriveLog,
    keyframes: Sequence[int] | NDArray[np.integer[Any]],
    network: Network,
    out_dir: Path,
    progress: Progress = silent,
    right: NDArray[np.bool_] | None = None,
    threads: int = 1,
    ahead: Path | None = None,
) -> KeyframeLabels:
    """Write `left/%010d.png` and `right/%010d.png`, named by frame index, and `model.json`, into out_dir.

    Beside them lie `left_small/` and `right_small/`, the grey images at half size (npy), and, from a network that gives scores,
    `left_scores/` and `right_scores/`, the likeliest classes of each cell (`encode_scores`).
    A run that was cut short goes on where it stopped: images whose files can be read are kept as long as `model.json` says
    that the same network labelled the same drive. Every file appears whole or not at all.
    keyframes : frame indices (`Keyframes.frame` of the odometry)
    right : (K,) of which keyframes the right image is labelled, too; None: of all
    threads : keyframes that are labelled at a time
    ahead : a folder, on the same disk, of another call for the same drive and network, out of which finished images are moved
    Raises LogError from the log's reader.
    """
    out_dir.mkdir(parents=True, exist_ok=True)
    facts = _facts(log, network)
    _claim(out_dir, facts, network.gives_scores)
    ahead = ahead if ahead is not None and _is_claimed(ahead, facts) else None
    shape = (log.rig.camera.height, log.rig.camera.width)
    frames = [int(index) for index in keyframes]

    def segment(row: int) -> None:
        sides = SIDES if right is None or right[row] else SIDES[:1]
        if ahead is None or not all(_is_moved(ahead, out_dir, side, frames[row], network.gives_scores) for side in sides):
            _segment_frame(log, network, out_dir, frames[row], shape, sides)

    for done, _ in enumerate(in_order(segment, range(len(frames)), threads), 1):
        progress(done / len(frames), f"labelled {done} of {len(frames)} keyframes")
    return KeyframeLabels(out_dir, frames)


def _segment_frame(
    log: DriveLog, network: Network, out_dir: Path, index: int, shape: tuple[int, int], sides: Sequence[str]
) -> None:
    if all(_is_done(out_dir, side, index, shape, network.gives_scores) for side in sides):
        return
    frame = log.frame(index)
    images = (frame.left, frame.right)[: len(sides)]
    for side, image, labelled in zip(sides, images, network.label_images(images), strict=True):
        write_atomically(small_path(out_dir, side, index), _as_npy(small_grey(image)))
        if labelled.scores is not None:
            write_atomically(scores_path(out_dir, side, index), encode_scores(labelled.scores))
        write_atomically(label_path(out_dir, side, index), encode_label_png(labelled.labels))


def _is_moved(ahead: Path, out_dir: Path, side: str, index: int, with_scores: bool) -> bool:
    """Whether an image's files lay in `ahead`, and lie in out_dir now; its labels, which are written last, say that all do."""
    if not label_path(ahead, side, index).is_file():
        return False
    for path in (small_path, *([scores_path] if with_scores else []), label_path):
        path(ahead, side, index).rename(path(out_dir, side, index))
    return True


def _is_done(out_dir: Path, side: str, index: int, shape: tuple[int, int], with_scores: bool) -> bool:
    labels, small = read_labels(label_path(out_dir, side, index)), read_small(small_path(out_dir, side, index))
    if labels is None or small is None or labels.shape != shape:
        return False
    return not with_scores or read_scores(scores_path(out_dir, side, index)) is not None


def small_grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(h, w) grey or (h, w, 3) RGB uint8 to grey at half size, means of 2 x 2 pixels; an odd last row or column is left out."""
    grey = image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
    height, width = (n // SMALL * SMALL for n in grey.shape)
    return np.asarray(cv2.resize(grey[:height, :width], (width // SMALL, height // SMALL), interpolation=cv2.INTER_AREA), np.uint8)


def _facts(log: DriveLog, network: Network) -> dict[str, Any]:
    """What `model.json` says: which network labelled which drive."""
    d = network.description
    camera = log.rig.camera
    drive = hashlib.sha256(np.asarray(log.t_ns, np.int64).tobytes())
    drive.update(f"{log.name} {camera.width}x{camera.height}".encode())
    return {
        "format": FORMAT_VERSION,
        "name": d.name,
        "sha256": network.sha256,
        "licence": d.licence,
        "settings": hashlib.sha256(d.model_dump_json().encode()).hexdigest(),
        "device": network.device,
        "may_be_void": VOID in d.classes,
        "balanced": d.balanced,
        "drive": drive.hexdigest(),
        "grey_images_to_a_colour_network": d.colour and not log.colour,
        "photographs_to_a_network_of_simulated_streets": d.simulated and not (log.rig_id or "").startswith(SIMULATED_RIG),
    }


def _claim(out_dir: Path, facts: dict[str, Any], with_scores: bool) -> None:
    """Leave what the same network labelled of the same drive; anything else in the folder is removed first."""
    path = out_dir / MODEL_FILE
    if not _is_claimed(out_dir, facts):
        path.unlink(missing_ok=True)
        for name in _FOLDERS:
            for old in (out_dir / name).glob("[0-9]*.*"):
                old.unlink()
            if name.endswith("_scores") and (out_dir / name).is_dir():
                (out_dir / name).rmdir()
    for name in _FOLDERS if with_scores else _FOLDERS[:-2]:
        (out_dir / name).mkdir(exist_ok=True)
    write_atomically(path, _as_text(facts).encode())


def _is_claimed(folder: Path, facts: dict[str, Any]) -> bool:
    """Whether the images in a folder are of the same network and drive."""
    path = folder / MODEL_FILE
    return path.is_file() and path.read_text(encoding="utf-8") == _as_text(facts)


def _as_text(facts: dict[str, Any]) -> str:
    return json.dumps(facts, indent=1, sort_keys=True) + "\n"


def _as_npy(image: Labels) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.ascontiguousarray(image), version=(1, 0), allow_pickle=False)
    return buffer.getvalue()
