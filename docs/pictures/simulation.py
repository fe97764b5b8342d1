"""Draws docs/pictures/simulation.jpg: `python docs/pictures/simulation.py`."""

from pathlib import Path

import cv2
import numpy as np

from wayloom.config.classes import PALETTE
from wayloom.simulation.camera import Sensor, exposed, wanted_gain
from wayloom.simulation.presets import DEMO
from wayloom.simulation.rigs import sized_rig
from wayloom.simulation.simulate import EGO_CLEARANCE_M, draw_pair, plan_route
from wayloom.simulation.worlds import build_world

OUT = Path(__file__).with_name("simulation.jpg")
WIDTH, HEIGHT = 600, 160
FARTHEST_M = 80.0
SHOWN = ((0, 18), (1, 55))
"""Drive of the demo, and frame."""


def main() -> None:
    """One column a drive: image, classes, depth of the left camera."""
    rig = sized_rig("full")
    world = build_world(DEMO.seed, DEMO.columns, DEMO.rows, DEMO.light, "full", DEMO.traffic)
    columns = []
    for number, frame in SHOWN:
        route = plan_route(world, DEMO.drives[number], DEMO.rate_hz)
        left_out = world.traffic.meeting(route.x, route.y, route.t_s, EGO_CLEARANCE_M)
        drawn = draw_pair(world, rig, route.T_enu_cam[frame], float(route.t_s[frame]), left_out, True)
        assert drawn.truth is not None
        radiance, truth = drawn.radiance[0], drawn.truth[0]
        image = exposed(radiance, wanted_gain(radiance), rig.camera, Sensor(), np.random.default_rng(0))
        near = np.where(truth.depth > 0, 1 - np.sqrt(np.minimum(truth.depth, FARTHEST_M) / FARTHEST_M), 0)
        depth = cv2.applyColorMap((255 * near).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
        depth[truth.depth == 0] = 0
        pictures = (image[..., ::-1], PALETTE[truth.class_id][..., ::-1], depth)
        columns.append(np.vstack([cv2.resize(p, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) for p in pictures]))
    cv2.imwrite(str(OUT), np.hstack(columns), [cv2.IMWRITE_JPEG_QUALITY, 90])


if __name__ == "__main__":
    main()
