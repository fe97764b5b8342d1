"""Progress of a pack in the database."""

from collections.abc import Callable

from sqlalchemy.orm import Session

from wayloom.store import packs
from wayloom.store.database import Database
from wayloom.store.jobs import JobMessage
from wayloom.store.packs import Pack


class PackRows:
    """Tells the database of the files of a pack that are in their places, and gathers messages to the workers.

    done : how many of the files, in the pack's order
    """

    def __init__(self, database: Database, pack: Pack, done: int, expiry_s: float) -> None:
        self.pack, self.done, self.messages = pack, done, list[JobMessage]()
        self._database, self._expiry_s = database, expiry_s

    def tell(self, end: int) -> None:
        """The files up to `end` lie in the drive's folder."""
        with self._database.write() as session:
            told = self.tell_within(session, end)
        told()

    def tell_within(self, session: Session, end: int, *, in_objects: bool = False) -> Callable[[], None]:
        """The same in a transaction that is open, and of files in an object store; to be called: what it returns, once it has
        committed."""
        message = packs.mark_done(session, self.pack, self.done, end, self._expiry_s, in_objects=in_objects)

        def told() -> None:
            self.done = end
            if message is not None:
                self.messages.append(message)

        return told
