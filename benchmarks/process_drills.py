"""Drills of the service's processes: workers killed in every stage, brokers wiped, a database that is ended, a disk that is full.

    python benchmarks/process_drills.py [--minutes 25] [--kills 200] [--seed 0] [--mixed] [--database postgresql] [--write]

Starts a real embedded service (API, workers, broker, sweeper; SQLite, or a PostgreSQL of its own from the machine's binaries), on a
small disk where this process may mount one, and sends simulated drives through all stages: first undisturbed, then round after
round with faults at random moments. After each round every drive has to be in the map, no stage may have counted a failure, and
the digests of all tiles and regions have to be those of the undisturbed run; then the drives are removed, and the next round sends
them again. A worker counts as killed in a stage when the stage's row was its own while it was stopped just before the kill. The run
ends at the first round that ends otherwise, and keeps a copy of the service's folder.
"""

import argparse
import contextlib
import os
import random
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from sqlalchemy import select

from pages import DOCS, put_between_marks
from service_kit import postgres
from wayloom.client.selftest.embedded import EmbeddedHands
from wayloom.client.selftest.process_drills import REPEATED, SWEEPER
from wayloom.client.selftest.trial import Trial, small_drives
from wayloom.config.stages import drive_stages, map_stages
from wayloom.store.database import Database, DatabaseError
from wayloom.store.tables.drives import Job

PAGE = DOCS / "benchmarks" / "process_drills.md"
WORKERS = 3
LOOK_S = 0.004
FULL_S, AWAY_S = 3.0, 2.0
"""How long a disk stays full, and a database away."""
HELD = 1.5
"""A worker is stopped for so many leases."""
KILL_SHARE = 0.6
"""Of the stages that are seen to run in a round of kills."""
FAULTS = ("worker killed", "broker wiped", "worker stopped past its lease", "disk full", "database ended and started again")


@dataclass
class Tally:
    """Faults by kind and stage, rounds that ended as the undisturbed one, and what the next round does."""

    counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    rounds: int = 0

    def of(self, fault: str) -> int:
        return sum(count for (kind, _), count in self.counts.items() if kind == fault)


class Stages:
    """The jobs that run, as their rows say."""

    def __init__(self, url: str) -> None:
        self._database = Database(url)
        self.usual_s: dict[str, float] = defaultdict(lambda: 0.5)

    def running(self) -> dict[int, tuple[str, int, int]]:
        """Job to stage, process id of its worker and token."""
        try:
            with self._database.read() as session:
                rows = session.execute(select(Job.id, Job.stage, Job.worker, Job.token).where(Job.state == "running")).all()
        except DatabaseError:
            return {}
        return {job: (stage, int(worker.split("|")[1]), token) for job, stage, worker, token in rows if worker}

    def learn(self) -> None:
        """How long each stage took."""
        with self._database.read() as session:
            for stage, begun, ended in session.execute(select(Job.stage, Job.started_at, Job.finished_at)):
                if begun and ended:
                    self.usual_s[stage] = ended - begun


def held(stages: Stages, job: int, seen: tuple[str, int, int]) -> bool:
    """Stop the worker; whether it is in the stage. It goes on where it is not."""
    _, pid, _ = seen
    try:
        os.kill(pid, signal.SIGSTOP)
    except ProcessLookupError:
        return False
    if stages.running().get(job) == seen:
        return True
    os.kill(pid, signal.SIGCONT)
    return False


def disturb(hands: EmbeddedHands, stages: Stages, fault: str, job: int, seen: tuple[str, int, int]) -> bool:
    """Do it to the job that runs. Whether it hit that stage."""
    if fault in ("worker killed", "worker stopped past its lease"):
        if not held(stages, job, seen):
            return False
        if fault == "worker killed":
            os.kill(seen[1], signal.SIGKILL)
        else:
            threading.Timer(HELD * hands.lease_s, lambda: _go_on(seen[1])).start()
        return True
    if stages.running().get(job) != seen:
        return False
    if fault == "broker wiped":
        hands.wipe_broker()
    elif fault == "disk full":
        with hands.full_disk():
            time.sleep(FULL_S)
    else:
        hands.restart_database()
    return True


def _go_on(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGCONT)


def one_round(
    hands: EmbeddedHands, trial: Trial, stages: Stages, kinds: tuple[str, ...], tally: Tally, dice: random.Random
) -> None:
    """Send the drives, disturb what is on its way, and expect what the undisturbed round left."""
    over = threading.Event()
    errors: list[BaseException] = []

    def follow() -> None:
        try:
            trial.send()
            trial.finish()
        except BaseException as error:
            errors.append(error)
        finally:
            over.set()

    thread = threading.Thread(target=follow)
    thread.start()
    known: set[tuple[int, int]] = set()
    due: list[tuple[float, str, int, tuple[str, int, int]]] = []
    while not over.wait(LOOK_S):
        now = time.monotonic()
        for job, seen in stages.running().items():
            if (job, seen[2]) in known:
                continue
            known.add((job, seen[2]))
            fault = dice.choice(kinds)
            rare = 1.0 / (1 + tally.counts[fault, seen[0]] - min(tally.counts[fault, name] for name in ALL))
            if dice.random() < KILL_SHARE * rare**0.5:
                due.append((now + dice.uniform(0.0, 0.9) * stages.usual_s[seen[0]], fault, job, seen))
        for entry in [one for one in due if one[0] <= now]:
            due.remove(entry)
            _, fault, job, seen = entry
            if disturb(hands, stages, fault, job, seen):
                tally.counts[fault, seen[0]] += 1
    thread.join()
    if errors:
        raise errors[0]
    tally.rounds += 1
    trial.forget()


ALL = (*drive_stages(), *map_stages())


class OnPostgres(EmbeddedHands):
    """The service on a PostgreSQL cluster, which can be ended as by a loss of power, and started again."""

    cluster = ""

    def restart_database(self) -> None:
        """pg_ctl stop -m immediate, a while, start."""
        with postgres.stopped(self.cluster):
            time.sleep(AWAY_S)


@contextlib.contextmanager
def service(database: str) -> Iterator[tuple[EmbeddedHands, str, tuple[str, ...]]]:
    """The service, the URL of its database, and the faults that can be made here."""
    with contextlib.ExitStack() as stack:
        if database == "postgresql":
            folder = stack.enter_context(postgres.cluster())
            url = postgres.new_database(folder)
            OnPostgres.cluster = folder
            hands: EmbeddedHands = stack.enter_context(OnPostgres(WORKERS, WAYLOOM_DATABASE_URL=url))
            faults: tuple[str, ...] = FAULTS
        else:
            hands = stack.enter_context(EmbeddedHands(WORKERS))
            url, faults = f"sqlite:///{hands.data / 'wayloom.db'}", FAULTS[:-1]
        yield hands, url, faults if hands.has_small_disk else tuple(name for name in faults if name != "disk full")


def table(tally: Tally) -> list[str]:
    """A row a fault, a column a stage."""
    lines = [f"| fault | {' | '.join(ALL)} | all |", f"|{' --- |' * (len(ALL) + 2)}"]
    for fault in FAULTS:
        if tally.of(fault):
            counts = " | ".join(str(tally.counts[fault, stage]) for stage in ALL)
            lines.append(f"| {fault} | {counts} | {tally.of(fault)} |")
    return lines


def keep(hands: EmbeddedHands, tally: Tally, seed: int) -> None:
    """What a round that ended otherwise leaves to be looked at."""
    kept = Path(tempfile.mkdtemp(prefix="wayloom-drill-kept-"))
    shutil.copytree(hands.folder, kept, dirs_exist_ok=True, ignore=shutil.ignore_patterns("*.sock"))
    print(f"round {tally.rounds + 1} of seed {seed}; the service's folder is kept as {kept}", file=sys.stderr)
    print("\n".join(table(tally)), file=sys.stderr, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=25.0, help="begin no round after so many")
    parser.add_argument("--kills", type=int, default=200, help="begin no round after so many kills")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--drives", type=int, default=2, choices=(1, 2))
    parser.add_argument("--database", choices=("sqlite", "postgresql"), default="sqlite")
    parser.add_argument("--mixed", action="store_true", help="all faults in every round, and not in every third alone")
    parser.add_argument("--logs", type=Path, default=Path(tempfile.gettempdir()) / "wayloom-drill-drives", help="simulated drives")
    parser.add_argument("--write", action="store_true", help="into the page")
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # both end the service too
    dice, tally, began = random.Random(arguments.seed), Tally(), time.monotonic()
    drives = small_drives(arguments.logs, ("car-1", "car-2")[: arguments.drives])
    with service(arguments.database) as (hands, url, faults):
        trial, stages = Trial(hands.url, hands.key, drives), Stages(url)
        trial.send()
        trial.finish()
        stages.learn()
        trial.forget()
        with hands.beside("-c", REPEATED), hands.beside(*SWEEPER):
            while time.monotonic() - began < 60 * arguments.minutes and tally.of("worker killed") < arguments.kills:
                kinds = faults if arguments.mixed or tally.rounds % 3 == 2 else faults[:2] if tally.rounds % 3 == 1 else faults[:1]
                try:
                    one_round(hands, trial, stages, kinds, tally, dice)
                except BaseException:
                    keep(hands, tally, arguments.seed)
                    raise
                print(f"round {tally.rounds}: {tally.of('worker killed')} kills, {time.monotonic() - began:.0f} s", flush=True)
    minutes = (time.monotonic() - began) / 60
    told = (
        f"{arguments.database}, seed {arguments.seed}: {tally.rounds} disturbed rounds of {len(drives)} drives in {minutes:.0f} "
        "minutes, with a second sweeper and every message again and again. Every drive ended in the map, no stage counted a "
        "failure, and after each round the map was bit by bit that of the undisturbed one."
    )
    text = "\n".join([told, "", *table(tally)])
    print(text)
    if arguments.write:
        put_between_marks(PAGE, arguments.database, text)


if __name__ == "__main__":
    main()
