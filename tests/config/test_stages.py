"""The catalogue of stages is consistent, and everything that names stages reads it."""

import re
from importlib import import_module
from pathlib import Path

import pytest

from wayloom.config import stages
from wayloom.config.stages import MAP_STAGES, REMOVAL, STAGES, Stage, drive_stages, find_stage, map_stages, origins_of, queues
from wayloom.errors import StageError
from wayloom.pipeline.log_parts import LOG_PARTS
from wayloom.pipeline.running import stage_settings
from wayloom.pipeline.settings import ProcessSettings


def test_a_stage_reads_only_stages_before_it():
    for place, stage in enumerate(STAGES):
        assert set(stage.results_read) <= set(drive_stages()[:place])


def test_a_result_comes_of_its_stage_and_of_all_that_lead_to_it():
    assert origins_of("ingest") == ("ingest",)
    assert origins_of("looks") == ("ingest", "odometry", "segmentation", "looks")
    assert set(drive_stages()) - set(origins_of("submaps")) == {"looks", "ground", "objects"}


def test_names_are_unique():
    names = [stage.name for stage in (*STAGES, *MAP_STAGES, REMOVAL)]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_an_entry_names_a_room_parts_of_the_log_and_settings_that_there_are(stage):
    assert callable(import_module(stage.room).run)
    assert set(stage.log_parts) <= {*LOG_PARTS, "drive"}
    assert list(stage_settings(stage, ProcessSettings())) == list(stage.settings)


def test_every_setting_is_in_the_key_of_a_stage_or_changes_no_result():
    """The network and the rig file are in keys by content (`key_parts`); threads change nothing; the rest is for exports."""
    named = {path.split(".")[0] for stage in STAGES for path in stage.settings}
    of_exports = {"geoid", "dense", "markings", "kerbs", "object_fusion"}
    assert set(ProcessSettings.model_fields) - named == {"segmentation", "rig", "threads", *of_exports}


def test_an_unknown_stage_is_refused_with_the_known_ones():
    with pytest.raises(StageError, match=r"unknown stage 'groud'; known are ingest, .*, remove"):
        find_stage("groud")


def test_a_new_entry_is_known_to_all_who_ask(monkeypatch):
    monkeypatch.setattr(stages, "STAGES", (*STAGES[:2], Stage("facades", "facades", inputs=("odometry",)), *STAGES[2:]))
    assert drive_stages()[2] == "facades"
    assert find_stage("facades").queue == "facades"
    assert "facades" in queues()
    assert map_stages() == ("stitch", "publish")


def test_a_worker_of_the_composed_service_serves_each_queue():
    text = (Path(__file__).resolve().parents[2] / "docker-compose.yml").read_text()
    served = [name for listed in re.findall(r'--queues, "?([a-z,]+)', text) for name in listed.split(",")]
    assert sorted(served) == sorted(queues())
