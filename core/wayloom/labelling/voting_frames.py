"""Frames whose images vote on the points' classes."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from wayloom.odometry.types import OdometryResult

if TYPE_CHECKING:
    from wayloom.labelling.settings import LabellingSettings


def voting_frames(odometry: OdometryResult, settings: "LabellingSettings") -> NDArray[np.int32]:
    """The frames of the log whose images vote, increasing: the keyframes, or every tracked frame."""
    if not settings.between_keyframes:
        return odometry.keyframes.frame
    frames = np.union1d(np.flatnonzero(odometry.trajectory.tracked), odometry.keyframes.frame)
    return frames.astype(np.int32)


def right_images_vote(count: int, settings: "LabellingSettings") -> NDArray[np.bool_]:
    """(count,) of the voters in time order, whether the right image votes as well."""
    every = settings.right_images
    return np.arange(count) % every == 0 if every else np.zeros(count, np.bool_)
