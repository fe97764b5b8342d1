"""Messages to workers: those that went out are remembered, and a broker that is away is no error."""

from typing import Any

from wayloom.store import drives, sweep
from wayloom.store.database import Database
from wayloom.store.jobs import JobMessage
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.notifier import JobNotifier


class AwayError(Exception):
    """The broker cannot be reached."""


class Broker:
    """Takes so many messages and is away from then on."""

    def __init__(self, room: int) -> None:
        self.room, self.sent = room, list[tuple[int, str]]()

    def send_task(self, _name: str, args: list[Any], *, queue: str) -> None:
        if len(self.sent) == self.room:
            raise AwayError
        self.sent.append((args[0], queue))


def queued(database: Database, name: str) -> JobMessage:
    with database.write() as session:
        manifest = Manifest(name=name, files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        message = drives.mark_complete(session, drives.register(session, manifest, "city")[0].id, "log/a")
    assert message is not None
    return message


def test_messages_go_into_their_jobs_queues_and_are_not_sent_again(database: Database) -> None:
    messages, broker = [queued(database, "a"), queued(database, "b")], Broker(9)
    JobNotifier(database, broker, AwayError)(messages)
    assert broker.sent == [(message.job_id, "ingest") for message in messages]
    assert sweep.unsent(database, 10.0) == []


def test_what_a_broker_that_went_away_did_not_take_is_sent_later(database: Database) -> None:
    messages, broker = [queued(database, name) for name in "abc"], Broker(1)
    JobNotifier(database, broker, AwayError)(messages)
    assert sweep.unsent(database, 10.0) == messages[1:]
