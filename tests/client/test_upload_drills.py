"""Drills of cut uploads, a few of those that `benchmarks/upload_drills.py` does by the thousand."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from upload_drills import CHUNK, OVERHEAD, drills


def test_an_upload_that_is_cut_anywhere_arrives_whole_and_sends_no_more_than_a_chunk_twice(tmp_path: Path) -> None:
    for drill in drills(16, 1, tmp_path):
        assert drill.whole, drill
        assert drill.again <= CHUNK + OVERHEAD, drill
