"""Run of one job, from its claim to its commit."""

import os
import re
import shutil
import time
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Final

import structlog

from wayloom.config.backoff import Backoff
from wayloom.config.stages import REMOVAL
from wayloom.errors import ConflictError, InputError, LeaseLostError, StageError, WayloomError
from wayloom.store import drives, jobs, part_jobs
from wayloom.store.blobs import NotedBlobs
from wayloom.store.database import DatabaseError, Session
from wayloom.store.images import KEPT
from wayloom.store.jobs import ANEW, Claim, JobMessage
from wayloom.store.processes import identity
from wayloom.store.withdrawal import forget_blobs
from wayloom_workers.completion import complete_drive
from wayloom_workers.faults import attempt_folder, crash_report, of_the_machine
from wayloom_workers.heartbeat import Heartbeat, StopRequestedError
from wayloom_workers.stage_hooks import HookTable, PreparedStage, RepeatStageError, StageAttempt, StageHooks, WorkerContext

MACHINE_PAUSES: Final = 4
"""A job that waits for disk or database waits so many times the first pause."""
LOG_OF_DRIVE: Final = re.compile(r"\b[\w-]+/[0-9a-f]{64}/log/")
"""In front of the files of a drive's log, in this machine's folder of its drives."""
log = structlog.get_logger()


def run_job(context: WorkerContext, hooks: HookTable, notify: Callable[[Iterable[JobMessage]], None], job_id: int) -> bool:
    """Run the job if it is to be had. Whatever goes wrong in the stage ends up in the job's row. Returns whether it was claimed."""
    held = jobs.claim(context.database, job_id, identity(), context.settings.lease_s)
    if held is None:
        log.info("nothing to do", job_id=job_id)
        return False
    with structlog.contextvars.bound_contextvars(job_id=job_id, drive_id=held.drive_id, stage=held.stage, attempt=held.attempt):
        started, noted = time.monotonic(), NotedBlobs(context.blobs)
        try:
            notify(_run(replace(context, blobs=noted), hooks(held.stage), held))
            log.info("stage done", seconds=round(time.monotonic() - started, 3))
        except LeaseLostError as error:
            log.warning("lease lost", error=str(error))
            _put_back(lambda session: forget_blobs(session, noted.digests, held.stage), context)  # its drive may be gone
        except RepeatStageError as error:
            log.warning("stage is repeated", why=str(error))
            _give_back(context, held)
        except StopRequestedError:
            _give_back(context, held)
        except Exception as error:
            log.exception("stage failed")
            _write_failure(context, held, error)
    return True


def _run(context: WorkerContext, hooks: StageHooks, held: Claim) -> list[JobMessage]:
    """Make the output, or find it made, and commit. Returns the messages of the jobs that follow."""
    folder = attempt_folder(context.folders, held)
    with Heartbeat(context, held) as beat:
        try:
            with _files(context, held, beat):
                attempt = _attempt(context, held, folder, beat)
                with crash_report(folder):
                    return _make_and_commit(context, hooks, held, attempt, beat)
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def _files(context: WorkerContext, held: Claim, beat: Heartbeat) -> AbstractContextManager[None]:
    """What the drive has sent, where its stage may read it: not where its images were deleted, or go with the drive."""
    if held.drive_id is None or held.stage == REMOVAL.name:
        return nullcontext()
    with context.database.read() as session:
        is_there = drives.get(session, held.drive_id).images == KEPT
    return context.files.held(held.drive_id, beat) if is_there else nullcontext()


def _make_and_commit(
    context: WorkerContext, hooks: StageHooks, held: Claim, attempt: StageAttempt, beat: Heartbeat
) -> list[JobMessage]:
    prepared = hooks.prepare(attempt)
    if held.part:
        return _run_part(context, held, attempt, prepared)
    output = _output(context, held, held.stage, prepared.key)
    if output.is_dir() and ANEW not in held.payload:
        log.info("output is there already", key=prepared.key[:12])
    elif missing := prepared.parts.missing() if prepared.parts else []:
        log.info("waiting for parts", parts=len(missing))
        with context.database.write() as session:
            return part_jobs.await_parts(session, held, missing, prepared.key, context.settings.max_attempts)
    else:
        prepared.run()
        beat.check()
        _keep(attempt.out_dir, output, anew=ANEW in held.payload)
    done = replace(attempt, out_dir=output)
    hooks.share(done)
    record = hooks.record(done)
    with context.database.write() as session:
        following = jobs.finish(session, held, prepared.key)
        messages = [*record(session), *([following] if following else [])]
        if held.drive_id is not None and following is None and held.stage != REMOVAL.name:
            messages += complete_drive(session, held.drive_id)
    if prepared.parts:
        shutil.rmtree(prepared.parts.folder, ignore_errors=True)
    return messages


def _run_part(context: WorkerContext, held: Claim, attempt: StageAttempt, prepared: PreparedStage) -> list[JobMessage]:
    """Make one part of a stage, or find it made, and commit. Returns the message of the stage's own job after the last one."""
    if prepared.parts is None or prepared.key != held.payload.get("key"):
        raise ConflictError(f"this worker's code or settings are not those of the one that asked for part {held.part}")
    if not prepared.parts.has(held.part):
        prepared.parts.make(held.part)
        attempt.progress(1.0, "part done")
        place = prepared.parts.place(held.part)
        shutil.rmtree(place, ignore_errors=True)  # damaged
        _keep(attempt.out_dir, place)
    with context.database.write() as session:
        jobs.finish(session, held, prepared.key)
        following = part_jobs.after_part(session, held)
    return [following] if following else []


def _home(context: WorkerContext, held: Claim) -> Path:
    return context.folders.map(held.map_id) if held.map_id is not None else context.folders.drive(str(held.drive_id))


def _output(context: WorkerContext, held: Claim, stage: str, key: str) -> Path:
    return _home(context, held) / "stages" / stage / key


def _attempt(context: WorkerContext, held: Claim, folder: Path, beat: Heartbeat) -> StageAttempt:
    """Fresh folders for the attempt; what earlier attempts of the job left is removed."""
    for old in folder.parent.glob(f"{held.stage}-{held.job_id}-*"):
        shutil.rmtree(old, ignore_errors=True)
    inputs_dir, out_dir = folder / "inputs", folder / "out"
    inputs_dir.mkdir(parents=True)
    out_dir.mkdir()
    inputs = _inputs(context, held)
    for name, key in inputs.items():
        output = _output(context, held, name, key)
        if not output.is_dir():
            raise StageError(f"the output of {name} is gone from {output}: remove the drive and send it again")
        (inputs_dir / name).symlink_to(output, target_is_directory=True)
    log_path, gnss_path = _drive_paths(context, held)
    return StageAttempt(context, held, log_path, gnss_path, inputs_dir, inputs, out_dir, beat)


def _inputs(context: WorkerContext, held: Claim) -> dict[str, str]:
    """The stages whose results this one reads, and the keys of their outputs."""
    if held.drive_id is not None:
        with context.database.read() as session:
            return jobs.input_keys(session, held.drive_id, held.stage)
    return {"stitch": str(held.payload["stitch"])} if "stitch" in held.payload else {}


def _drive_paths(context: WorkerContext, held: Claim) -> tuple[Path | None, Path | None]:
    if held.drive_id is None:
        return None, None
    with context.database.read() as session:
        manifest = drives.get(session, held.drive_id).manifest
    folder = context.folders.drive(held.drive_id)
    return folder / manifest["log"], folder / manifest["gnss"] if manifest.get("gnss") else None


def _keep(out_dir: Path, output: Path, *, anew: bool = False) -> None:
    """Turn the attempt into the output by one rename. If another attempt was faster, its output (the same bytes) stays; but not
    where the stage is to be made anew."""
    output.parent.mkdir(parents=True, exist_ok=True)
    if anew and output.is_dir():
        os.rename(output, out_dir.with_name("before"))
    try:
        os.rename(out_dir, output)
    except OSError:
        if not output.is_dir():
            raise


def _give_back(context: WorkerContext, held: Claim) -> None:
    _put_back(lambda session: jobs.release(session, held), context)
    log.info("job given back")


def _put_back(change: Callable[[Session], None], context: WorkerContext) -> None:
    """Let go of the job. What cannot be written the sweeper finds when the lease has run out."""
    try:
        with context.database.write() as session:
            change(session)
    except LeaseLostError as error:
        log.warning("lease lost", error=str(error))
    except DatabaseError as error:
        log.warning("the job could not be let go of", error=str(error))


def _write_failure(context: WorkerContext, held: Claim, error: Exception) -> None:
    """Bad input fails at once; what is the machine's fault waits and counts not; anything else fails after the last attempt, with
    growing pauses before."""
    backoff = Backoff(context.settings.retry_first_s, context.settings.retry_longest_s)
    if (why := of_the_machine(error)) is not None:
        log.warning("job is put back", why=why)
        _put_back(lambda session: jobs.pause(session, held, f"waits: {why}", MACHINE_PAUSES * backoff.first_s), context)
        return
    final = isinstance(error, InputError | StageError) or held.attempt >= context.settings.max_attempts
    text = str(error) if isinstance(error, WayloomError) else f"{type(error).__name__}: {error}"
    text, pause_s = _without_folders(context, text), backoff.pause_s(held.attempt)
    _put_back(lambda session: jobs.fail(session, held, text, final=final, pause_s=pause_s), context)


def _without_folders(context: WorkerContext, text: str) -> str:
    """The message with files named as in the log, and without this machine's paths: those say nothing to whoever sent the drive."""
    return LOG_OF_DRIVE.sub("", text.replace(f"{context.folders.root}/", ""))
