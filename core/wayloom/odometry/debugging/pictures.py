"""Debug pictures of the odometry: depths and residuals on a keyframe, the window from above, the drive over time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.files.atomic import write_atomically
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.odometry.backend.window import Window, project_into
from wayloom.odometry.mapper import Mapper
from wayloom.odometry.tracking.alignment import Reference
from wayloom.odometry.tracking.recovery import TrackingResult

Image = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
NEAR_M, RESIDUAL_GREY = 3.0, 20.0
VIEW_PX, VIEW_AHEAD_M, VIEW_BEHIND_M = 600, 60.0, 20.0
FIELD_STEP_PX = 16
TITLE_PX = 18
INK = (40, 30, 20)


def keyframe_picture(
    mapper: Mapper, left: Image, alignment: TrackingResult | None, reference: Reference | None, camera: FloatArray
) -> Image:
    """(h', w', 3) BGR of the newest keyframe, left image (h, w): the depths of the live points, under them the residuals of its
    alignment with the reference, beside them the window from above; camera (4,) px."""
    column = np.vstack([depth_overlay(mapper, left), residual_map(left, alignment, reference, camera)])
    view = cv2.resize(
        window_from_above(mapper.window, mapper.stereo_rig.camera), (len(column), len(column)), interpolation=cv2.INTER_AREA
    )
    return np.hstack([column, np.asarray(view, np.uint8)])


def dimmed(left: Image) -> Image:
    """(h, w) to a darker (h, w, 3), on which colours show."""
    return np.repeat((left // 2 + 20)[..., None], 3, axis=2)


def coloured(shares: FloatArray, colours: int) -> NDArray[np.int64]:
    """(n, 3) BGR of shares (n,) 0 to 1 in one of OpenCV's colour maps."""
    levels = np.clip(255 * shares, 0, 255).astype(np.uint8)[:, None]
    return np.asarray(cv2.applyColorMap(levels, colours)[:, 0], np.int64) if len(shares) else np.zeros((0, 3), np.int64)


def dots(canvas: Image, uv: FloatArray, colours: NDArray[np.int64], radius: int = 2) -> None:
    """Draw dots at uv (n, 2) px."""
    for (u, v), colour in zip(np.rint(uv).astype(int).tolist(), colours.tolist(), strict=True):
        cv2.circle(canvas, (u, v), radius, colour, -1)


def titled(canvas: Image, text: str) -> Image:
    """The canvas with a line of text on a dark bar."""
    canvas[:TITLE_PX] = INK
    cv2.putText(canvas, text, (6, TITLE_PX - 5), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 255), 1, cv2.LINE_AA)
    return canvas


def depth_overlay(mapper: Mapper, left: Image) -> Image:
    """The live points in the newest keyframe, near red, far blue."""
    window, canvas = mapper.window, dimmed(left)
    projected = project_into(window, window.points, len(window) - 1, mapper.rig, mapper.settings.border)
    seen = projected[~np.isnan(projected[:, 0])]
    dots(canvas, seen[:, :2], coloured(seen[:, 2] * NEAR_M, cv2.COLORMAP_TURBO))
    frame = mapper.builder.keyframes[-1].frame
    return titled(canvas, f"frame {frame}: {len(seen)} points, red at {NEAR_M:g} m, bias {window.disparity_bias[0]:+.2f} px")


def residual_map(left: Image, alignment: TrackingResult | None, reference: Reference | None, camera: FloatArray) -> Image:
    """The reference points where the alignment put them, blue too dark, red too bright; nothing at the start of a segment."""
    canvas = dimmed(left)
    if alignment is None or reference is None:
        return titled(canvas, "start of a segment")
    fit = alignment.fit
    uv, residual = residuals(left, reference, fit.T_frame_keyframe, fit.brightness, camera)
    dots(canvas, uv, coloured(0.5 + 0.5 * residual / RESIDUAL_GREY, cv2.COLORMAP_JET))
    text = f"against keyframe {alignment.keyframe}: rms {fit.rms:.1f} grey, {100 * fit.saturated:.0f} % beyond, red +20"
    return titled(canvas, f"{text}, {alignment.tried} motions tried")


def residuals(
    image: Image, reference: Reference, T: FloatArray, brightness: FloatArray, camera: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Pixels (n, 2) and residuals (n,) grey of the reference's points in view; T (4, 4) T_frame_keyframe, camera (4,) px."""
    x, y, rho, grey = reference.levels[0].T
    p = np.column_stack([x, y, np.ones(len(x))]) @ T[:3, :3].T + rho[:, None] * T[:3, 3]
    p = np.where(p[:, 2:] > 1e-3, p, np.nan)
    u, v = camera[0] * p[:, 0] / p[:, 2] + camera[2], camera[1] * p[:, 1] / p[:, 2] + camera[3]
    seen = (u > 1) & (v > 1) & (u < image.shape[1] - 2) & (v < image.shape[0] - 2)
    u, v, grey = u[seen], v[seen], grey[seen]
    value = cv2.remap(image, u[:, None].astype(np.float32), v[:, None].astype(np.float32), cv2.INTER_LINEAR)[:, 0]
    return np.column_stack([u, v]), value.astype(np.float64) - (brightness[0] * grey + brightness[1])


def window_from_above(window: Window, camera: PinholeCamera) -> Image:
    """The window's keyframes (numbered) and points from above, in the newest keyframe's frame, z up."""
    scale = VIEW_PX / (VIEW_AHEAD_M + VIEW_BEHIND_M)
    canvas = np.full((VIEW_PX, VIEW_PX, 3), 250, np.uint8)
    T_newest_world = window.frames.T_cam_world[-1]
    T_newest_cam = np.array([T_newest_world @ se3.inverse(T) for T in window.frames.T_cam_world])
    p = window.points
    p_host = camera.rays(p.uv) / np.maximum(p.rho, 1e-4)[:, None]
    points = np.einsum("nij,nj->ni", T_newest_cam[p.host][:, :3, :3], p_host) + T_newest_cam[p.host][:, :3, 3]

    def place(xyz: FloatArray) -> FloatArray:
        return np.column_stack([VIEW_PX / 2 + scale * xyz[:, 0], scale * (VIEW_AHEAD_M - xyz[:, 2])])

    near = (np.abs(points[:, 0]) < 60) & (points[:, 2] < VIEW_AHEAD_M)
    host = p.host[near] / max(len(window) - 1, 1)
    dots(canvas, place(points[near]), coloured(host, cv2.COLORMAP_VIRIDIS), 1)
    for number, (u, v) in zip(window.keyframe.tolist(), place(T_newest_cam[:, :3, 3]).astype(int).tolist(), strict=True):
        cv2.circle(canvas, (u, v), 4, (0, 0, 200), -1)
        cv2.putText(canvas, str(number), (u + 6, v + 4), cv2.FONT_HERSHEY_SIMPLEX, 0.35, INK, 1, cv2.LINE_AA)
    return titled(canvas, f"window of {len(window)} keyframes, 80 m across")


def write_jpeg(file: Path, picture: Image) -> None:
    """picture (h, w, 3) BGR."""
    write_atomically(file, bytes(cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, 90))[1]))


def field_pixels(rig: StereoRig) -> FloatArray:
    """(n, 2) px of the right image at which the row field is shown, rows first."""
    v, u = np.mgrid[0 : rig.camera.height : FIELD_STEP_PX, 0 : rig.camera.width : FIELD_STEP_PX]
    return np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)


def write_row_field(file: Path, rig: StereoRig, moved: FloatArray) -> None:
    """A map of the rows' misalignment: moved (n, 2) px at `field_pixels`."""
    from matplotlib.figure import Figure

    shape = -(-rig.camera.height // FIELD_STEP_PX), -(-rig.camera.width // FIELD_STEP_PX)
    figure = Figure(figsize=(10, 4), layout="constrained")
    axes = figure.subplots()
    limit = max(0.1, float(np.abs(moved[:, 1]).max()))
    extent = (0.0, float(rig.camera.width), float(rig.camera.height), 0.0)
    image = axes.imshow(moved[:, 1].reshape(shape), cmap="RdBu", vmin=-limit, vmax=limit, extent=extent)
    axes.set(title="rows of the right image below the left's, px", xlabel="u px", ylabel="v px")
    figure.colorbar(image, ax=axes)
    figure.savefig(file, format="png")


NEVER_BELOW_ZERO = ("flow, px", "ms")
"""Panels whose rare peaks may leave the picture."""


def write_drive_plot(file: Path, frames: Sequence[dict[str, Any]]) -> None:
    """Curves over the frames: residual, points, brightness, bias, rows, time."""
    from matplotlib.figure import Figure

    panels = (
        ("residual, grey", ("rms_grey", "usual_rms_grey")), ("shares", ("visible", "saturated", "inlier_share")),
        ("brightness", ("gain",)), ("flow, px", ("flow_px", "shift_px")), ("live points", ("live_points",)),
        ("bias, px", ("bias_px",)), ("rows, px", ("row_c0_px", "row_c1_px", "row_c2_px")),
        ("ms", ("decode_ms", "track_ms", "adjust_ms")),
    )  # fmt: skip
    figure = Figure(figsize=(12, 2 * len(panels)), layout="constrained")
    all_axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    at = [values["frame"] for values in frames]
    lost = [values["frame"] for values in frames if values["outcome"] == "lost"]
    for axes, (title, names) in zip(all_axes, panels, strict=True):
        for name in names:
            axes.plot(at, [number(values.get(name)) for values in frames], label=name, linewidth=0.9)
        shown = [value for name in names for value in (number(values.get(name)) for values in frames) if np.isfinite(value)]
        if title in NEVER_BELOW_ZERO and shown:
            axes.set_ylim(0.0, 1.5 * float(np.percentile(shown, 98)) + 1e-3)
        axes.plot(lost, np.full(len(lost), axes.get_ylim()[0]), "rx", label="lost" if lost else None)
        axes.set_ylabel(title)
        axes.legend(loc="upper right", fontsize="x-small")
    all_axes[-1].set_xlabel("frame")
    figure.savefig(file, format="png")


def number(value: Any) -> float:
    """NaN for what is no finite number."""
    return float(value) if isinstance(value, int | float | np.floating) and np.isfinite(value) else float("nan")
