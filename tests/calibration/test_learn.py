"""Lenses that are known, learnt from made drives."""

from dataclasses import replace

import numpy as np
import pytest
from made_observations import CAMERA, LENS, RIG, made_drive

from wayloom.calibration.covariance import field_sigma
from wayloom.calibration.learn import Calibration, field_size, learn_rig, undetermined
from wayloom.calibration.settings import CalibrationSettings
from wayloom.errors import CalibrationError
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.geometry.lens import IDENTITY, PARAMETERS, RightLens, lens_field, parameter_jacobian
from wayloom.odometry.rig.calibration_observations import CalibrationObservations

TURNS = {"turns": (0.05, 0.05, 0.05), "straights": (0.0, 0.0, 0.0), "a mix": (0.05, 0.0, 0.01)}


def worst_z(calibration: Calibration, truth: RightLens) -> float:
    """The largest error of a parameter in stated standard deviations."""
    return float((np.abs(calibration.rig.lens.values - truth.values) / calibration.rig.sigma).max())


def field_error_px(lens: RightLens, truth: RightLens) -> float:
    """Where the two move infinitely far points, at most, the shift along the rows taken off."""
    difference = lens_field(lens, CAMERA, 32) - lens_field(truth, CAMERA, 32)
    difference[..., 0] -= difference[..., 0].mean()
    return float(np.hypot(difference[..., 0], difference[..., 1]).max())


@pytest.mark.parametrize("kind", TURNS)
def test_a_lens_is_learnt_within_two_of_its_sigmas(kind: str) -> None:
    drives = [made_drive(LENS, seed, turn_rad=turn) for seed, turn in enumerate(TURNS[kind])]
    found = learn_rig(drives)
    assert worst_z(found, LENS) < 2.0
    assert field_error_px(found.rig.lens, LENS) < 0.1
    assert found.rig.noise_px == pytest.approx(0.1, rel=0.1)
    assert found.doubts == ()


def test_a_perfect_rig_stays_perfect() -> None:
    found = learn_rig([made_drive(IDENTITY, seed) for seed in range(2)])
    assert worst_z(found, IDENTITY) < 2.0
    assert field_error_px(found.rig.lens, IDENTITY) < 0.05
    assert found.worst_px < 0.1


def test_each_drive_may_differ_from_the_rig_by_bias_pitch_and_roll() -> None:
    offsets = [(0.3, 2e-4, -3e-4), (-0.3, -2e-4, 3e-4), (0.1, 1e-4, 0.0), (-0.1, -1e-4, 0.0)]
    drives = [made_drive(LENS, seed, offsets=own) for seed, own in enumerate(offsets)]
    found = learn_rig(drives)
    assert worst_z(found, LENS) < 2.0
    own = [(drive.disparity_bias_px, 1e3 * drive.pitch_rad, 1e3 * drive.roll_rad) for drive in found.drives]
    np.testing.assert_allclose(own, np.array(offsets) * (1, 1e3, 1e3), atol=0.03)


def test_a_lens_learnt_on_other_drives_fits_the_one_left_out() -> None:
    drives = [made_drive(LENS, seed) for seed in range(3)]
    for left_out in range(3):
        others = learn_rig([drive for k, drive in enumerate(drives) if k != left_out])
        own = learn_rig([drives[left_out]])
        assert field_error_px(others.rig.lens, own.rig.lens) < 3 * own.unsure_px
        assert field_error_px(others.rig.lens, LENS) < 0.1


def test_drives_added_later_say_the_same_as_all_at_once() -> None:
    drives = [made_drive(LENS, seed) for seed in range(3)]
    first = learn_rig(drives[:2])
    added, whole = learn_rig(drives[2:], known=first.rig), learn_rig(drives)
    assert added.rig.drives == whole.rig.drives == ("drive 0", "drive 1", "drive 2")
    assert added.rig.matches == whole.rig.matches
    assert np.abs((added.rig.lens.values - whole.rig.lens.values) / whole.rig.sigma).max() < 0.5
    assert field_error_px(added.rig.lens, whole.rig.lens) < 0.02
    assert (added.rig.sigma <= first.rig.sigma * 1.05).all()
    assert worst_z(added, LENS) < 2.0


def narrow(drive: CalibrationObservations, reach_px: float = 60.0) -> CalibrationObservations:
    """The drive with matches near the middle of the right image only."""
    near = np.hypot(*(drive.uv_right - (CAMERA.cx, CAMERA.cy)).T) < reach_px
    columns = ("group", "uv_host", "uv_right", "uv_left_target", "uv_right_target")
    return replace(drive, **{name: getattr(drive, name)[near] for name in columns})


def test_what_the_drives_leave_undetermined_is_told_and_stays_by_its_prior() -> None:
    drive = narrow(made_drive(LENS, 0, groups=12, points=400))
    found, prior = learn_rig([drive]), CalibrationSettings().lens.sigmas
    assert "k1" in undetermined(found.rig)
    k1 = PARAMETERS.index("k1")
    assert abs(found.rig.lens.k1) < 3 * prior[k1]
    assert found.rig.sigma[k1] > 0.5 * prior[k1]
    assert worst_z(found, LENS) < 2.0
    assert undetermined(learn_rig([made_drive(LENS, 1)]).rig) == ()


def test_a_tenth_of_wrong_matches_does_no_harm() -> None:
    found = learn_rig([made_drive(LENS, seed, outliers=0.1) for seed in range(2)])
    assert field_error_px(found.rig.lens, LENS) < 0.1
    assert worst_z(found, LENS) < 2.0


def test_the_order_of_the_drives_hardly_matters_and_the_same_drives_give_the_same_bits() -> None:
    drives = [made_drive(LENS, seed) for seed in range(2)]
    one, again, other = learn_rig(drives), learn_rig(drives), learn_rig(drives[::-1])
    assert one.rig.lens == again.rig.lens
    np.testing.assert_array_equal(one.rig.information, again.rig.information)
    assert np.abs((one.rig.lens.values - other.rig.lens.values) / one.rig.sigma).max() < 0.05


def test_a_drive_that_is_known_already_and_one_without_matches_are_left_out() -> None:
    first = learn_rig([made_drive(LENS, 0)])
    empty = made_drive(LENS, 5, groups=1)
    nothing = {
        name: getattr(empty, name)[:0]
        for name in (
            "host_frame", "target_frame", "T_target_host", "group", "uv_host", "uv_right", "uv_left_target", "uv_right_target",
        )
    }  # fmt: skip
    found = learn_rig([made_drive(LENS, 0), replace(empty, **nothing), made_drive(LENS, 1)], known=first.rig)
    assert [name for name, _ in found.left_out] == ["drive 0", "drive 5"]
    assert found.rig.drives == ("drive 0", "drive 1")


def test_too_little_is_refused_with_what_to_do() -> None:
    with pytest.raises(CalibrationError, match=r"2 groups of matches in 1 drives are too few.*turns"):
        learn_rig([made_drive(LENS, 0, groups=2)])
    known = learn_rig([made_drive(LENS, 0)]).rig
    with pytest.raises(CalibrationError, match="learnt from already"):
        learn_rig([made_drive(LENS, 0)], known=known)


def test_drives_of_different_rigs_are_refused() -> None:
    with pytest.raises(CalibrationError, match="is of the rig made, the log of another"):
        learn_rig([made_drive(LENS, 0), made_drive(LENS, 1, rig_id="another")])
    long = StereoRig(CAMERA, (-0.7, 0.0, 0.0))
    with pytest.raises(CalibrationError, match="baseline"):
        learn_rig([made_drive(LENS, 0), made_drive(LENS, 1, rig=long)])


def test_days_with_slightly_different_calibrations_are_one_rig_with_a_doubt() -> None:
    other = StereoRig(PinholeCamera(707.0, 705.0, 601.0, 183.0, 1226, 370), RIG.t_right_left)
    found = learn_rig([made_drive(LENS, 0), made_drive(LENS, 1, rig=other)])
    assert any("another calibration" in doubt for doubt in found.doubts)
    assert worst_z(found, LENS) < 2.0


def test_the_size_of_a_lens_is_told_without_its_shift_along_the_rows() -> None:
    assert field_size(RightLens(cx_shift_px=-3.0), CAMERA) == pytest.approx((0.0, 0.0), abs=1e-12)
    worst, rms = field_size(RightLens(pitch_rad=1e-3), CAMERA)
    assert worst == pytest.approx(718e-3 * (1 + (185 / 716) ** 2), rel=0.03)
    assert 0.7 < rms < worst


def test_the_sigma_of_the_field_is_that_of_lenses_drawn_from_the_covariance() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(10, 10)) * (1e-5, 1e-5, 1e-5, 0, 0, 1e-5, 1e-2, 1e-5, 1e-5, 1e-5)
    draws = rng.normal(size=(4000, 10)) @ root
    v, u = np.mgrid[0:376:64, 0:1241:64].astype(float)
    J = parameter_jacobian(LENS, CAMERA, 0.0, np.column_stack([u.ravel(), v.ravel()]))
    J[:, 0] -= J[:, 0].mean(axis=0)
    spread = np.sqrt(((J @ draws.T) ** 2).mean(axis=2).sum(axis=1).max())
    assert field_sigma(LENS, CAMERA, root.T @ root) == pytest.approx(spread, rel=0.05)
