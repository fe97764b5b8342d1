"""Child processes that end with their parent."""

import ctypes
import os
import signal
import sys
from collections.abc import Callable


def ending_with_parent(number: signal.Signals) -> Callable[[], None] | None:
    """What a child does first: ask Linux to send it a signal when this process ends, even by kill -9. (Elsewhere None: nothing.)

    Linux takes the thread that made the child for its parent: it must outlive the child.
    """
    if sys.platform != "linux":
        return None
    parent, prctl = os.getpid(), ctypes.CDLL(None).prctl

    def ask() -> None:
        prctl(1, number)  # PR_SET_PDEATHSIG
        if os.getppid() != parent:  # it ended before we asked
            os._exit(1)

    return ask
