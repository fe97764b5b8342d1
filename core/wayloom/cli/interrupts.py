"""Ctrl-C that is not lost: compiled code and callbacks sometimes swallow the KeyboardInterrupt that Python raises within them."""

import signal
import threading

_pressed = threading.Event()


def listen() -> None:
    """Note every Ctrl-C from now on, and raise KeyboardInterrupt as ever."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, _note)


def check() -> None:
    """Raise KeyboardInterrupt once more where one was noted: for long work that reports its progress."""
    if _pressed.is_set():
        raise KeyboardInterrupt


def _note(number: int, frame: object) -> None:
    _pressed.set()
    raise KeyboardInterrupt
