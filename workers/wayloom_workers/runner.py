"""Run of one job, from its claim to its commit."""

import os
import shutil
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import structlog

from wayloom.config.stages import REMOVAL
from wayloom.errors import ConflictError, InputError, LeaseLostError, StageError, WayloomError
from wayloom.store import drives, jobs, part_jobs
from wayloom.store.jobs import Claim, JobMessage
from wayloom.store.processes import identity
from wayloom_workers.completion import complete_drive
from wayloom_workers.heartbeat import Heartbeat, StopRequestedError
from wayloom_workers.stage_hooks import HookTable, PreparedStage, RepeatStageError, StageAttempt, StageHooks, WorkerContext

log = structlog.get_logger()


def run_job(context: WorkerContext, hooks: HookTable, notify: Callable[[Iterable[JobMessage]], None], job_id: int) -> bool:
    """Run the job if it is to be had. Whatever goes wrong in the stage ends up in the job's row. Returns whether it was claimed."""
    held = jobs.claim(context.database, job_id, identity(), context.settings.lease_s)
    if held is None:
        log.info("nothing to do", job_id=job_id)
        return False
    with structlog.contextvars.bound_contextvars(job_id=job_id, drive_id=held.drive_id, stage=held.stage, attempt=held.attempt):
        started = time.monotonic()
        try:
            notify(_run(context, hooks(held.stage), held))
            log.info("stage done", seconds=round(time.monotonic() - started, 3))
        except LeaseLostError as error:
            log.warning("lease lost", error=str(error))
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
    with Heartbeat(context, held) as beat:
        folder = _home(context, held) / "attempts" / f"{held.stage}-{held.job_id}-{held.token}"
        try:
            attempt = _attempt(context, held, folder, beat)
            prepared = hooks.prepare(attempt)
            if held.part:
                return _run_part(context, held, attempt, prepared)
            output = _output(context, held, held.stage, prepared.key)
            if output.is_dir():
                log.info("output is there already", key=prepared.key[:12])
            elif missing := prepared.parts.missing() if prepared.parts else []:
                log.info("waiting for parts", parts=len(missing))
                with context.database.write() as session:
                    return part_jobs.await_parts(session, held, missing, prepared.key, context.settings.max_attempts)
            else:
                prepared.run()
                beat.check()
                _keep(attempt.out_dir, output)
            done = replace(attempt, out_dir=output)
            hooks.share(done)
            with context.database.write() as session:
                following = jobs.finish(session, held, prepared.key)
                messages = [*hooks.record(session, done), *([following] if following else [])]
                if held.drive_id is not None and following is None and held.stage != REMOVAL.name:
                    messages += complete_drive(session, held.drive_id)
            if prepared.parts:
                shutil.rmtree(prepared.parts.folder, ignore_errors=True)
            return messages
        finally:
            shutil.rmtree(folder, ignore_errors=True)


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


def _keep(out_dir: Path, output: Path) -> None:
    """Turn the attempt into the output by one rename. If another attempt was faster, its output (the same bytes) stays."""
    output.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.rename(out_dir, output)
    except OSError:
        if not output.is_dir():
            raise


def _give_back(context: WorkerContext, held: Claim) -> None:
    try:
        with context.database.write() as session:
            jobs.release(session, held)
        log.info("job given back")
    except LeaseLostError as error:
        log.warning("lease lost", error=str(error))


def _write_failure(context: WorkerContext, held: Claim, error: Exception) -> None:
    """Bad input fails at once, anything else after the last attempt. A job to repeat waits for the sweeper: a short pause."""
    final = isinstance(error, InputError | StageError) or held.attempt >= context.settings.max_attempts
    text = str(error) if isinstance(error, WayloomError) else f"{type(error).__name__}: {error}"
    try:
        with context.database.write() as session:
            jobs.fail(session, held, _without_folders(context, text), final=final)
    except LeaseLostError as lost:
        log.warning("lease lost", error=str(lost))


def _without_folders(context: WorkerContext, text: str) -> str:
    """The message without this machine's paths, which say nothing to whoever sent the drive."""
    return text.replace(f"{context.folders.root}/", "")
