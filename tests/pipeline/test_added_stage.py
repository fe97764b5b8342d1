"""A stage that is added by one entry in the catalogue and one room runs embedded and in the service's workers."""

import json
import os
import sys

import pytest

from pipeline.real_log import colour_network, first_frames
from service_kit.packed_drives import packed_drive
from service_kit.running import ROOT, service
from wayloom.client.upload import upload
from wayloom.client.watch import wait_for_drive
from wayloom.config import stages
from wayloom.config.stages import Stage
from wayloom.odometry import frame_source
from wayloom.pipeline import drive, log_source
from wayloom.pipeline.drive import process_drive
from wayloom.pipeline.settings import ProcessSettings
from wayloom.reports.drive_report import write_report
from wayloom.segmentation.settings import SegmentationSettings

ROOM = '''
"""Counting stage."""

import json


def run(context, out_dir, progress):
    files = sorted(file.name for file in context.source.path.rglob("*") if file.is_file())
    earlier = sorted(folder.name for folder in context.inputs_dir.iterdir() if folder.is_dir() and not folder.name.startswith("."))
    (out_dir / "count.json").write_text(json.dumps({"files": len(files), "earlier": earlier}))
    progress(1.0, "counted")
'''
ENTRY = Stage("count", "ingest", room="counting_room")
HOOKS = '''
from service_kit import little_stages
from wayloom_workers import production


def hooks(stage):
    """The little stages, and the real thing for the new one."""
    return production.stage_hooks(stage) if stage in ("count", "recount") else little_stages.hooks(stage)
'''
SITE = """
from wayloom.config import stages

count, recount = (stages.Stage(name, "ingest", room="counting_room") for name in ("count", "recount"))
stages.STAGES = (*stages.STAGES[:2], count, *stages.STAGES[2:], recount)
"""


@pytest.fixture
def room(tmp_path, monkeypatch):
    """The folder of the room, from which it can be imported."""
    (tmp_path / "code").mkdir()
    (tmp_path / "code" / "counting_room.py").write_text(ROOM)
    monkeypatch.syspath_prepend(tmp_path / "code")
    yield tmp_path / "code"
    sys.modules.pop("counting_room", None)


def counting(monkeypatch, owner, name):
    """Count the calls of a function under this name."""
    calls, real = [], getattr(owner, name)
    monkeypatch.setattr(owner, name, lambda *given, **named: calls.append(name) or real(*given, **named))
    return calls


def test_an_added_stage_runs_embedded_and_the_log_is_opened_once(clip_a, room, tmp_path, monkeypatch):
    monkeypatch.setattr(stages, "STAGES", (*stages.STAGES[:2], ENTRY, *stages.STAGES[2:]))
    opened = counting(monkeypatch, log_source, "open_log_unchecked")
    matched = counting(monkeypatch, frame_source, "first_matches")
    matched_first = counting(monkeypatch, drive, "first_matches")
    log_path, out = first_frames(clip_a, tmp_path / "street", 8), tmp_path / "out"
    settings = ProcessSettings(segmentation=SegmentationSettings(model=str(colour_network(tmp_path / "network"))))
    result = process_drive(log_path, out, settings, write_more=write_report)
    assert (len(opened), len(matched) + len(matched_first)) == (1, 1)
    assert list(result.times) == list(stages.drive_stages())
    assert "count" in result.times
    assert json.loads((out / "stages" / "count" / "count.json").read_text()) == {"files": 18, "earlier": ["ingest", "odometry"]}
    assert list(json.loads((out / "report.json").read_text())["stages"]) == list(result.times)
    again = process_drive(log_path, out, settings)
    assert all(time.reused for time in again.times.values())
    (room / "counting_room.py").write_text(ROOM.replace("counted", "counted again"))
    sys.modules.pop("counting_room")
    monkeypatch.setattr("wayloom.pipeline.running.code_version", fresh_code_version)
    after = process_drive(log_path, out, settings)
    assert [name for name, time in after.times.items() if not time.reused] == ["count"]


def fresh_code_version(module):
    """As `code_version`, but what a running process has found before is looked at again."""
    from wayloom.pipeline import code_version

    code_version._code_version.cache_clear()
    return code_version.code_version(module)


def test_an_added_stage_runs_in_the_services_workers(room, tmp_path):
    (room / "added_hooks.py").write_text(HOOKS)
    (room / "sitecustomize.py").write_text(SITE)
    path = os.pathsep.join([str(room), *(str(ROOT / name) for name in ("core", "services", "workers", "tests"))])
    with service(tmp_path / "data", WAYLOOM_STAGE_HOOKS="added_hooks:hooks", PYTHONPATH=path) as up:
        api = up.api()
        sent = upload(api, packed_drive(tmp_path / "a", sizes=(10,) * 5))
        done = wait_for_drive(api, sent["id"])
        assert (done["state"], done["error"]) == ("done", None)
        names = [stage["stage"] for stage in done["stages"]]
        assert (names[1:4], names[-4:]) == (["odometry", "count", "segmentation"], ["objects", "recount", "stitch", "publish"])
        assert {stage["state"] for stage in done["stages"]} == {"done"}
        assert "count" in api.json("GET", "/v1/info")["stages"]
        (output,) = (up.data / "drives" / sent["id"] / "stages" / "count").iterdir()
        assert json.loads((output / "count.json").read_text()) == {"files": 6, "earlier": []}
        assert json.loads((output / "stage.json").read_text())["key"] == output.name
