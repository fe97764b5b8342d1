"""A stage's key changes with its inputs' contents, its parameters and its code, and with nothing else."""

import json

import pytest

from wayloom.pipeline import keys


@pytest.fixture
def stage(tmp_path):
    (tmp_path / "left").mkdir()
    (tmp_path / "left" / "0.png").write_bytes(b"labels")
    (tmp_path / "model.json").write_text("{}")
    return tmp_path


def test_the_digest_of_a_folder_depends_on_names_and_bytes(stage):
    before = keys.digest_of_folder(stage)
    (stage / "left" / "0.png").rename(stage / "left" / "1.png")
    renamed = keys.digest_of_folder(stage)
    (stage / "left" / "1.png").write_bytes(b"other labels")
    assert len({before, renamed, keys.digest_of_folder(stage)}) == 3


def test_reports_and_times_of_change_do_not_count(stage):
    before = keys.digest_of_folder(stage)
    (stage / keys.REPORT_FILE).write_text('{"seconds": 3.2}')
    (stage / keys.STAGE_FILE).write_text("{}")
    (stage / "model.json").write_text("{}")
    assert keys.digest_of_folder(stage) == before


@pytest.mark.parametrize(
    "changed",
    [("labelling", {"a": "1"}, {"p": 1}, "v"), ("odometry", {"a": "2"}, {"p": 1}, "v"), ("odometry", {"a": "1"}, {"p": 2}, "v"),
     ("odometry", {"a": "1"}, {"p": 1}, "w")],
)  # fmt: skip
def test_a_key_depends_on_stage_inputs_parameters_and_code(changed):
    key = keys.stage_key("odometry", {"a": "1"}, {"p": 1}, "v")
    assert keys.stage_key("odometry", {"a": "1"}, {"p": 1}, "v") == key
    assert keys.stage_key(*changed) != key


def test_the_order_of_parameters_does_not_matter():
    assert keys.sha256_of_json({"a": 1, "b": 2}) == keys.sha256_of_json({"b": 2, "a": 1})


def test_the_code_version_knows_the_source():
    assert keys.code_version(("errors.py",)) != keys.code_version(("errors.py", "geometry"))
    assert keys.code_version(("geometry",)) == keys.code_version(("geometry",))


@pytest.mark.parametrize("content", [None, "", "{", "[]", '{"key": "x"}'])
def test_a_stage_without_a_whole_stage_file_is_not_finished(tmp_path, content):
    if content is not None:
        (tmp_path / keys.STAGE_FILE).write_text(content)
    assert keys.read_stage_file(tmp_path) is None


def test_a_finished_stage_says_what_it_is(tmp_path):
    said = {"key": "k", "digest": "d", "seconds": 1.0}
    (tmp_path / keys.STAGE_FILE).write_text(json.dumps(said))
    assert keys.read_stage_file(tmp_path) == said
