"""The network in the package still knows the simulator's streets, also those that it was not trained on."""

import numpy as np

from wayloom.config.classes import VOID
from wayloom.segmentation.catalogue import DEFAULT_MODEL, MODELS
from wayloom.segmentation.network import Network
from wayloom.simulation.recording.dataset import render_views

HELD_OUT_CITY = 1901
"""Judged, never trained on: see benchmarks/train_network.py."""


def test_the_default_network_labels_streets_that_it_never_saw() -> None:
    network = Network(MODELS[DEFAULT_MODEL])
    hits = known = grey_hits = 0
    for image, truth in render_views(HELD_OUT_CITY, 6, "half"):
        grey = image.mean(axis=2).astype(np.uint8)
        hits += int((network.labels(image) == truth).sum())
        grey_hits += int((network.labels(grey) == truth).sum())
        known += int((truth != VOID).sum())
    assert hits / known >= 0.86
    assert grey_hits / known >= 0.80
