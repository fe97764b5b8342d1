"""A folder that the pipeline writes is whole or not there, and has one writer at a time."""

import errno
import subprocess
import sys

import pytest

from wayloom.errors import ConflictError, InputError
from wayloom.files.atomic import UNFINISHED
from wayloom.pipeline.folders import new_folders, put_in_place, sole_writer, sweep, whole_folder, writing_to


def test_a_folder_takes_its_place_when_the_block_ends(tmp_path):
    with whole_folder(tmp_path / "stage") as folder:
        (folder / "file").write_text("new")
        assert not (tmp_path / "stage").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["stage"]
    assert (tmp_path / "stage" / "file").read_text() == "new"


def test_a_folder_replaces_the_one_that_was_there(tmp_path):
    (tmp_path / "stage").mkdir()
    (tmp_path / "stage" / "old").touch()
    with whole_folder(tmp_path / "stage") as folder:
        (folder / "new").touch()
    assert [path.name for path in (tmp_path / "stage").iterdir()] == ["new"]
    assert [path.name for path in tmp_path.iterdir()] == ["stage"]


def test_a_failure_leaves_what_was_there(tmp_path):
    (tmp_path / "stage").mkdir()
    (tmp_path / "stage" / "old").touch()
    with pytest.raises(FileNotFoundError), whole_folder(tmp_path / "stage") as folder:
        (folder / "new").rename(folder / "missing" / "place")
    assert [path.name for path in (tmp_path / "stage").iterdir()] == ["old"]
    assert [path.name for path in tmp_path.iterdir()] == ["stage"]


def test_a_file_replaces_a_file(tmp_path):
    (tmp_path / "a").write_text("new")
    (tmp_path / "b").write_text("old")
    put_in_place(tmp_path / "a", tmp_path / "b")
    assert (tmp_path / "b").read_text() == "new"


def test_a_sweep_removes_what_killed_processes_left_and_nothing_else(tmp_path):
    (tmp_path / f"{UNFINISHED}x").mkdir()
    (tmp_path / f"{UNFINISHED}x" / "half").touch()
    (tmp_path / f"{UNFINISHED}y").write_text("half a file")
    (tmp_path / "odometry").mkdir()
    sweep(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["odometry"]


def test_folders_that_a_failed_run_made_are_removed(tmp_path):
    with pytest.raises(RuntimeError), new_folders(tmp_path / "a" / "b"), sole_writer(tmp_path / "a" / "b"):
        raise RuntimeError
    assert not list(tmp_path.iterdir())


def test_folders_that_were_there_before_stay(tmp_path):
    (tmp_path / "a").mkdir()
    with pytest.raises(RuntimeError), new_folders(tmp_path / "a" / "b"):
        raise RuntimeError
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def finish_one_stage_and_fail(stages):
    (stages / "odometry").mkdir()
    (stages / "segmentation" / "left").mkdir()


def test_finished_stages_survive_the_failure_of_a_later_one(tmp_path):
    with pytest.raises(FileNotFoundError), new_folders(tmp_path / "out" / "stages"):
        finish_one_stage_and_fail(tmp_path / "out" / "stages")
    assert (tmp_path / "out" / "stages" / "odometry").is_dir()


def test_a_second_writer_is_refused(tmp_path):
    with sole_writer(tmp_path), pytest.raises(ConflictError, match="another wayloom process"), sole_writer(tmp_path):
        pass


def test_the_lock_of_a_process_that_was_killed_is_free(tmp_path):
    program = (
        "import os, pathlib, signal, sys\n"
        "from wayloom.pipeline.folders import sole_writer\n"
        "with sole_writer(pathlib.Path(sys.argv[1])):\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    ended = subprocess.run([sys.executable, "-c", program, str(tmp_path)], check=False)
    assert ended.returncode == -9
    with sole_writer(tmp_path):
        pass


@pytest.mark.parametrize(("number", "words"), [(errno.ENOSPC, "free some space"), (errno.EACCES, "choose a folder")])
def test_what_the_system_refuses_is_one_line_with_a_remedy(tmp_path, number, words):
    with pytest.raises(InputError, match=words) as caught, writing_to(tmp_path):
        raise OSError(number, "refused", str(tmp_path / "file"))
    assert str(tmp_path / "file") in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_in_the_way_is_named(tmp_path):
    (tmp_path / "out").touch()
    with pytest.raises(InputError, match="out"), writing_to(tmp_path / "out"), new_folders(tmp_path / "out" / "stages"):
        pass
