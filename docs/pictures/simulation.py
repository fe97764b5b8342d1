"""Draws docs/pictures/simulation.jpg: `python docs/pictures/simulation.py`."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from wayloom.config.classes import PALETTE
from wayloom.simulation.recording.presets import DEMO
from wayloom.simulation.recording.record_drive import plan_recording, route_plan
from wayloom.simulation.recording.worlds import build_world
from wayloom.simulation.sensors.capture import CaptureSettings, StereoCamera, capture
from wayloom.simulation.traffic.drives import plan_drives

OUT = Path(__file__).with_name("simulation.jpg")
WIDTH, HEIGHT = 600, 160
FARTHEST_M = 80.0
SHOWN = ((0, 18), (1, 55))
"""Drive of the demo, and frame."""


def main() -> None:
    """One column a drive: image, classes, depth of the left camera."""
    world = build_world(DEMO.city, DEMO.light, "full")
    drives = plan_drives(world.city, [route_plan(plan, DEMO) for plan in DEMO.drives])
    columns = []
    for number, frame in SHOWN:
        recording = plan_recording(DEMO, number, drives[number])
        camera = StereoCamera(recording.plan.vehicle, "full", recording.motion)
        around = replace(world, traffic=recording.drive.traffic)
        t_s = recording.t_s[frame : frame + 1]
        pair = next(capture(camera, around, t_s, CaptureSettings(recording.drive.left_out, True, (0,))))
        assert pair.truth is not None
        truth = pair.truth[0]
        near = np.where(truth.depth > 0, 1 - np.sqrt(np.minimum(truth.depth, FARTHEST_M) / FARTHEST_M), 0)
        depth = cv2.applyColorMap((255 * near).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
        depth[truth.depth == 0] = 0
        pictures = (pair.left[..., ::-1], PALETTE[truth.class_id][..., ::-1], depth)
        columns.append(np.vstack([cv2.resize(p, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) for p in pictures]))
    cv2.imwrite(str(OUT), np.hstack(columns), [cv2.IMWRITE_JPEG_QUALITY, 90])


if __name__ == "__main__":
    main()
