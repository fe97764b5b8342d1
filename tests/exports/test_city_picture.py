"""Letters of the insets in the overview picture, by pixels."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from exports.made_sources import made_source
from wayloom.errors import InputError
from wayloom.exports import city_picture
from wayloom.exports.city_insets import EDGE_M, Inset
from wayloom.exports.city_picture import DPI, LETTERS, OVERVIEW_AT, SIZE_IN, Window, write_city_picture
from wayloom.exports.tileset_folder import write_tileset

ASPECT = OVERVIEW_AT[2] * SIZE_IN[0] / (OVERVIEW_AT[3] * SIZE_IN[1])


def drawn(insets, width_m, monkeypatch, letters=LETTERS):
    """(h, w, 3) the figure with an overview of a window around the origin, in which nothing is but insets."""
    monkeypatch.setattr(city_picture, "LETTERS", letters)
    figure = Figure(SIZE_IN, dpi=DPI)
    canvas = FigureCanvasAgg(figure)
    overview = figure.add_axes(OVERVIEW_AT)
    overview.set_axis_off()
    window = Window(np.zeros(2), np.array([width_m, width_m / ASPECT]))
    window.show(overview)
    city_picture._mark_insets(overview, insets, window)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].astype(int)


def of_letters(insets, width_m, monkeypatch):
    """(h, w) pixels of letters and their discs: those in which the picture differs from one of frames alone."""
    frames = drawn(insets, width_m, monkeypatch, [""] * len(LETTERS))
    return (drawn(insets, width_m, monkeypatch) != frames).any(axis=2)


def insets_at(*middles):
    return [Inset(np.array(middle, float), EDGE_M) for middle in middles]


@pytest.mark.parametrize("width_m", [30.0, 60.0, 400.0, 5000.0])
@pytest.mark.parametrize("side", [(-0.5, 0.0), (0.5, 0.0), (0.0, 0.5), (0.0, -0.5), (-0.5, 0.5), (0.0, 0.0)])
def test_the_letter_of_an_inset_at_any_edge_of_the_overview_is_whole_and_within_it(width_m, side, monkeypatch):
    shown = of_letters(insets_at(np.array(side) * (width_m, width_m / ASPECT)), width_m, monkeypatch)
    assert shown.sum() > 0.9 * of_letters(insets_at((0.0, 0.0)), 400.0, monkeypatch).sum()
    rows, columns = np.nonzero(shown)
    left, bottom, width, height = OVERVIEW_AT
    assert columns.min() >= left * SIZE_IN[0] * DPI
    assert columns.max() < (left + width) * SIZE_IN[0] * DPI
    assert rows.min() >= (1.0 - bottom - height) * SIZE_IN[1] * DPI
    assert rows.max() < (1.0 - bottom) * SIZE_IN[1] * DPI


@pytest.mark.parametrize("corner", [(0.0, 0.0), (-2500.0, 2500.0 / ASPECT)])
def test_no_letter_covers_another_one_where_insets_are_close_together(corner, monkeypatch):
    beside = 1.2 * EDGE_M * np.array([[0, 0], [1, 0], [0, -1], [1, -1]])
    insets = insets_at(*(np.array(corner) + beside))
    alone = of_letters(insets_at((0.0, 0.0)), 5000.0, monkeypatch).sum()
    assert of_letters(insets, 5000.0, monkeypatch).sum() > 0.9 * len(insets) * alone


@pytest.mark.parametrize("write", [write_city_picture, write_tileset])
def test_a_box_with_nothing_in_it_is_told_in_the_same_words_by_every_export(write, tmp_path):
    with pytest.raises(InputError, match="out: there is nothing in the box; give a box that the drives have seen"):
        write(tmp_path / "out", made_source(50), (0.0, 0.0, 1.0, 1.0), {})
    assert list(tmp_path.iterdir()) == []
