"""Drills of cut uploads, a few of those that `benchmarks/upload_drills.py` does by the thousand."""

from pathlib import Path

from service_kit.cut_uploads import drills


def test_an_upload_that_is_cut_anywhere_arrives_whole_and_sends_no_more_than_a_chunk_twice_a_cut(tmp_path: Path) -> None:
    for drill in drills(8, 1, tmp_path):
        drill.check()
