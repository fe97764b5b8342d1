"""Catalogue of the pipeline's stages: name, queue, inputs, parts of the log, settings and room of each, in the order they run.

Everything that must know the stages reads them here: `wayloom process`, the workers, the job rows, the reports, the dashboard.
The table names rooms and settings by text, so that whoever wants a queue's name loads no kernel.

To add a stage of a drive, write its room, a module with

    run(context: StageContext, out_dir: Path, progress: Progress) -> None

and one entry in STAGES behind the stages whose results it reads; after the last one the drive goes into the map. A room may
have `key_parts(context) -> dict`: what its settings mean by content (a network's hash, a rig file's lens). The stage then runs
embedded and in the workers, its folder is `stages/<name>`, and its key holds its inputs' digests, the parts of the log, its
settings, and the code and libraries that its room imports. What the service does besides (blobs to share, rows to write) is a hook
in the workers; a stage without a hook needs none.
"""

from dataclasses import dataclass
from typing import Final

from wayloom.errors import StageError


@dataclass(frozen=True, slots=True)
class Stage:
    """One entry.

    name       of the stage, its folder and its job rows
    queue      in which its jobs wait
    inputs     the stages whose results it reads, all earlier in the catalogue
    log_parts  what it reads of the log: names of `wayloom.pipeline.log_parts.LOG_PARTS`, or `drive`, the id by which maps name it
    settings   the parts of ProcessSettings that its result depends on, as dotted names
    room       the module that runs it; None for a stage of the map, which only workers run
    """

    name: str
    queue: str
    inputs: tuple[str, ...] = ()
    log_parts: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    room: str | None = None

    @property
    def results_read(self) -> tuple[str, ...]:
        """The stages whose folders it is given: its inputs, and the ingest's digests where it reads the log."""
        return tuple(dict.fromkeys((*((INGEST,) if self.log_parts else ()), *self.inputs)))


INGEST: Final = "ingest"
ODOMETRY: Final = "odometry"
_ROOMS: Final = "wayloom.pipeline.stages"
STAGES: tuple[Stage, ...] = (
    Stage(INGEST, "ingest", room=f"{_ROOMS}.ingest"),
    Stage(ODOMETRY, "odometry", log_parts=("images", "imu", "name"), settings=("odometry",), room=f"{_ROOMS}.odometry"),
    Stage(
        "segmentation", "segmentation", inputs=("odometry",), log_parts=("images", "name"),
        settings=("labelling.between_keyframes", "labelling.right_images"), room=f"{_ROOMS}.segmentation",
    ),
    Stage("labelling", "odometry", inputs=("odometry", "segmentation"), settings=("labelling",), room=f"{_ROOMS}.labelling"),
    Stage(
        "places", "odometry", inputs=("odometry", "segmentation", "labelling"), log_parts=("images",), settings=("places",),
        room=f"{_ROOMS}.places",
    ),
    Stage(
        "looks", "odometry", inputs=("odometry", "segmentation"), log_parts=("images",), settings=("looks",),
        room=f"{_ROOMS}.looks",
    ),
    Stage("loops", "odometry", inputs=("places",), settings=("loops",), room=f"{_ROOMS}.loops"),
    Stage(
        "georeference", "odometry", inputs=("odometry", "labelling", "loops"), log_parts=("gnss", "imu"),
        settings=("georeference", "map_origin", "submaps.length_m", "submaps.max_length_m", "submaps.broken_step_m"),
        room=f"{_ROOMS}.georeference",
    ),
    Stage(
        "submaps", "odometry", inputs=("odometry", "labelling", "georeference"), log_parts=("drive",), settings=("submaps",),
        room=f"{_ROOMS}.submaps",
    ),
    Stage(
        "ground", "odometry", inputs=("odometry", "segmentation", "submaps"), log_parts=("images",), settings=("ground",),
        room=f"{_ROOMS}.ground",
    ),
    Stage(
        "objects", "odometry", inputs=("odometry", "segmentation", "submaps", "ground"), log_parts=("images",),
        settings=("objects",), room=f"{_ROOMS}.objects",
    ),
)  # fmt: skip
"""The stages of a drive."""
MAP_STAGES: Final = (Stage("stitch", "stitch"), Stage("publish", "publish", inputs=("stitch",)))
"""The stages of a map, run by the workers when drives were added or removed."""
REMOVAL: Final = Stage("remove", "maintenance")
"""The removal of a drive: a job, and no part of its way into the map."""


def drive_stages() -> tuple[str, ...]:
    """Names of a drive's stages, in order."""
    return tuple(stage.name for stage in STAGES)


def map_stages() -> tuple[str, ...]:
    """Names of a map's stages, in order."""
    return tuple(stage.name for stage in MAP_STAGES)


def find_stage(name: str) -> Stage:
    """The entry of this name. Raises StageError that lists the known ones."""
    known = {stage.name: stage for stage in (*STAGES, *MAP_STAGES, REMOVAL)}
    if name not in known:
        raise StageError(f"unknown stage {name!r}; known are {', '.join(known)}")
    return known[name]


def origins_of(name: str) -> tuple[str, ...]:
    """The stage, and before it those that its result comes of, in the catalogue's order. Raises StageError."""
    found, coming = set[str](), [name]
    while coming:
        stage = find_stage(coming.pop())
        coming += {*stage.results_read} - found
        found.add(stage.name)
    return tuple(stage.name for stage in (*STAGES, *MAP_STAGES) if stage.name in found)


def queues() -> tuple[str, ...]:
    """Names of all queues, each once, in the order in which a drive meets them."""
    return tuple(dict.fromkeys(stage.queue for stage in (*STAGES, *MAP_STAGES, REMOVAL)))
