"""Segmentation ahead of its turn: keyframes are labelled by other threads while the drive is still tracked."""

import shutil
import tempfile
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.files.atomic import UNFINISHED
from wayloom.labelling.voting_frames import right_images_vote
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stages.segmentation import MOST_AT_ONCE, network_of
from wayloom.segmentation.stage import segment_keyframes


@contextmanager
def labels_ahead(context: StageContext) -> Iterator[StageContext]:
    """The context whose odometry tells of its keyframes, so that its segmentation finds those labelled that there was time for.

    As it is where there is one thread only, or where frames between the keyframes vote as well.
    """
    if context.settings.threads < 2 or context.settings.labelling.between_keyframes:
        yield context
        return
    folder = Path(tempfile.mkdtemp(prefix=UNFINISHED, dir=context.inputs_dir))
    ahead = LabelsAhead(context, folder)
    try:
        yield replace(context, ahead=ahead)
    finally:
        ahead.finished()
        shutil.rmtree(folder, ignore_errors=True)


class LabelsAhead:
    """Labels the keyframes that it is told of in threads of its own, all but one of the settings', until it is asked for them.

    An image that cannot be labelled is left to the stage, which says why. Raises ModelError for a network that cannot be used.
    """

    def __init__(self, context: StageContext, folder: Path) -> None:
        self._context, self._folder = context, folder
        self._pool = ThreadPoolExecutor(min(context.settings.threads - 1, MOST_AT_ONCE))
        self._coming: list[Future[None]] = []
        self._network = context.network or network_of(context.settings)
        segment_keyframes(context.log, [], self._network, folder)

    def on_keyframe(self, frame: int) -> None:
        """A frame of the log has become a keyframe: label it as soon as a thread is free."""
        right = right_images_vote(len(self._coming) + 1, self._context.settings.labelling)[-1:]
        self._coming.append(self._pool.submit(self._label, frame, right))

    def finished(self) -> Path:
        """The folder of what was labelled, as `segment_keyframes` leaves it; what is not begun never is."""
        for one in self._coming:
            one.cancel()
        wait(self._coming)
        self._pool.shutdown()
        return self._folder

    def _label(self, frame: int, right: NDArray[np.bool_]) -> None:
        segment_keyframes(self._context.log, [frame], self._network, self._folder, right=right)
