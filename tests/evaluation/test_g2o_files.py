"""Pose graphs as g2o files."""

from pathlib import Path

import gtsam
import numpy as np
import pytest

from wayloom.errors import InputError
from wayloom.evaluation.g2o_files import read_g2o, write_g2o
from wayloom.evaluation.made_graphs import sphere
from wayloom.mapping.pose_graph import optimise_pose_graph
from wayloom.mapping.pose_graph_types import SolverSettings

EDGE = "EDGE_SE2 0 1 1 0 0.1 4 0 0 4 0 9"


def test_a_graph_that_was_written_is_read_again(tmp_path: Path) -> None:
    made = sphere(3, 5, 0.05, 0.01, seed=1)
    write_g2o(tmp_path / "graph.g2o", made.graph, made.T_world_true)
    file = read_g2o(tmp_path / "graph.g2o")
    np.testing.assert_allclose(file.graph.T_first_second, made.graph.T_first_second, atol=1e-12)
    np.testing.assert_allclose(file.graph.information, made.graph.information, atol=1e-6)
    assert file.T_world_node is not None
    np.testing.assert_allclose(file.T_world_node, made.T_world_true, atol=1e-12)
    assert np.array_equal(file.graph.is_loop, made.graph.is_loop)


@pytest.mark.parametrize(
    ("line", "message"),
    [("EDGE_SE2 1 2 1 0", "line 2: EDGE_SE2 has 4 numbers"), ("EDGE_SE2 1 2 1 0 0.1 4 0 0 4 0 x", "line 2: could not convert")],
)
def test_a_damaged_line_is_named(tmp_path: Path, line: str, message: str) -> None:
    (tmp_path / "graph.g2o").write_text(f"{EDGE}\n{line}\n")
    with pytest.raises(InputError, match=message):
        read_g2o(tmp_path / "graph.g2o")


def test_other_records_are_counted_and_numbers_may_have_gaps(tmp_path: Path) -> None:
    (tmp_path / "graph.g2o").write_text(f"FIX 0\n{EDGE}\nEDGE_SE2 1 7 1 0 0 4 0 0 4 0 9\nE")
    file = read_g2o(tmp_path / "graph.g2o")
    assert file.skipped == {"FIX": 1, "E": 1}
    assert file.number.tolist() == [0, 1, 7]
    assert file.graph.is_loop.tolist() == [False, True]


@pytest.mark.real_data
@pytest.mark.parametrize(("name", "optimum"), [("parking-garage", 0.634192), ("manhattan", 1774.52), ("kitti_00", 49.1611)])
def test_a_public_graph_comes_to_its_known_optimum_as_gtsam_counts(data_dir: Path, name: str, optimum: float) -> None:
    path = data_dir / "pose_graphs" / f"{name}.g2o"
    file = read_g2o(path)
    solution = optimise_pose_graph(file.graph, None, SolverSettings(robust=False))
    assert solution.cost == pytest.approx(optimum, rel=1e-5)
    if file.T_world_node is not None and not file.graph.planar:
        factors, values = gtsam.readG2o(str(path), True)
        for number, T in zip(file.number.tolist(), solution.T_world_node, strict=True):
            values.update(number, gtsam.Pose3(T))
        assert factors.error(values) == pytest.approx(solution.cost, rel=1e-7)
