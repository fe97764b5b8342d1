"""The list of kernels that are compiled ahead: all that a drive needs, and nothing else."""

from importlib import import_module
from typing import Any

import pytest
from test_imu_drives import drive

from wayloom.calibration.self_calibration import track_calibrated
from wayloom.config.kernel_types import types_of
from wayloom.odometry import warm_up

MODULES = (
    "adjustment", "equations", "images", "inertial", "linear", "match_equations", "matches", "patch", "point_rows",
    "preintegration", "resampling", "selection", "stereo", "tracing", "tracking",
)  # fmt: skip
LISTED = (*warm_up.WINDOW, *warm_up.ALIGNMENT, *warm_up.STEREO, *warm_up.STATE, *warm_up.INERTIAL)


def kernels() -> dict[str, Any]:
    """All compiled functions that can be called from Python, by module and name."""
    found = [value for name in MODULES for value in vars(import_module(f"wayloom.odometry.kernels.{name}")).values()]
    return {
        f"{value.py_func.__module__.rpartition('.')[2]}.{value.py_func.__name__}": value
        for value in found
        if hasattr(value, "py_func") and not value.targetoptions.get("no_cpython_wrapper")
    }


def compiled() -> set[tuple[str, str]]:
    """Each kernel with the types that it has been compiled or loaded for in this process."""
    return {(name, str(types)) for name, kernel in kernels().items() for types in kernel.signatures}


@pytest.mark.skipif("not kernels()", reason="numba's compiler is off")
def test_a_drive_with_an_imu_uses_what_is_listed_and_nothing_else() -> None:
    listed, before = {(name, str(types_of(words, warm_up._named_tuples()))) for name, words in LISTED}, compiled()
    result = track_calibrated(drive(100))
    assert result.report["imu"]["started_s"]
    assert compiled() - before <= listed
    assert listed <= compiled()
