"""Stated sigmas are those of the errors: neither too small nor too wide, from drives together or one by one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from made_observations import LENS, REGIONS, made_drive

from wayloom.calibration.covariance import lens_covariance
from wayloom.calibration.learn import learn_rig
from wayloom.calibration.rig_file import RigFile, read_rig_file, write_rig_file
from wayloom.calibration.score_moments import ScoreMoments, moments_of
from wayloom.calibration.settings import CalibrationSettings
from wayloom.geometry.lens import RightLens, lens_from_values
from wayloom.odometry.rig.calibration_observations import CalibrationObservations

SETTINGS = CalibrationSettings()
RIGS = 20
NORMAL_95 = 1.96


@dataclass(frozen=True)
class Fleet:
    """How drives of a made rig err beside the noise of single matches."""

    drives: int
    groups: int
    group_px: float
    region_px: float

    def of(self, seed: int, lens: RightLens = LENS, spread: float = 0.0) -> list[CalibrationObservations]:
        """The drives of one rig. spread : how far each drive's own lens is from the rig's, in hundredths of the prior's sigma."""
        rng = np.random.default_rng(seed)
        field = self.region_px * rng.normal(size=(*REGIONS[::-1], 2))
        return [
            made_drive(
                lens_from_values(lens.values + 0.01 * spread * SETTINGS.lens.sigmas * rng.normal(size=10)),
                1000 * seed + k, groups=self.groups, points=60, group_px=self.group_px, field_px=field,
                offsets=tuple(rng.normal(size=3) * SETTINGS.drive.sigmas),
            )
            for k in range(self.drives)
        ]  # fmt: skip


FLEETS = {
    "noise alone": Fleet(3, 10, 0.0, 0.0),
    "errors that groups share": Fleet(3, 10, 0.1, 0.0),
    "errors that regions share": Fleet(3, 10, 0.0, 0.02),
    "one drive and both": Fleet(1, 20, 0.1, 0.02),
}


def one_by_one(drives: Sequence[CalibrationObservations]) -> RigFile:
    known = None
    for drive in drives:
        known = learn_rig([drive], known=known).rig
    assert known is not None
    return known


def all_at_once(drives: Sequence[CalibrationObservations]) -> RigFile:
    return learn_rig(drives).rig


def normalised_errors(rigs: Sequence[RigFile]) -> tuple[np.ndarray, float]:
    """(rigs, 10) errors in stated sigmas, and the half width of their mean square's 95 % interval about 1.

    The parameters' errors are correlated: with R their correlation, the sum of n rigs' squares has the variance 2 n tr(R^2).
    """
    z = np.array([(rig.lens.values - LENS.values) / rig.sigma for rig in rigs])
    squares = []
    for rig in rigs:
        C = lens_covariance(rig, SETTINGS)[0]
        squares.append(float((C**2 / np.outer(np.diag(C), np.diag(C))).sum()))
    return z, NORMAL_95 * float(np.sqrt(2 * np.sum(squares))) / z.size


@pytest.mark.parametrize("kind", FLEETS)
def test_normalised_errors_of_many_rigs_have_the_variance_one_from_both_sides(kind: str) -> None:
    z, half = normalised_errors([all_at_once(FLEETS[kind].of(seed)) for seed in range(RIGS)])
    assert half < 0.35
    assert 1 - half < (z**2).mean() < 1 + half


def test_normalised_errors_of_drives_added_one_by_one_have_the_variance_one_too() -> None:
    z, half = normalised_errors([one_by_one(Fleet(5, 8, 0.1, 0.01).of(seed)) for seed in range(RIGS)])
    assert 1 - half < (z**2).mean() < 1 + half


NOISE_OF_NOISE = 1 / np.sqrt(2 * 60 * 10 * 10 * 0.8 * 0.37)
"""Relative standard deviation of a drive's noise by the median of n absolute residuals, 1 / sqrt(2 n 0.37)."""


def test_five_drives_one_by_one_give_the_lens_and_the_sigmas_of_all_at_once() -> None:
    """One by one, drives weigh by the noise of their own residuals, all at once by a common one: their information differs by twice
    NOISE_OF_NOISE. The rest of the lens's tolerance is convergence: a last step of a hundredth of a sigma in each of five fits,
    each step being 0.7 of the one before."""
    drives = Fleet(5, 10, 0.1, 0.01).of(3)
    whole, grown = all_at_once(drives), one_by_one(drives)
    moved = np.abs(grown.lens.values - whole.lens.values) / whole.sigma
    assert moved.max() < 3 * 2 * NOISE_OF_NOISE + 5 * SETTINGS.smallest_step / 0.3
    np.testing.assert_allclose(grown.sigma, whole.sigma, rtol=3 * NOISE_OF_NOISE)
    assert (grown.drives, grown.matches) == (whole.drives, whole.matches)


def test_drives_that_contradict_each_other_widen_the_sigmas_one_by_one_as_all_at_once() -> None:
    """Within a tenth: the weights of the earlier drives were fixed about another lens than the last one."""
    fleet = Fleet(5, 10, 0.0, 0.0)
    agreed, torn = fleet.of(4), fleet.of(4, spread=2.0)
    whole, grown = all_at_once(torn), one_by_one(torn)
    by_data = np.array([name not in (0, 2, 6) for name in range(10)])  # pitch, roll, cx: each drive's own take the contradiction
    assert (whole.sigma / all_at_once(agreed).sigma)[by_data].min() > 1.15
    assert (grown.sigma / one_by_one(agreed).sigma)[by_data].min() > 1.15
    np.testing.assert_allclose(grown.sigma, whole.sigma, rtol=0.1)


def test_a_rig_file_keeps_what_the_next_drive_needs(tmp_path) -> None:
    first, second = Fleet(2, 8, 0.1, 0.01).of(5)
    known = all_at_once([first])
    write_rig_file(known, tmp_path / "RIG.toml")
    by_file = learn_rig([second], known=read_rig_file(tmp_path / "RIG.toml")).rig
    directly = learn_rig([second], known=known).rig
    assert by_file.lens == directly.lens
    np.testing.assert_array_equal(by_file.sigma, directly.sigma)


def test_moments_give_the_sums_over_groups_at_any_lens() -> None:
    rng = np.random.default_rng(0)
    scores, roots, x, y = rng.normal(size=(7, 10)), rng.normal(size=(7, 10, 10)), rng.normal(size=10), rng.normal(size=10)
    curvatures = roots @ roots.transpose(0, 2, 1)
    moments = ScoreMoments(moments_of(scores, curvatures, x))
    moved = scores - np.einsum("sij,j->si", curvatures, y - x)
    assert moments.groups == 7
    np.testing.assert_allclose(moments.curvature, curvatures.sum(axis=0))
    np.testing.assert_allclose(moments.scatter(y), moved.T @ moved)
    inverse = np.linalg.inv(curvatures.sum(axis=0))
    np.testing.assert_allclose(moments.leverage(inverse), sum(h @ inverse @ h for h in curvatures))
