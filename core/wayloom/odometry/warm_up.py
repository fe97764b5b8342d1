"""Compilation of the odometry's kernels ahead of their use: which there are, and the types of their arguments."""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final

from wayloom.config.kernel_cache import KernelGroup, compile_kernels
from wayloom.config.kernel_types import types_of
from wayloom.config.progress import Progress, silent

WINDOW: Final = (
    ("adjustment.observe", "images rig frames points i8:2 b1:1 i8:1 f8:4 f8:4 f8 robust scratch i8:2"),
    ("equations.add_hosts", "u1:3 rig frames points f8 robust f8:2 f8:2 f8:2 scratch terms"),
    ("equations.add_observers", "images rig frames points f8 robust f8:2 f8:4 f8:4 f8:4 f8:1 scratch terms"),
    (
        "tracing.take_depths",
        "u1:2 u1:2 f8:3 f8:3 f8:2 rig frames points i8:1 i8 f8 robust f8:1 scratch f8:1 i8:1 i8:1",
    ),
    ("tracing.trace_rows", "images f8:4 rig frames points i8:1 i8 f8:1 f8:1 f8 f8 robust scratch f4:1 i8:1"),
)
ALIGNMENT: Final = (
    ("matches.match_each", "f4:2 f4:2 i8:2 f8:2 f8:1 f8:2 f8:1 f8 f4:1 f8:3 f8:2 f8:2 f8:2"),
    (
        "match_equations.fill_group_equations",
        "f8:2 f8:3 f8:1 i8:1 f8:4 f8:2 f8:3 f8:1 f8:1 f8 f8 f8:2 f8:2 f8:3 f8:2 f8:1 f8:2",
    ),
    ("linear.cholesky_solve", "f8:2 f8:1 f8:1 f8:1 f8:2"),
    ("linear.cholesky_solve_rows", "f8:2 f8:2 f8:2 f8:1 f8:2"),
    ("linear.fill_exp_se3", "f8:1 f8:2"),
    ("linear.orthonormalise", "f8:2"),
    ("images.fill_halved", "u1:2 f4:2"),
    ("tracking.minimise_level", "u1:2 f8:2 f8:2 f8:1 f8:1 f8 f8 i8 f8 f8:3 f8:2 f8:3 f8:1 f4:1 f8:1"),
    ("tracking.minimise_level", "f4:2 f8:2 f8:2 f8:1 f8:1 f8 f8 i8 f8 f8:3 f8:2 f8:3 f8:1 f4:1 f8:1"),
    ("adjustment.step_frames", "f8:3 f8:2 f8:1 f8:2 f8:2"),
    ("tracking.add_splats", "f8:2 f8:1 i8 f4:2 f4:2"),
    ("tracking.fill_pooled", "i8:1 f8:1 u1:2 f8:1 f8:2"),
    ("tracking.fill_pooled", "i8:1 f8:1 f4:2 f8:1 f8:2"),
    ("tracking.gather", "f4:2 f4:2 f4:2 f8:1 f8:2"),
    ("tracking.mean_flow", "f8:2 f8:2 f8:1"),
    ("tracking.project_points", "i8:1 f8:2 f8:1 f8:3 rig i8 i8 i8 f8:2"),
)
STEREO: Final = (
    ("images.fill_gradient_size", "u1:2 f4:2"),
    ("images.fill_block_medians", "f4:2 i8 i8:1 f4:2"),
    ("patch.fill_patches", "u1:2 i8:2 f8 f4:2 f4:2"),
    ("resampling.fill_resampled", "u1:2 f4:3 i8 f4:2 u1:2"),
    ("selection.scan_cells", "f4:2 f4:2 i8 i8 i8 b1:2 f4:3 i4:3 f8:2 i8:2"),
    ("stereo.sobel_rows", "u1:2 i8 i2:2"),
    ("stereo.search_rows", "i2:2 i2:2 u1:2 u1:2 i8:2 i8 f8 f8 i2:1 f4:1 f8:2"),
    ("stereo.track_patches", "u1:2 u1:2 i8:2 f8:1 i8 f8 f8:1 f8:2"),
)
STATE: Final = (
    ("point_rows.take_points", "points i8:1 points"),
    ("point_rows.join_points", "points points points"),
    ("point_rows.forget_frame", "i8:1 i8:2 i8"),
    ("linear.fill_relative", "f8:2 f8:2 f8:2"),
    ("linear.fill_log_se3", "f8:2 f8:1"),
    ("equations.fill_relative_poses", "f8:3 f8:4"),
    ("equations.fill_right_of", "f8:3 f8 f8 f8 f8:3"),
    ("adjustment.deviation_of_poses", "f8:3 f8:3 i8:1 f8:2 f8:2 f8:2 f8:1"),
    ("adjustment.prior_energy", "f8:1 f8:2 f8:1 f8:2 f8:1"),
    ("adjustment.add_prior", "f8:1 f8:2 f8:1 f8:2 f8:1 f8:2 f8:1"),
    ("equations.fill_host_maps", "f8:4 f8:2 f8:4"),
    ("equations.add_pairs_to_state", "f8:4 f8:3 f8:4 f8:2 f8:1 f8:2 f8:2"),
    ("equations.eliminate_points", "i8:1 f8:2 f8:3 i8:2 f8:4 f8 f8:2 f8:1 f8:1 f8:1 b1:1"),
    ("equations.mirror", "f8:2"),
    ("equations.fill_steps_of_pairs", "f8:4 f8:1 f8:3"),
    ("adjustment.step_points", "i8:1 f8:1 f8:2 f8:3 i8:2 f8:3 f8:1 f8"),
    ("adjustment.largest_step", "f8:1 i8"),
)
INERTIAL: Final = (
    ("preintegration.fill_log_so3", "f8:2 f8:1"),
    ("preintegration.fill_prediction", "f8:2 f8:1 f8:1 f8 f8:2 f8:1 f8:1 f8:2 f8:1"),
    ("preintegration.integrate", "f8:1 f8:2 f8:2 i8 f8 f8 f8:1 f8:1 f8:2 f8:3 f8:3 f8:3 f8:2 f8:1 f8:1 f8:2 f8:2"),
    ("inertial.fill_gravity", "f8:1 f8:2 f8:1 f8:2"),
    ("inertial.add_each_link", "f8:3 f8:3 inertial link f8:2 f8:3 i8:1 f8:2 f8:1"),
    ("inertial.energy_of_each_link", "f8:3 inertial link f8:1"),
)
"""Module and kernel, and the words for its arguments (`wayloom.config.kernel_types`), of which some name named tuples."""


def compile_odometry(imu: bool, progress: Progress = silent) -> int:
    """Compile the kernels that a drive with or without an IMU needs, where the cache does not hold them; returns how many."""
    return compile_kernels(odometry_groups(imu), progress)


def odometry_groups(imu: bool) -> list[KernelGroup]:
    """The kernels that a drive with or without an IMU needs."""
    groups = (("window", WINDOW), ("alignment", ALIGNMENT), ("stereo", STEREO), ("state", STATE), ("inertial", INERTIAL))
    return [_group(name, table) for name, table in groups[: 5 if imu else 4]]


def _group(name: str, table: tuple[tuple[str, str], ...]) -> KernelGroup:
    def kernels() -> list[tuple[Any, tuple[Any, ...]]]:
        return [(_kernel(kernel), types_of(words, _named_tuples())) for kernel, words in table]

    return KernelGroup(f"odometry-{name}", kernels, len(table))


def _kernel(place: str) -> Any:
    """A kernel by its module and name."""
    from importlib import import_module

    module, name = place.split(".")
    return getattr(import_module(f"wayloom.odometry.kernels.{module}"), name)


@lru_cache(1)
def _named_tuples() -> Mapping[str, Any]:
    """numba's types of those that kernels take."""
    from numba import typeof

    from wayloom.odometry.backend.inertial import NO_IMU
    from wayloom.odometry.backend.window import empty_window
    from wayloom.odometry.kernels.adjustment import make_terms
    from wayloom.odometry.kernels.arrays import Rig, Robust
    from wayloom.odometry.kernels.inertial import make_link_space
    from wayloom.odometry.kernels.patch import make_scratch

    window = empty_window((1, 1), 1, 0.0, 1.0)
    made = {
        "images": window.images, "frames": window.frames, "points": window.points, "rig": Rig(*[0.0] * 7),
        "robust": Robust(*[0.0] * 4), "scratch": make_scratch(), "terms": make_terms(1, 1), "inertial": NO_IMU,
        "link": make_link_space(),
    }  # fmt: skip
    return {name: typeof(one) for name, one in made.items()}
