"""What a recording is measured against."""

import numpy as np
import pytest

from wayloom.evaluation.recordings import every, from_frame, ins_truth
from wayloom.evaluation.trajectory import path_length
from wayloom.logs.registry import open_log


@pytest.fixture(scope="module")
def clip_b_log(clip_b):
    return open_log(clip_b)


def test_clip_b_is_as_long_as_its_integrated_velocities(clip_b, clip_b_log):
    truth = ins_truth(clip_b, clip_b_log)
    assert len(truth) == len(clip_b_log) == 154
    assert path_length(truth[:, :3, 3]) == pytest.approx(71.3, abs=0.5)


def test_the_truth_of_the_ins_is_that_of_the_camera(clip_b, clip_b_log):
    truth = ins_truth(clip_b, clip_b_log)
    ahead = truth[:-1, :3, 2]  # the camera's z axis in the world
    step = np.diff(truth[:, :3, 3], axis=0)
    moving = np.linalg.norm(step, axis=1) > 0.2
    along = np.einsum("ni,ni->n", ahead[moving], step[moving]) / np.linalg.norm(step[moving], axis=1)
    assert along.min() > 0.99


def test_sparse_fixes_keep_the_first_and_the_last(clip_b_log):
    sparse = every(clip_b_log.gnss, 20)
    assert len(sparse) == 9
    assert sparse.t_ns[0] == clip_b_log.gnss.t_ns[0]
    assert sparse.t_ns[-1] == clip_b_log.gnss.t_ns[-1]
    assert len(sparse.lon_lat_height) == len(sparse.covariance_enu) == len(sparse.fix_type) == 9


def test_truth_with_a_fault_is_unknown_there_and_only_in_the_copy():
    truth = np.tile(np.eye(4), (20, 1, 1))
    later = from_frame(truth, 16)
    assert np.isnan(later[:16]).all()
    assert np.isfinite(later[16:]).all()
    assert np.isfinite(truth).all()
