"""Training recipe of `wayloom-city`: phases, cities, steps, rates, scores, and the description beside the file. Without PyTorch."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT, CLASS_NAMES, VOID
from wayloom.simulation.recording.dataset import FIRST_TRAINING_SEED

CROP: Final = (192, 448)
BATCH: Final = 4
RATE: Final = 3e-3
WARM_UP: Final = 0.04
MEAN: Final = (0.485, 0.456, 0.406)
STD: Final = (0.229, 0.224, 0.225)
MULTIPLE: Final = 32


@dataclass(frozen=True, slots=True)
class Phase:
    """A stretch of training with a rate that rises once and falls to nothing. It goes on from the phase before.

    half, full : seeds of the cities whose views are seen in half and in full size; views : of each city
    seed       : of crops and batches, and, in the first phase, of the first weights
    """

    name: str
    steps: int
    half: tuple[int, ...]
    full: tuple[int, ...]
    views: int
    seed: int


CITIES: Final = tuple(range(FIRST_TRAINING_SEED + 1, FIRST_TRAINING_SEED + 9))
HELD_OUT: Final = (1901, 1902)
"""Judged by alone, like every city of a preset of `wayloom simulate`, never trained on."""
PHASES: Final = (
    Phase("first", steps=5931, half=CITIES, full=(1021, 1022, 1023), views=40, seed=2),
    Phase("second", steps=3446, half=CITIES, full=(1021,), views=32, seed=1),
)


def trial(steps: int) -> tuple[Phase, ...]:
    """The same phases with so many steps each, on two views of one city: whether everything works, in minutes."""
    return tuple(replace(phase, steps=steps, half=CITIES[:1], full=(), views=2) for phase in PHASES)


def share_of_rate(done: float) -> float:
    """Linear warm-up, then half a cosine down to nothing. done : share of the phase, 0 to 1."""
    if done < WARM_UP:
        return done / WARM_UP
    return 0.5 * (1 + float(np.cos(np.pi * (done - WARM_UP) / (1 - WARM_UP))))


def phases_left(phases: tuple[Phase, ...], folder: Path) -> tuple[tuple[Phase, ...], Path | None]:
    """The phases that an earlier run into the folder has not finished, and the state that it left, None for nothing."""
    done = 0
    while done < len(phases) and _is_done(phases[done], folder):
        done += 1
    return phases[done:], state_file(phases[done - 1], folder) if done else None


def state_file(phase: Phase, folder: Path) -> Path:
    """The network's weights after a phase."""
    return folder / f"{phase.name}.state"


def note_done(phase: Phase, folder: Path) -> None:
    """Leave beside its state what the phase was, so that another recipe does not go on from it."""
    (folder / f"{phase.name}.json").write_text(_text(phase))


def _is_done(phase: Phase, folder: Path) -> bool:
    note = folder / f"{phase.name}.json"
    return state_file(phase, folder).is_file() and note.is_file() and note.read_text() == _text(phase)


def _text(phase: Phase) -> str:
    return json.dumps({name: getattr(phase, name) for name in Phase.__dataclass_fields__}) + "\n"


def confusion_of(truth: NDArray[np.uint8], found: NDArray[np.uint8]) -> NDArray[np.int64]:
    """(19, 19) pixels by true class and found class. truth, found : (h, w) uint8 train ids; void in the truth does not count."""
    known = truth != VOID
    both = truth[known].astype(np.int64) * CLASS_COUNT + found[known]
    return np.bincount(both, minlength=CLASS_COUNT**2).reshape(CLASS_COUNT, CLASS_COUNT)


def scores_of(confusion: NDArray[np.int64]) -> dict[str, Any]:
    """Mean IoU and accuracy in percent over the classes present, and the IoU of each."""
    hits, truths, founds = np.diag(confusion), confusion.sum(1), confusion.sum(0)
    present = [c for c in range(CLASS_COUNT) if truths[c]]
    iou = {CLASS_NAMES[c]: float(100 * hits[c] / (truths[c] + founds[c] - hits[c])) for c in present}
    return {"miou": float(np.mean(list(iou.values()))), "oa": float(100 * hits.sum() / confusion.sum()), "iou": iou}


def description(digest: str) -> str:
    """The TOML that goes beside the network. digest : hex SHA-256 of the ONNX file."""
    return f'''name = "wayloom-city"
title = "small network trained on the simulated city; colour or grey"
file = "wayloom-city.onnx"
sha256 = "{digest}"
licence = "Apache-2.0"
source = "in the package; made by benchmarks/train_network.py from simulated images alone"
layout = "NCHW"
dtype = "float32"
mean = {list(MEAN)}
std = {list(STD)}
size = "dynamic"
multiple = {MULTIPLE}
output = "logits"
colour = false
balanced = true
simulated = true
'''
