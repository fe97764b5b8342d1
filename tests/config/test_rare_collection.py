"""How often our programs search for cycles, and a notebook of somebody else's."""

import subprocess
import sys

import pytest

from wayloom.config.rare_collection import THRESHOLDS

USUAL = subprocess.check_output([sys.executable, "-c", "import gc; print(gc.get_threshold())"], text=True).strip()


@pytest.mark.parametrize(
    ("module", "expected"), [("wayloom.cli", str(THRESHOLDS)), ("wayloom_workers", str(THRESHOLDS)), ("wayloom", USUAL)]
)
def test_the_programs_search_rarely_and_the_library_leaves_it_to_its_user(module: str, expected: str) -> None:
    code = f"import gc, {module}; print(gc.get_threshold())"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == expected


def test_cycles_are_still_found() -> None:
    code = (
        "import wayloom.cli, gc, weakref\n"
        "class Node: pass\n"
        "def ring():\n"
        "    node = Node(); node.self = node; return weakref.ref(node)\n"
        "first = ring(); kept = [ring() for _ in range(3 * gc.get_threshold()[0])]\n"
        "print(first() is None)\n"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "True"
