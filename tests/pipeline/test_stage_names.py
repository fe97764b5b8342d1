"""Functions and files by whose names the profiles (`benchmarks/stage_profiles.py`) tell stages apart."""

from importlib import import_module
from pathlib import Path

import pytest

from wayloom.config.stages import drive_stages
from wayloom.pipeline import drive, drive_products


def test_a_frame_of_every_stage_and_of_the_exports_is_known_for_what_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    profiles = import_module("stage_profiles")
    assert profiles.stage_of(f"{drive_products.write_products.__name__} ({drive_products.__file__}:1)") == drive.EXPORTS
    for stage in drive_stages():
        room = import_module(f"wayloom.pipeline.stages.{stage}")
        assert profiles.stage_of(f"{room.run.__name__} ({room.__file__}:1)") == stage
    assert profiles.stage_of(f"{drive.process_drive.__name__} ({drive.__file__}:1)") is None
