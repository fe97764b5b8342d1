"""What a stage is to a worker, and the table of stages that a worker runs."""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from wayloom.config.progress import Progress
from wayloom.errors import ConfigError
from wayloom.pipeline.keys import sha256_of_json
from wayloom.pipeline.settings import WayloomSettings
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database, Session
from wayloom.store.folders import Folders
from wayloom.store.jobs import Claim, JobMessage


@dataclass(frozen=True, slots=True)
class WorkerContext:
    """What a worker has at hand for every job."""

    settings: WayloomSettings
    database: Database
    blobs: BlobStore
    folders: Folders


@dataclass(frozen=True, slots=True)
class StageAttempt:
    """One attempt of one stage.

    log_path, gnss_path   the drive's log and the GNSS log beside it; None for a map's stage
    inputs_dir            the finished stages before this one, each a folder by its name
    inputs                the key of each of them
    out_dir               where to write; an empty folder that becomes the stage's output when the step returns
    """

    bench: WorkerContext
    claim: Claim
    log_path: Path | None
    gnss_path: Path | None
    inputs_dir: Path
    inputs: Mapping[str, str]
    out_dir: Path
    progress: Progress


def key_of_inputs(work: StageAttempt, /) -> str:
    """The address of an output that depends on nothing but the job and its inputs."""
    held = work.claim
    about = {"of": held.drive_id or held.map_id, "job": held.job_id if held.drive_id is None else None}
    return sha256_of_json({"stage": held.stage, **about, "inputs": dict(work.inputs)})


@dataclass(frozen=True, slots=True)
class Step:
    """A stage as the worker runs it.

    run     does the work; may take hours and be killed at any moment
    share   puts what others need of the output into the blob store; idempotent, also called when the output was there already
    record  writes what follows from it into the database, in the transaction that finishes the job; returns jobs to wake
    key     the address of the output: a hash of all that it depends on; where the output exists the work is not done again
    """

    run: Callable[[StageAttempt], None]
    share: Callable[[StageAttempt], None] = lambda _work: None
    record: Callable[[Session, StageAttempt], list[JobMessage]] = lambda _session, _work: []
    key: Callable[[StageAttempt], str] = key_of_inputs


Steps = Mapping[str, Step]


def load_steps(name: str) -> Steps:
    """The table that `module:NAME` names. Raises ConfigError."""
    module, _, attribute = name.partition(":")
    try:
        steps: Steps = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(f"WAYLOOM_STEPS: {name!r} cannot be loaded: {error}", remedy="write module:NAME") from error
    return steps
