"""Conversion of a drive log into another format, frame by frame.

Images that are stored rectified as PNG or JPEG are carried over byte for byte; others are decoded, rectified where their log is,
and written as PNG. Time stamps, calibration, fixes, samples, exposures and true poses go with them; scans and labels do not.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol, runtime_checkable

import numpy as np

from wayloom import __version__
from wayloom.config.progress import Progress, silent
from wayloom.errors import ConfigError, LogError
from wayloom.logs.drive_writer import DriveWriter, ImageEncoding, SensorExtrinsics
from wayloom.logs.euroc.euroc_writer import EurocWriter
from wayloom.logs.images.image_files import JPEG_START, PNG_SIGNATURE
from wayloom.logs.kitti.kitti_odometry_writer import KittiOdometryWriter
from wayloom.logs.registry import open_log
from wayloom.logs.ros2.mcap_writer import McapWriter
from wayloom.logs.types import DriveLog

TARGETS: Final[dict[str, type[DriveWriter]]] = {"kitti": KittiOdometryWriter, "euroc": EurocWriter, "mcap": McapWriter}
BEST_JPEG, ORIGIN_LENGTH = 100, 256


@runtime_checkable
class EncodedLog(Protocol):
    """A log that gives its images as they are stored: `encoded_pair`, the files' bytes, None where they are not rectified."""

    def encoded_pair(self, index: int) -> tuple[bytes, bytes] | None: ...


@dataclass(frozen=True, slots=True)
class Conversion:
    """What was written: its folder, frames, how many of them byte for byte, and what the target has no place for, in words."""

    path: Path
    frames: int
    copied: int
    left_out: tuple[str, ...]


def convert_log(log: DriveLog, out: Path, target: str, progress: Progress = silent) -> Conversion:
    """Write the log to the folder `out`, which appears when it is whole.

    target : a key of TARGETS. Raises ConfigError for others, LogError for images that cannot be read or a folder that is not empty.
    """
    if target not in TARGETS:
        raise ConfigError(f"unknown format {target!r}", record="--to", remedy=f"use one of {', '.join(TARGETS)}")
    writer_of, left_out = TARGETS[target], list[str]()
    suffix = None if (first := encoded_pair(log, 0)) is None else kind_of(first)
    truth = log.truth
    if truth is not None and not writer_of.holds_partial_truth and not np.isfinite(truth).all():
        left_out.append(f"true poses: {target} has no place for frames without one")
        truth = None
    with writer_of(
        out,
        log.rig,
        rig_id=log.rig_id,
        vehicle_id=log.vehicle_id,
        extrinsics=SensorExtrinsics(
            None if "lever arm" in log.missing or log.gnss is None else log.p_cam_gnss, log.T_cam_imu, None, log.receiver
        ),
        encoding=ImageEncoding(colour=log.colour, jpeg_quality=BEST_JPEG if suffix == "jpeg" else None),
    ) as writer:
        writer.sidecar = writer.sidecar.model_copy(update={"origin": origin_of(log)})
        copied, exposures = 0, []
        for index, frame in enumerate(log.frames()):
            pair = encoded_pair(log, index) if suffix is not None else None
            if pair is not None and kind_of(pair) == suffix:
                writer.write_encoded(index, *pair)
                copied += 1
            elif suffix == "jpeg":
                remedy = "a log holds images of one kind: export it again"
                raise LogError("is no JPEG, as the first image is", file=log.path, record=f"frame {index}", remedy=remedy)
            else:
                writer.write_images(index, frame.left, frame.right)
            writer.count(frame.t_ns, None if truth is None else truth[index])
            exposures.append(frame.exposure_s)
            progress((index + 1) / len(log), f"frame {index + 1} of {len(log)}")
        if log.gnss is not None:
            writer.set_gnss(log.gnss)
        if log.imu is not None:
            writer.set_imu(log.imu)
        if all(exposed is not None for exposed in exposures):
            writer.set_exposures(np.array(exposures, np.float64))
    return Conversion(out, len(log), copied, (*left_out, *changed_fixes(log, open_log(out))))


def changed_fixes(before: DriveLog, after: DriveLog) -> tuple[str, ...]:
    """In words, how many fixes read as of another type: NavSatFix tells a float fix from an integer one by its sigma alone."""
    if before.gnss is None or after.gnss is None:
        return ()
    changed = int((before.gnss.fix_type != after.gnss.fix_type).sum())
    return (f"the type of {changed} of {len(before.gnss)} fixes, which {after.format} tells by sigma",) if changed else ()


def encoded_pair(log: DriveLog, index: int) -> tuple[bytes, bytes] | None:
    """The images as the log stores them; None where they have to be decoded."""
    return log.encoded_pair(index) if isinstance(log, EncodedLog) else None


def kind_of(pair: tuple[bytes, bytes]) -> str | None:
    """ "png" or "jpeg" where both are, else None."""
    starts: tuple[tuple[str, bytes], ...] = (("png", PNG_SIGNATURE), ("jpeg", JPEG_START))
    return next((kind for kind, start in starts if all(data.startswith(start) for data in pair)), None)


def origin_of(log: DriveLog) -> str:
    """Where a converted log came from, in words."""
    rectified = ", rectified" if getattr(log, "rectifies", False) else ""
    return f"{log.format} {log.name!r}{rectified}; wayloom {__version__}"[:ORIGIN_LENGTH]
