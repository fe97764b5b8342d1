"""Hooks of a worker around a stage: how its output is addressed and made, what is shared of it, which rows follow from it."""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from wayloom.config.progress import Progress
from wayloom.errors import ConfigError, WayloomError
from wayloom.pipeline.digests import sha256_of_json
from wayloom.pipeline.settings import WayloomSettings
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database, Session
from wayloom.store.drive_files import DriveFiles
from wayloom.store.folders import Folders
from wayloom.store.jobs import Claim, JobMessage


class RepeatStageError(WayloomError):
    """What the stage has found out shows that it must be run again, with other inputs. The attempt does not count."""

    code = "repeat-stage"


@dataclass(frozen=True, slots=True)
class WorkerContext:
    """What a worker has at hand for every job."""

    settings: WayloomSettings
    database: Database
    blobs: BlobStore
    folders: Folders
    files: DriveFiles


@dataclass(frozen=True, slots=True)
class StageAttempt:
    """One attempt of one stage.

    log_path, gnss_path   the drive's log and the GNSS log beside it; None for a map's stage
    inputs_dir            the finished stages that it reads, each a folder by its name
    inputs                the key of each of them
    out_dir               where to write; an empty folder that becomes the stage's output when the stage returns
    """

    context: WorkerContext
    claim: Claim
    log_path: Path | None
    gnss_path: Path | None
    inputs_dir: Path
    inputs: Mapping[str, str]
    out_dir: Path
    progress: Progress


@dataclass(frozen=True, slots=True)
class StageParts:
    """A stage that several workers may make together.

    folder   in which finished parts lie; goes once the stage is done
    missing  numbers, from 1, of the parts that are still to be made, after what all of them need is there; none where the stage
             is better made as a whole, or all are there
    has      whether one part is there
    make     makes one part into the attempt's out_dir
    place    where a finished part belongs
    """

    folder: Path
    missing: Callable[[], list[int]]
    has: Callable[[int], bool]
    make: Callable[[int], None]
    place: Callable[[int], Path]


@dataclass(frozen=True, slots=True)
class PreparedStage:
    """key: the address of the output, a hash of all that it depends on. run: makes it; may take hours and be killed. parts: of a
    stage that can be made in parts, which `run` then joins."""

    key: str
    run: Callable[[], None]
    parts: StageParts | None = None


Record = Callable[[Session], list[JobMessage]]
"""Writes rows in a transaction that is open; returns messages of new jobs."""


@dataclass(frozen=True, slots=True)
class StageHooks:
    """What a worker does around a stage.

    prepare  the output's key and how to make it; where an output of that key exists it is not made again
    share    puts what others need of the output into the blob store; idempotent, also called when the output was there already
    record   reads of the output what the database is to know, and returns what writes it in the transaction that finishes the job:
             what takes time is done before that one begins, as on SQLite it keeps all others from writing
    """

    prepare: Callable[[StageAttempt], PreparedStage]
    share: Callable[[StageAttempt], None] = lambda _attempt: None
    record: Callable[[StageAttempt], Record] = lambda _attempt: lambda _session: []


HookTable = Callable[[str], StageHooks]
"""The hooks of a stage by its name."""


def at_once(write: Callable[[Session, StageAttempt], list[JobMessage]]) -> Callable[[StageAttempt], Record]:
    """`record` of a stage that has nothing to read."""
    return lambda attempt: lambda session: write(session, attempt)


def keyed_by_inputs(run: Callable[[StageAttempt], None]) -> Callable[[StageAttempt], PreparedStage]:
    """`prepare` of a stage whose output depends on nothing but the job and its inputs."""
    return lambda attempt: PreparedStage(key_of_inputs(attempt), lambda: run(attempt))


def key_of_inputs(attempt: StageAttempt) -> str:
    """The address of an output that depends on nothing but the job and its inputs."""
    held = attempt.claim
    about = {"of": held.drive_id or held.map_id, "job": held.job_id if held.drive_id is None else None}
    return sha256_of_json({"stage": held.stage, **about, "inputs": dict(attempt.inputs)})


def load_hooks(name: str) -> HookTable:
    """The function that `module:NAME` names. Raises ConfigError."""
    module, _, attribute = name.partition(":")
    try:
        hooks: HookTable = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(f"WAYLOOM_STAGE_HOOKS: {name!r} cannot be loaded: {error}", remedy="write module:NAME") from error
    return hooks
