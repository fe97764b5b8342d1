"""What the odometry decided and why, written while it runs: `frames.csv`, `energies.csv`, one picture a keyframe, and at the end
plots of the drive. Nothing of it changes a result; without it nothing of it is computed.
"""

import copy
import csv
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np
from numpy.typing import NDArray

from wayloom.odometry.backend import adjustment
from wayloom.odometry.debugging import pictures
from wayloom.odometry.frame_source import GreyPair
from wayloom.odometry.kernels.tracking import mean_flow
from wayloom.odometry.tracking.alignment import Reference

if TYPE_CHECKING:
    from wayloom.odometry.odometry import Odometry

Image = NDArray[np.uint8]
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
class Debug:
    """Writes into `folder`, which is made. Files are whole up to the last frame whenever one looks."""

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

    def adjustment(self, odometry: "Odometry") -> None:
        """The energy that the window's adjustment, about to run, will reach after no, one, two … iterations, on copies of it."""
        s, keyframe = odometry.settings, len(odometry.harvest.keyframes) - 1
        for iterations in range(s.adjust_iterations + 1):
            window = copy.copy(odometry.window)
            window.frames, window.points = copied(window.frames), copied(window.points)
            window.inertial, window.delta = copied(window.inertial), window.delta.copy()
            self.energy = adjustment.adjust(window, odometry.rig, odometry.robust, s.affine_prior, iterations)
            frame = odometry.harvest.keyframes[keyframe].frame
            self.writers[ENERGIES_FILE].writerow((keyframe, frame, iterations, f"{self.energy:.6g}"))

    def frame(self, odometry: "Odometry", frame: GreyPair, left: Image) -> None:
        """One line about a frame that was just processed, and a picture where it became a keyframe."""
        is_keyframe = bool(odometry.harvest.keyframes) and odometry.harvest.keyframes[-1].frame == frame.index
        reference = reference_of(odometry)
        values = {
            **self._outcome(odometry, frame, is_keyframe),
            **alignment_values(odometry, reference),
            **window_values(odometry),
            **self._times(odometry.stopwatch.seconds),
        }
        values["energy"] = self.energy if is_keyframe and len(odometry.window) > 1 else ""
        self.frames.append(values)
        self.writers[FRAMES_FILE].writerow([shown(values.get(name, "")) for name in FRAME_COLUMNS])
        if is_keyframe:
            picture = pictures.keyframe_picture(odometry, left, reference)
            pictures.write_jpeg(self.folder / KEYFRAMES_FOLDER / f"{frame.index:06d}.jpg", picture)

    def finish(self, odometry: "Odometry") -> None:
        """The plots of the whole drive."""
        pictures.write_drive_plot(self.folder / "drive.png", self.frames)
        pixels = pictures.field_pixels(odometry.stereo_rig)
        moved = odometry.right_rectifier.real_pixels(pixels) - pixels
        pictures.write_row_field(self.folder / "row_field.png", odometry.stereo_rig, moved)
        self.close()

    def close(self) -> None:
        """Close the files."""
        for stream in self.streams:
            stream.close()

    def _outcome(self, odometry: "Odometry", frame: GreyPair, is_keyframe: bool) -> dict[str, Any]:
        row = odometry.harvest.frames[-1]
        loss = odometry.losses[-1] if odometry.losses and odometry.losses[-1]["frame"] == frame.index else {"reason": ""}
        return {
            "frame": frame.index, "t_ns": frame.t_ns,
            "outcome": "keyframe" if is_keyframe else "tracked" if row.tracked else "lost",
            "loss": loss["reason"], "segment": row.segment, "keyframes": len(odometry.harvest.keyframes),
            "keyframe_reason": odometry.keyframe_reason if is_keyframe else "",
        }  # fmt: skip

    def _times(self, seconds: Mapping[str, float]) -> dict[str, float]:
        """ms of each part since the last call."""
        spent = {part: 1e3 * (total - self.seconds.get(part, 0.0)) for part, total in seconds.items()}
        self.seconds = dict(seconds)
        known = {f"{part}_ms": spent.pop(part, 0.0) for part in PARTS}
        return {**known, "other_ms": sum(spent.values())}


def copied(bundle: Any) -> Any:
    """A named tuple of arrays with its own arrays; numbers stay."""
    return type(bundle)(*(column.copy() if isinstance(column, np.ndarray) else column for column in bundle))


def reference_of(odometry: "Odometry") -> Reference | None:
    """What the frame just processed was aligned with, where it still exists."""
    found = odometry.found
    return None if found is None else next((r for r in odometry.references if r.keyframe == found.keyframe), None)


def alignment_values(odometry: "Odometry", reference: Reference | None) -> dict[str, Any]:
    """Of the frame's alignment, found or failed; nothing where none was tried."""
    found = odometry.found
    if found is None:
        return {}
    fit = found.fit
    flow, shift = ("", "") if reference is None else mean_flow(reference.levels[0], fit.T_frame_keyframe, odometry.cameras[0])
    return {
        "reference_keyframe": found.keyframe, "rms_grey": fit.rms, "usual_rms_grey": odometry.smoothed_rms, "visible": fit.visible,
        "saturated": fit.saturated, "gain": fit.brightness[0], "offset_grey": fit.brightness[1], "motions_tried": found.tried,
        "features": found.features, "flow_px": flow, "shift_px": shift,
    }  # fmt: skip


def window_values(odometry: "Odometry") -> dict[str, Any]:
    """Of the window as it is now."""
    window, c = odometry.window, odometry.right_rectifier.coefficients
    F, points = len(window), window.points
    values = {"window": F, "live_points": len(points.rho), "bias_px": window.delta[0]}
    values |= {f"row_c{k}_px": c[k] for k in range(3)}
    if F and window.inlier.shape[1] == F + 1:
        open_ = points.host != F - 1
        values["points_in_newest"] = int((points.host == F - 1).sum())
        values["inlier_share"] = float((window.inlier[open_, F - 1] > 0).mean()) if open_.any() else ""
    return values


def shown(value: Any) -> Any:
    """Numbers to six digits, everything else as it is."""
    return f"{value:.6g}" if isinstance(value, float | np.floating) else value
