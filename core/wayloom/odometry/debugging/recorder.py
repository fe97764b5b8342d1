"""Debug recorder of the odometry: what it decided and why, written while it runs.

`frames.csv`, `energies.csv`, one picture a keyframe, and at the end plots of the drive. Nothing of it changes a result; without it
nothing of it is computed.
"""

import copy
import csv
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from wayloom.odometry.backend import adjustment
from wayloom.odometry.debugging import pictures
from wayloom.odometry.kernels.tracking import mean_flow
from wayloom.odometry.mapper import Mapper
from wayloom.odometry.rig.posed_pair import PosedPair
from wayloom.odometry.tracker import Tracker
from wayloom.odometry.tracking.alignment import Reference
from wayloom.odometry.tracking.frame import GreyPair
from wayloom.odometry.tracking.frame_status import FrameStatus

PARTS = ("decode", "pyramid", "track", "rows", "select", "stereo", "adjust", "marginalise", "reference")
FRAME_COLUMNS = (
    "frame", "t_ns", "outcome", "loss", "segment", "reference_keyframe", "rms_grey", "usual_rms_grey", "visible", "saturated",
    "gain", "offset_grey", "motions_tried", "features", "flow_px", "shift_px", "keyframe_reason", "keyframes", "window",
    "live_points", "points_in_newest", "inlier_share", "energy", "bias_px", "row_c0_px", "row_c1_px", "row_c2_px",
    *(f"{part}_ms" for part in PARTS), "other_ms",
)  # fmt: skip
ENERGY_COLUMNS = ("keyframe", "frame", "iteration", "energy")
FRAMES_FILE, ENERGIES_FILE, KEYFRAMES_FOLDER = "frames.csv", "energies.csv", "keyframes"


@dataclass(slots=True)
class DebugRecorder:
    """Observer that writes into `folder`, which is made. Files are whole up to the last frame whenever one looks."""

    folder: Path
    frames: list[dict[str, Any]] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    energy: float = float("nan")
    streams: list[TextIO] = field(default_factory=list)
    writers: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        (self.folder / KEYFRAMES_FOLDER).mkdir(parents=True, exist_ok=True)
        for name, columns in ((FRAMES_FILE, FRAME_COLUMNS), (ENERGIES_FILE, ENERGY_COLUMNS)):
            stream = (self.folder / name).open("w", buffering=1, encoding="utf-8", newline="")
            self.streams.append(stream)
            self.writers[name] = csv.writer(stream)
            self.writers[name].writerow(columns)

    def on_interrupt(self) -> None:
        """Said by the status of the frame."""

    def on_keyframe(self, pair: PosedPair, /) -> None:
        """Looked at when the frame is done."""

    def on_adjustment(self, mapper: Mapper, /) -> None:
        """The energy that the adjustment about to run will reach after no, one, two … iterations, on copies of the window."""
        s, keyframe = mapper.settings, len(mapper.builder.keyframes) - 1
        for iterations in range(s.adjust_iterations + 1):
            window = copy.copy(mapper.window)
            window.frames, window.points = copied(window.frames), copied(window.points)
            window.inertial, window.disparity_bias = copied(window.inertial), window.disparity_bias.copy()
            self.energy = adjustment.adjust(window, mapper.rig, mapper.robust, s.affine_prior, iterations)
            frame = mapper.builder.keyframes[keyframe].frame
            self.writers[ENERGIES_FILE].writerow((keyframe, frame, iterations, f"{self.energy:.6g}"))

    def on_frame(self, pair: GreyPair, status: FrameStatus, tracker: Tracker, mapper: Mapper, /) -> None:
        """One line about a frame that was just processed, and a picture where it became a keyframe."""
        reference = reference_of(status, tracker)
        values = {
            **outcome_values(pair, status, mapper),
            **alignment_values(status, tracker, reference),
            **window_values(mapper),
            **self._times(tracker.stopwatch.seconds),
        }
        values["energy"] = self.energy if status.is_keyframe and len(mapper.window) > 1 else ""
        self.frames.append(values)
        self.writers[FRAMES_FILE].writerow([shown(values.get(name, "")) for name in FRAME_COLUMNS])
        if status.is_keyframe:
            picture = pictures.keyframe_picture(mapper, pair.left, status.alignment, reference, tracker.cameras[0])
            pictures.write_jpeg(self.folder / KEYFRAMES_FOLDER / f"{pair.index:06d}.jpg", picture)

    def on_finish(self, mapper: Mapper, /) -> None:
        """The plots of the whole drive."""
        pictures.write_drive_plot(self.folder / "drive.png", self.frames)
        pixels = pictures.field_pixels(mapper.stereo_rig)
        moved = mapper.right_rectifier.real_pixels(pixels) - pixels
        pictures.write_row_field(self.folder / "row_field.png", mapper.stereo_rig, moved)
        self.close()

    def close(self) -> None:
        """Close the files."""
        for stream in self.streams:
            stream.close()

    def _times(self, seconds: Mapping[str, float]) -> dict[str, float]:
        """ms of each part since the last call."""
        spent = {part: 1e3 * (total - self.seconds.get(part, 0.0)) for part, total in seconds.items()}
        self.seconds = dict(seconds)
        known = {f"{part}_ms": spent.pop(part, 0.0) for part in PARTS}
        return {**known, "other_ms": sum(spent.values())}


def copied(bundle: Any) -> Any:
    """A named tuple of arrays with its own arrays; numbers stay."""
    return type(bundle)(*(column.copy() if isinstance(column, np.ndarray) else column for column in bundle))


def outcome_values(pair: GreyPair, status: FrameStatus, mapper: Mapper) -> dict[str, Any]:
    """Of what became of the frame."""
    return {
        "frame": status.index, "t_ns": pair.t_ns,
        "outcome": "keyframe" if status.is_keyframe else "tracked" if status.tracked else "lost",
        "loss": status.failure or "", "segment": status.segment, "keyframes": len(mapper.builder.keyframes),
        "keyframe_reason": status.keyframe_reason or "",
    }  # fmt: skip


def reference_of(status: FrameStatus, tracker: Tracker) -> Reference | None:
    """What the frame just processed was aligned with, where it still exists."""
    alignment = status.alignment
    return None if alignment is None else next((r for r in tracker.references if r.keyframe == alignment.keyframe), None)


def alignment_values(status: FrameStatus, tracker: Tracker, reference: Reference | None) -> dict[str, Any]:
    """Of the frame's alignment, believed or not; nothing where none was tried."""
    alignment = status.alignment
    if alignment is None:
        return {}
    fit = alignment.fit
    flow, shift = ("", "") if reference is None else mean_flow(reference.levels[0], fit.T_frame_keyframe, tracker.cameras[0])
    return {
        "reference_keyframe": alignment.keyframe, "rms_grey": fit.rms, "usual_rms_grey": tracker.smoothed_rms,
        "visible": fit.visible, "saturated": fit.saturated, "gain": fit.brightness[0], "offset_grey": fit.brightness[1],
        "motions_tried": alignment.tried, "features": alignment.features, "flow_px": flow, "shift_px": shift,
    }  # fmt: skip


def window_values(mapper: Mapper) -> dict[str, Any]:
    """Of the window as it is now."""
    window, c = mapper.window, mapper.right_rectifier.coefficients
    F, points = len(window), window.points
    values = {"window": F, "live_points": len(points.rho), "bias_px": window.disparity_bias[0]}
    values |= {f"row_c{k}_px": c[k] for k in range(3)}
    if F and window.inlier.shape[1] == F + 1:
        open_ = points.host != F - 1
        values["points_in_newest"] = int((points.host == F - 1).sum())
        values["inlier_share"] = float((window.inlier[open_, F - 1] > 0).mean()) if open_.any() else ""
    return values


def shown(value: Any) -> Any:
    """Numbers to six digits, everything else as it is."""
    return f"{value:.6g}" if isinstance(value, float | np.floating) else value
