"""Segmentation stage: label images, class scores and small grey images of both cameras at every keyframe, as files."""

import hashlib
import io
import json
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import VOID
from wayloom.config.progress import Progress, silent
from wayloom.errors import StageError
from wayloom.files.atomic import write_atomically
from wayloom.logs.sidecars.sidecar import SIMULATED_RIG
from wayloom.logs.types import DriveLog
from wayloom.segmentation.network import Network
from wayloom.segmentation.scores import Scores, decode_scores, encode_scores

Labels = NDArray[np.uint8]

FORMAT_VERSION: Final = 3
SIDES: Final = ("left", "right")
SMALL: Final = 2
"""The images are kept, grey, at 1 / SMALL of their size: enough to tell whether a point looks the same in two of them."""
_FOLDERS: Final = (*SIDES, *(f"{side}_small" for side in SIDES), *(f"{side}_scores" for side in SIDES))


def segment_keyframes(
    log: DriveLog,
    keyframes: Sequence[int] | NDArray[np.integer[Any]],
    network: Network,
    out_dir: Path,
    progress: Progress = silent,
) -> "KeyframeLabels":
    """Write `left/%010d.png` and `right/%010d.png`, named by frame index, and `model.json`, into out_dir.

    Beside them lie `left_small/` and `right_small/`, the grey images at half size (npy), and, from a network that gives scores,
    `left_scores/` and `right_scores/`, the likeliest classes of each cell (`encode_scores`).
    A run that was cut short goes on where it stopped: a pair whose files can be read is kept as long as `model.json` says
    that the same network labelled the same drive. Every file appears whole or not at all.
    keyframes : frame indices (`Keyframes.frame` of the odometry)
    Raises LogError from the log's reader.
    """
    out_dir.mkdir(parents=True, exist_ok=True)
    _claim(out_dir, _facts(log, network), network.gives_scores)
    shape = (log.rig.camera.height, log.rig.camera.width)
    frames = [int(index) for index in keyframes]
    for done, index in enumerate(frames):
        progress(done / len(frames), f"labelling keyframe {done + 1} of {len(frames)}")
        _segment_pair(log, network, out_dir, index, shape)
    progress(1.0, f"labelled {len(frames)} keyframes")
    return KeyframeLabels(out_dir, frames)


def _segment_pair(log: DriveLog, network: Network, out_dir: Path, index: int, shape: tuple[int, int]) -> None:
    if all(_is_done(out_dir, side, index, shape, network.gives_scores) for side in SIDES):
        return
    frame = log.frame(index)
    images = (frame.left, frame.right)
    for side, image, labelled in zip(SIDES, images, network.label_pair(*images), strict=True):
        write_atomically(_small_path(out_dir, side, index), _as_npy(small_grey(image)))
        if labelled.scores is not None:
            write_atomically(scores_path(out_dir, side, index), encode_scores(labelled.scores))
        _write_png(label_path(out_dir, side, index), labelled.labels)


def _is_done(out_dir: Path, side: str, index: int, shape: tuple[int, int], with_scores: bool) -> bool:
    labels, small = _read(label_path(out_dir, side, index)), _read_small(_small_path(out_dir, side, index))
    if labels is None or small is None or labels.shape != shape:
        return False
    return not with_scores or _read_scores(scores_path(out_dir, side, index)) is not None


class KeyframeLabels:
    """The label images of a folder that `segment_keyframes` wrote, decoded when asked for; the last few stay in memory."""

    def __init__(self, folder: Path, frames: Sequence[int] | NDArray[np.integer[Any]], held: int = 4) -> None:
        """frames: the frame index of each keyframe row (`Keyframes.frame`); held: how many images stay in memory."""
        self._folder = folder
        self._frames = [int(index) for index in frames]
        self._held = held
        self._cache: OrderedDict[tuple[str, int], Labels] = OrderedDict()
        self._with_scores = (folder / f"{SIDES[0]}_scores").is_dir()
        facts = _facts_in(folder)
        self.may_be_void = facts.get("may_be_void") is not False
        self.is_balanced = facts.get("balanced") is True

    def __len__(self) -> int:
        return len(self._frames)

    def left(self, keyframe: int) -> Labels:
        """(h, w) uint8 train ids of the left image of the keyframe in this row. Raises StageError where the file is missing."""
        return self._get("left", keyframe)

    def right(self, keyframe: int) -> Labels:
        """(h, w) uint8 train ids of the right image of the keyframe in this row. Raises StageError where the file is missing."""
        return self._get("right", keyframe)

    def scores(self, side: str, keyframe: int) -> Scores | None:
        """The likeliest classes of the "left" or "right" image of the keyframe in this row; None from a network without scores.

        Raises StageError where the file is missing though the network gives scores.
        """
        if not self._with_scores:
            return None
        path = scores_path(self._folder, side, self._frames[keyframe])
        scores = _read_scores(path)
        if scores is None:
            raise StageError(f"{path}: scores missing or damaged; run the segmentation again")
        return scores

    def small(self, side: str, keyframe: int) -> Labels:
        """(h, w) uint8: the "left" or "right" image of the keyframe in this row, grey, at half size (`small_grey`).

        Raises StageError where the file is missing.
        """
        path = _small_path(self._folder, side, self._frames[keyframe])
        image = _read_small(path)
        if image is None:
            raise StageError(f"{path}: image missing or damaged; run the segmentation again")
        return image

    def _get(self, side: str, keyframe: int) -> Labels:
        key = (side, keyframe)
        if key not in self._cache:
            path = label_path(self._folder, side, self._frames[keyframe])
            labels = _read(path)
            if labels is None:
                raise StageError(f"{path}: label image missing or damaged; run the segmentation again")
            self._cache[key] = labels
            if len(self._cache) > self._held:
                self._cache.popitem(last=False)
        self._cache.move_to_end(key)
        return self._cache[key]


def label_path(folder: Path, side: str, frame: int) -> Path:
    """Where the labels of one image lie."""
    return folder / side / f"{frame:010d}.png"


def small_grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(h, w) grey or (h, w, 3) RGB uint8 to grey at half size, means of 2 x 2 pixels; an odd last row or column is left out."""
    grey = image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
    height, width = (n // SMALL * SMALL for n in grey.shape)
    return np.asarray(cv2.resize(grey[:height, :width], (width // SMALL, height // SMALL), interpolation=cv2.INTER_AREA), np.uint8)


def scores_path(folder: Path, side: str, frame: int) -> Path:
    """Where the scores of one image lie."""
    return folder / f"{side}_scores" / f"{frame:010d}.bin"


def _small_path(folder: Path, side: str, frame: int) -> Path:
    return folder / f"{side}_small" / f"{frame:010d}.npy"


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


def _facts_in(folder: Path) -> dict[str, Any]:
    """What `model.json` says; nothing where it cannot be read."""
    try:
        facts = json.loads((folder / "model.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return facts if isinstance(facts, dict) else {}


def _claim(out_dir: Path, facts: dict[str, Any], with_scores: bool) -> None:
    """Leave what the same network labelled of the same drive; anything else in the folder is removed first."""
    path = out_dir / "model.json"
    text = json.dumps(facts, indent=1, sort_keys=True) + "\n"
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.unlink(missing_ok=True)
        for name in _FOLDERS:
            for old in (out_dir / name).glob("[0-9]*.*"):
                old.unlink()
            if name.endswith("_scores") and (out_dir / name).is_dir():
                (out_dir / name).rmdir()
    for name in _FOLDERS if with_scores else _FOLDERS[:-2]:
        (out_dir / name).mkdir(exist_ok=True)
    write_atomically(path, text.encode())


def _read(path: Path) -> Labels | None:
    if not path.is_file():
        return None
    data = np.fromfile(path, np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    return None if image is None or image.ndim != 2 or image.dtype != np.uint8 else np.asarray(image, np.uint8)


def _as_npy(image: Labels) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.ascontiguousarray(image), version=(1, 0), allow_pickle=False)
    return buffer.getvalue()


def _read_small(path: Path) -> Labels | None:
    try:
        image = np.load(path, allow_pickle=False)
    except (OSError, EOFError, ValueError):
        return None
    usable = isinstance(image, np.ndarray) and image.ndim == 2 and image.dtype == np.uint8
    return np.asarray(image, np.uint8) if usable else None


def _read_scores(path: Path) -> Scores | None:
    try:
        return decode_scores(path.read_bytes())
    except (OSError, ValueError):
        return None


def _write_png(path: Path, labels: Labels) -> None:
    written, data = cv2.imencode(".png", labels, [cv2.IMWRITE_PNG_COMPRESSION, 3])
    if not written:
        raise StageError(f"{path}: the label image could not be encoded")
    write_atomically(path, data.tobytes())
