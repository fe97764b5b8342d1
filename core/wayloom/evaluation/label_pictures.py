"""Figures of labelled points over keyframe images: ground truth, single image, after the vote (the paper's figs. 4 and 5).

Points that the vote corrected are boxed green, those that are still wrong red.
"""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import PALETTE_WITH_VOID, VOID
from wayloom.evaluation.labels import LabelledPoints

Image = NDArray[np.uint8]

GREEN: Final = (40, 220, 60)
RED: Final = (235, 40, 40)
ROWS: Final = (("truth", "ground truth"), ("baseline", "single image"), ("best", "after the vote"))
CAPTION_PX: Final = 22


def best_keyframes(done: LabelledPoints, wanted: int = 3, row: str = "best") -> list[int]:
    """The keyframes with the most points that the vote put right, far from each other, in order."""
    host, every = done.odometry.points.host, done.matches.judged_with_boundaries
    corrected = every & (done.labels["baseline"] != done.matches.truth) & (done.labels[row] == done.matches.truth)
    counts = np.bincount(host[corrected], minlength=len(done.odometry.keyframes)).astype(np.int64)
    chosen: list[int] = []
    for k in np.argsort(-counts, kind="stable").tolist():
        if counts[k] and all(abs(k - other) >= max(1, len(counts) // (2 * wanted)) for other in chosen):
            chosen.append(k)
    return sorted(chosen[:wanted])


def figure(done: LabelledPoints, keyframes: list[int], row: str = "best") -> Image:
    """(h, w, 3) RGB: a column for each keyframe; from the top ground truth, single image, after the vote."""
    columns = [np.concatenate([_panel(done, k, kind, title, row) for kind, title in ROWS]) for k in keyframes]
    return np.concatenate(columns, axis=1)


def write_figure(done: LabelledPoints, file: str, wanted: int = 3, row: str = "best") -> bytes | None:
    """The figure as the bytes of an image of the file's kind; None where the vote corrected nothing."""
    keyframes = best_keyframes(done, wanted, row)
    if not keyframes:
        return None
    suffix = file[file.rfind(".") :] if "." in file else ".png"
    picture = cv2.cvtColor(figure(done, keyframes, row), cv2.COLOR_RGB2BGR)
    return bytes(cv2.imencode(suffix, picture)[1])


def _panel(done: LabelledPoints, k: int, kind: str, title: str, row: str) -> Image:
    frame = done.drive.log.frame(int(done.odometry.keyframes.frame[k]))
    left = frame.left if frame.left.ndim == 3 else np.repeat(frame.left[:, :, None], 3, axis=2)
    picture = (0.55 * left).astype(np.uint8)
    truth = done.matches.truth
    every = np.flatnonzero((done.odometry.points.host == k) & done.matches.judged_with_boundaries)
    labels = truth if kind == "truth" else done.labels["baseline"] if kind == "baseline" else done.labels[row]
    for p in every.tolist():
        u, v = (round(float(x)) for x in done.odometry.points.uv_host[p])
        colour = tuple(int(c) for c in PALETTE_WITH_VOID[labels[p]])
        cv2.circle(picture, (u, v), 5, (255, 255, 255), -1, cv2.LINE_AA)
        cv2.circle(picture, (u, v), 4, colour, -1, cv2.LINE_AA)
        if kind == "best" and truth[p] != VOID:
            was, now = done.labels["baseline"][p] == truth[p], labels[p] == truth[p]
            if not now or not was:
                cv2.rectangle(picture, (u - 8, v - 8), (u + 8, v + 8), GREEN if now else RED, 2)
    caption = np.full((CAPTION_PX, picture.shape[1], 3), 255, np.uint8)
    text = f"{title}, {done.drive.name}, frame {frame.index}"
    cv2.putText(caption, text, (6, CAPTION_PX - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (20, 20, 20), 1, cv2.LINE_AA)
    return np.concatenate([caption, picture])
