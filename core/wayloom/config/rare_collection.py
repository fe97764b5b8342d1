"""Searches for cycles of objects, as rarely as their cost asks for.

Python looks through objects for cycles again and again while modules are loaded, where there are hardly any; and no thread runs
meanwhile.
"""

import gc
from typing import Final

THRESHOLDS: Final = (20_000, 20, 20)
"""Objects more than before at which new ones are looked through, and of how many such searches one is of older ones, and of all.

Python 3.11 has (700, 10, 10).
"""


def collect_rarely() -> None:
    """Search for cycles by `THRESHOLDS` from now on. The programs do so; `import wayloom` does not."""
    gc.set_threshold(*THRESHOLDS)
