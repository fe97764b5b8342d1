"""How the network in the package is made: the parts of the recipe that need no PyTorch."""

import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from wayloom.segmentation.catalogue import NETWORKS
from wayloom.segmentation.description import read_description
from wayloom.simulation.recording.presets import PRESETS

BENCHMARKS = str(Path(__file__).resolve().parents[2] / "benchmarks")
sys.path.insert(0, BENCHMARKS)
import training_recipe as recipe  # noqa: E402
from city_views import Views, batches, class_weights  # noqa: E402

sys.path.remove(BENCHMARKS)  # its simulation.py would hide the folder of that name here


def test_the_description_that_is_written_is_that_of_the_network_in_the_package(tmp_path: Path) -> None:
    shipped = tomllib.loads((NETWORKS / "wayloom-city.toml").read_text())
    (tmp_path / "wayloom-city.toml").write_text(recipe.description(shipped["sha256"]))
    assert tomllib.loads((tmp_path / "wayloom-city.toml").read_text()) == shipped
    assert read_description(tmp_path / "wayloom-city.toml").balanced  # its loss is weighted by class


def test_it_begins_from_nothing_and_trains_on_no_city_that_is_judged(tmp_path: Path) -> None:
    phases, state = recipe.phases_left(recipe.PHASES, tmp_path)
    assert (phases, state) == (recipe.PHASES, None)
    trained = {seed for phase in recipe.PHASES for seed in phase.half + phase.full}
    assert trained.isdisjoint(recipe.HELD_OUT)
    assert trained.isdisjoint(preset.city.seed for preset in PRESETS.values())


def test_a_run_that_was_stopped_goes_on_after_its_last_whole_phase_of_the_same_recipe(tmp_path: Path) -> None:
    first, second = recipe.trial(3)
    recipe.state_file(first, tmp_path).write_bytes(b"weights")
    assert recipe.phases_left((first, second), tmp_path) == ((first, second), None)  # the state may not be whole
    recipe.note_done(first, tmp_path)
    assert recipe.phases_left((first, second), tmp_path) == ((second,), recipe.state_file(first, tmp_path))
    assert recipe.phases_left(recipe.trial(4), tmp_path) == (recipe.trial(4), None)


def test_the_rate_rises_and_falls_to_nothing() -> None:
    rates = [recipe.share_of_rate(done) for done in np.linspace(0, 1, 201)]
    assert rates[0] == 0.0
    assert max(rates) == pytest.approx(1.0, abs=0.01)
    assert rates[-1] == pytest.approx(0.0, abs=1e-12)
    assert np.argmax(rates) == pytest.approx(200 * recipe.WARM_UP, abs=1)


def test_scores_are_those_of_their_definition_and_void_does_not_count() -> None:
    truth = np.array([[0, 0, 1, 255]], np.uint8)
    found = np.array([[0, 1, 1, 2]], np.uint8)
    scores = recipe.scores_of(recipe.confusion_of(truth, found))
    assert scores["oa"] == pytest.approx(100 * 2 / 3)
    assert scores["iou"] == {"road": pytest.approx(50.0), "sidewalk": pytest.approx(50.0)}
    assert scores["miou"] == pytest.approx(50.0)


def test_batches_depend_on_their_seed_alone_and_rare_classes_weigh_more() -> None:
    rng = np.random.default_rng(0)
    classes = [np.where(rng.random((188, 704)) < 0.02, 5, 0).astype(np.uint8) for _ in range(3)]
    views = Views([rng.integers(0, 255, (188, 704, 3)).astype(np.uint8) for _ in classes], classes)
    one, other, third = (next(batches(views, 2, (64, 96), seed)) for seed in (1, 1, 2))
    assert np.array_equal(one[0], other[0])
    assert np.array_equal(one[1], other[1])
    assert not np.array_equal(one[0], third[0])
    assert one[0].shape == (2, 64, 96, 3)
    weights = class_weights(classes)
    assert weights[5] > weights[0]
    assert weights.mean() == pytest.approx(1.0)
