"""Grip on the processes of one deployment, by which drills kill, hold and starve them."""

from contextlib import AbstractContextManager
from typing import Protocol


class NotTriedError(Exception):
    """What this grip cannot do on this machine, and why."""


class Hands(Protocol):
    """One deployment: its address, its key, how long it waits for a silent worker, and what can be done to its processes.

    Each raises NotTriedError where it cannot be done here, ServiceError where it should have worked.
    """

    url: str
    key: str | None
    lease_s: float

    def kill_api(self) -> None:
        """kill -9 of the API; it comes back."""
        ...

    def kill_workers(self) -> None:
        """kill -9 of every worker; they come back."""
        ...

    def hold_workers(self, seconds: float) -> None:
        """Stop every worker where it is, as a machine does that is out of breath, and let it go on after a while."""
        ...

    def wipe_broker(self) -> None:
        """Take every message from the broker."""
        ...

    def restart_database(self) -> None:
        """End the database without a word, and start it again."""
        ...

    def beside(self, *arguments: str) -> AbstractContextManager[None]:
        """One more process, of `python` with these arguments, where the sweeper's is, while this lasts."""
        ...

    def full_disk(self) -> AbstractContextManager[None]:
        """No byte free on the disk of the data folder while this lasts."""
        ...

    def jump_clock(self, seconds: float) -> None:
        """Have every process see a clock that is so far from the true one; 0: the true one."""
        ...
