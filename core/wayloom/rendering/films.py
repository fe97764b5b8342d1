"""Films: frames one after another into an MP4, a WebM, an animated GIF or a folder of pictures, by the ending of its name."""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.errors import UnknownFormatError, WayloomError
from wayloom.files.atomic import UNFINISHED, new_folder

Picture = NDArray[np.uint8]
FRAMES_A_S: Final = 25
CODECS: Final = {".mp4": "mp4v", ".webm": "VP90"}
"""What OpenCV's own FFmpeg writes everywhere: MPEG-4 part 2 for players and slides, VP9 for browsers."""
GIF_EVERY: Final = 2
ENDINGS: Final = (*CODECS, ".gif", "")
"""None is a folder of frames."""


def check_film(path: Path) -> None:
    """Raises UnknownFormatError where the name asks for no film."""
    if path.suffix not in ENDINGS:
        remedy = "give a .mp4, a .webm, a .gif, or a folder for the frames"
        raise UnknownFormatError(f"{path.suffix} is no film", file=path, remedy=remedy)


def write_film(path: Path, frames: Iterable[Picture]) -> int:
    """Write the frames (H, W, 3) RGB; how many. A file takes its name when it is whole. Raises UnknownFormatError, OSError."""
    check_film(path)
    if path.suffix == "":
        return _write_frames(path, frames)
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f"{UNFINISHED}{os.getpid()}{path.suffix}")  # the writers go by the ending
    try:
        count = _write_gif(unfinished, frames) if path.suffix == ".gif" else _write_video(unfinished, frames)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
    return count


def _write_frames(folder: Path, frames: Iterable[Picture]) -> int:
    count = 0
    with new_folder(folder) as new:
        for count, frame in enumerate(frames, 1):
            (new / f"{count - 1:05d}.png").write_bytes(cv2.imencode(".png", _bgr(frame))[1].tobytes())
    return count


def _write_video(path: Path, frames: Iterable[Picture]) -> int:
    writer, count = None, 0
    try:
        for frame in frames:
            count += 1
            if writer is None:
                codec, size = cv2.VideoWriter.fourcc(*CODECS[path.suffix]), (frame.shape[1], frame.shape[0])
                with _silent_libraries():
                    writer = cv2.VideoWriter(str(path), codec, float(FRAMES_A_S), size)
                if not writer.isOpened():
                    raise WayloomError(f"this OpenCV writes no {path.suffix}; give a .gif, or a folder for the frames")
            writer.write(_bgr(frame))
    finally:
        if writer is not None:
            writer.release()
    return count


@contextmanager
def _silent_libraries() -> Iterator[None]:
    """Without what C libraries print to the process's standard error: OpenCV has a line of its own for every WebM."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _write_gif(path: Path, frames: Iterable[Picture]) -> int:
    """Every second frame: a GIF holds all of them in memory, and its pauses are hundredths of a second."""
    film = cv2.Animation()
    film.frames = [_bgr(frame) for number, frame in enumerate(frames) if number % GIF_EVERY == 0]
    film.durations = [1000 * GIF_EVERY // FRAMES_A_S] * len(film.frames)
    if not cv2.imwriteanimation(str(path), film):
        raise WayloomError("this OpenCV writes no GIF; give a folder for the frames")
    return len(film.frames)


def _bgr(frame: Picture) -> Picture:
    return np.ascontiguousarray(frame[:, :, ::-1])
