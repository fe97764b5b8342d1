"""Drills of a service's processes: each disturbs simulated drives on their way, which have to end in the same map all the same."""

import contextlib
import random
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

from wayloom.client.selftest.hands import Hands, NotTriedError
from wayloom.client.selftest.report import Verdict
from wayloom.client.selftest.subject import FailedCheckError
from wayloom.client.selftest.trial import Trial
from wayloom.config.stages import drive_stages
from wayloom.errors import WayloomError

KILLS: Final = 2
HELD_LEASES: Final = 1.5
FULL_S: Final = 4.0
JUMP_S: Final = 3600.0
SWEEPER: Final = ("-m", "wayloom_workers", "sweep")
REPEATED: Final = """\
import time
from contextlib import suppress

from wayloom.pipeline.settings import load_settings
from wayloom.store.database import DatabaseError
from wayloom.store.sweep import open_jobs
from wayloom_workers.__main__ import make_context
from wayloom_workers.broker import make_app, make_notifier

context = make_context(load_settings().settings)
notify = make_notifier(make_app(context.settings), context.database)
while True:
    time.sleep(0.7)
    with suppress(DatabaseError):
        notify(open_jobs(context.database))
"""
"""Sends the message of every job that is queued or runs, again and again: what a broker does at its worst. As text: it runs by what
the deployment has installed."""


@dataclass(frozen=True, slots=True)
class ProcessDrill:
    """One drill: what it asks of a service, and how. `run` ends when the drives are on their way again."""

    name: str
    asks: str
    run: Callable[[Hands, Trial], None]


def undisturbed(_: Hands, trial: Trial) -> None:
    """Nothing: the map with which those of the drills are compared."""
    trial.send()


def killed_in_upload(hands: Hands, trial: Trial) -> None:
    """kill -9 of the API at a random share of the upload."""
    due = [random.uniform(0.05, 0.95)]

    def told(share: float, _what: str, /) -> None:
        if due and share >= due[0]:
            due.clear()
            hands.kill_api()

    trial.send(told)


def killed_workers(hands: Hands, trial: Trial) -> None:
    """kill -9 of all workers in some stages."""
    trial.send()
    for stage in _some_stages(KILLS):
        trial.await_stage(stage)
        hands.kill_workers()


def twice_delivered(hands: Hands, trial: Trial) -> None:
    """The message of every open job again and again."""
    with hands.beside("-c", REPEATED):
        trial.send()
        trial.finish()


def two_sweepers(hands: Hands, trial: Trial) -> None:
    """One sweeper more, while workers are killed."""
    with hands.beside(*SWEEPER):
        killed_workers(hands, trial)
        trial.finish()


def wiped_broker(hands: Hands, trial: Trial) -> None:
    """The broker loses every message, some times."""
    trial.send()
    for stage in _some_stages(KILLS):
        trial.await_stage(stage)
        hands.wipe_broker()


def expired_lease(hands: Hands, trial: Trial) -> None:
    """Workers that stand still past their lease, and then go on with what is not theirs any more."""
    trial.send()
    trial.await_stage(*_some_stages(1))
    hands.hold_workers(HELD_LEASES * hands.lease_s)


def full_disk(hands: Hands, trial: Trial) -> None:
    """No byte is free for a while."""
    with hands.full_disk():  # told before anything is sent where it cannot be had
        time.sleep(FULL_S / 4)
    trial.send()
    trial.await_stage(*_some_stages(1))
    with hands.full_disk():
        time.sleep(FULL_S)


def ended_database(hands: Hands, trial: Trial) -> None:
    """The database ends without a word, once while nothing is to be done, once in the middle of a stage."""
    hands.restart_database()
    trial.send()
    trial.await_stage(*_some_stages(1))
    hands.restart_database()


def jumped_clock(hands: Hands, trial: Trial) -> None:
    """The clock goes an hour forward, and later back, and workers are killed there."""
    hands.jump_clock(0.0)
    trial.send()
    try:
        for seconds in (JUMP_S, 0.0):
            trial.await_stage(*_some_stages(1))
            hands.jump_clock(seconds)
            hands.kill_workers()
    finally:
        with contextlib.suppress(NotTriedError):
            hands.jump_clock(0.0)


def _some_stages(count: int) -> list[str]:
    """Stages of a drive at random, in their order."""
    return sorted(random.sample(drive_stages(), count), key=drive_stages().index)


PROCESS_DRILLS: Final = (
    ProcessDrill("undisturbed", "drives go through every stage into the map", undisturbed),
    ProcessDrill("killed in upload", "kill -9 of the API in the middle of an upload loses nothing", killed_in_upload),
    ProcessDrill("killed workers", f"kill -9 of all workers in {KILLS} stages counts no attempt", killed_workers),
    ProcessDrill("delivered twice", "messages that come again and again do nothing twice", twice_delivered),
    ProcessDrill("two sweepers", "two sweepers at once do no harm", two_sweepers),
    ProcessDrill("wiped broker", f"a broker that loses everything {KILLS} times costs seconds", wiped_broker),
    ProcessDrill("expired lease", "a worker that stood still past its lease changes nothing", expired_lease),
    ProcessDrill("full disk", "a full disk is waited for", full_disk),
    ProcessDrill("ended database", "a database that ended without a word is waited for", ended_database),
    ProcessDrill("jumped clock", f"a clock that jumps by {JUMP_S / 3600.0:.0f} h and back holds nothing up", jumped_clock),
)


def drilled(hands: Hands, trial: Trial) -> Iterator[Verdict]:
    """Every drill, one after the other, each with the drives sent anew. One that fails does not end the others."""
    for drill in PROCESS_DRILLS:
        yield _verdict(hands, trial, drill)


def _verdict(hands: Hands, trial: Trial, drill: ProcessDrill) -> Verdict:
    """After the drives are through, or the drill has failed, they are removed."""
    verdict, found = "passed", ""
    try:
        drill.run(hands, trial)
        trial.finish()
    except NotTriedError as reason:
        verdict, found = "not tried", str(reason)
    except (FailedCheckError, WayloomError) as error:
        verdict, found = "failed", str(error)
    try:
        trial.forget()
    except (FailedCheckError, WayloomError) as error:
        verdict, found = "failed", f"{found}; the drives are not removed: {error}".lstrip("; ")
    return Verdict("process", drill.name, drill.asks, verdict, found)
