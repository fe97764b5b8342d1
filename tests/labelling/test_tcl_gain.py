"""TCL above the single image: on made drives whose label images err at random, by more than the drives scatter."""

from dataclasses import replace

import numpy as np
import pytest
from made_drive import CAMERA, RIG, HeldImages, made_drive

from wayloom.evaluation.label_scores import count, scores
from wayloom.labelling.settings import PAPER
from wayloom.labelling.tcl import label_points
from wayloom.odometry.types import OdometryResult

KEYFRAMES, CLASSES, SEEDS = 8, 5, range(6)
RIGHT_SHARE = 0.65
"""Of an image's labels; the others are another class at random, in each image anew."""
FORMS = ("baseline", "mono", "stereo")


def noisy_images(drive: OdometryResult, truth: np.ndarray, rng: np.random.Generator) -> HeldImages:
    """Label images that hold at each point's place its class, or a wrong one: at the places of the host, the observers, and theirs
    in the right images; void elsewhere."""
    points, T_world_cam = drive.points, drive.keyframes.T_world_cam
    images = {side: [np.full((CAMERA.height, CAMERA.width), 255, np.uint8) for _ in range(KEYFRAMES)] for side in ("left", "right")}
    z = 1 / points.inverse_depth.astype(float)
    rays = CAMERA.rays(points.uv_host.astype(float)) * z[:, None]
    for p in range(len(points)):
        p_world = T_world_cam[points.host[p]] @ np.append(rays[p], 1.0)
        for j in (int(points.host[p]), *points.obs_keyframe[points.obs_start[p] : points.obs_start[p + 1]].tolist()):
            p_left = (np.linalg.inv(T_world_cam[j]) @ p_world)[:3]
            for side, p_cam in (("left", p_left), ("right", p_left + RIG.t_right_left)):
                if p_cam[2] <= 0:
                    continue
                u, v = np.floor(CAMERA.project(p_cam[None])[0] + 0.5).astype(int)
                if 0 <= u < CAMERA.width and 0 <= v < CAMERA.height:
                    wrong = (truth[p] + rng.integers(1, CLASSES)) % CLASSES
                    images[side][j][v, u] = truth[p] if rng.random() < RIGHT_SHARE else wrong
    return HeldImages(images["left"], images["right"])


@pytest.fixture(scope="module")
def miou() -> np.ndarray:
    """(seeds, forms) percent."""
    rows = []
    for seed in SEEDS:
        rng = np.random.default_rng(100 + seed)
        drive = replace(made_drive(seed, KEYFRAMES, 600, bias_px=0.0), row_coefficients=np.zeros(3))
        truth = rng.integers(0, CLASSES, len(drive.points)).astype(np.uint8)
        labels = label_points(drive, noisy_images(drive, truth, rng), PAPER)
        rows.append([scores(count(truth, getattr(labels, form))).miou for form in FORMS])
    return np.array(rows)


def test_the_single_image_is_as_right_as_its_labels(miou: np.ndarray) -> None:
    """IoU of a share q of right labels and even errors: q / (2 - q). Points that fall into one pixel take each other's label."""
    assert miou[:, 0].mean() == pytest.approx(100 * RIGHT_SHARE / (2 - RIGHT_SHARE), abs=5.0)


@pytest.mark.parametrize(("form", "over"), [("mono", "baseline"), ("stereo", "baseline"), ("stereo", "mono")])
def test_votes_are_better_by_more_than_the_drives_scatter(miou: np.ndarray, form: str, over: str) -> None:
    gains = miou[:, FORMS.index(form)] - miou[:, FORMS.index(over)]
    assert gains.mean() > 3 * gains.std(ddof=1)
