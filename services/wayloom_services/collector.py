"""Work on very many objects without the cyclic garbage collector, which would stop all threads to look at each of them."""

import gc
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_lock = threading.Lock()
_paused = 0


def spare_what_is_loaded() -> None:
    """Modules, routes and compiled kernels' types stay for the life of the process: no collection looks at them again."""
    gc.collect()
    gc.freeze()


@contextmanager
def paused_collector() -> Iterator[None]:
    """No collection while any thread is in such a block. For work whose objects form no cycles, so that nothing stays for it."""
    global _paused
    with _lock:
        _paused += 1
        gc.disable()
    try:
        yield
    finally:
        with _lock:
            _paused -= 1
            if _paused == 0:
                gc.enable()
