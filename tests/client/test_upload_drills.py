"""Drills of cut uploads, a few of those that `benchmarks/upload_drills.py` does by the thousand."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from upload_drills import CHUNK, OVERHEAD, drills


def test_an_upload_that_is_cut_anywhere_arrives_whole_and_sends_no_more_than_a_chunk_twice_a_cut(tmp_path: Path) -> None:
    for drill in drills(8, 1, tmp_path):
        assert drill.whole, drill
        assert drill.again <= drill.cuts * CHUNK + OVERHEAD, drill
