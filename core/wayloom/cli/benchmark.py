"""`wayloom benchmark`: the tables by which the work is judged."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from wayloom.cli.progress_bars import ProgressBars
from wayloom.cli.results import JsonOption, print_json, words

group = typer.Typer(add_completion=False, no_args_is_help=True, help="Measure on data with truth: one command for each table.")


class Source(StrEnum):
    """Where the labels of a dataset come from."""

    auto = "auto"
    kitti_360 = "kitti-360"
    scanned = "scanned"
    drawn = "drawn"


@group.callback()
def benchmark_command() -> None:
    """Measure on data with truth."""


@group.command()
def labels(
    dataset: Annotated[
        Path, typer.Argument(help="KITTI-360's root or one of its sequences, or a folder of `wayloom simulate … --truth`.")
    ],
    model: Annotated[
        str | None, typer.Option(envvar="WAYLOOM_MODEL", help="Network: a name of `wayloom models`, or a TOML or ONNX file.")
    ] = None,
    csv: Annotated[Path | None, typer.Option(help="Write the tables to this file.", metavar="FILE")] = None,
    latex: Annotated[Path | None, typer.Option(help="Write the tables to this file.", metavar="FILE")] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Draw truth, single image and vote of a few keyframes (.png or .jpg).", metavar="FILE")
    ] = None,
    source: Annotated[
        Source,
        typer.Option(
            help="Truth: KITTI-360's labelled clouds; or of a simulated drive its scans, or depth and class of every pixel."
        ),
    ] = Source.auto,
    frames: Annotated[str | None, typer.Option(metavar="FIRST:STOP", help="Only these frames of each drive.")] = None,
    work: Annotated[Path | None, typer.Option(help="Keep tracks and label images here for the next run.", metavar="DIR")] = None,
    threads: Annotated[int | None, typer.Option(min=1, max=64, help="Threads; default all cores.")] = None,
    ablation: Annotated[bool, typer.Option("--ablation", help="A row for each switch of the labelling as well.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Accuracy of labelled points: single image, TCL mono, TCL stereo, our best form (the paper's table)."""
    from wayloom.cli.options import default_threads
    from wayloom.evaluation.label_ablation import ABLATION
    from wayloom.evaluation.label_pictures import write_figure
    from wayloom.evaluation.label_tables import as_csv, as_latex, as_text
    from wayloom.evaluation.label_truth import find_labelled_drives
    from wayloom.evaluation.labels import LabelBenchmarkSettings, LabelledPoints, benchmark_labels
    from wayloom.files.atomic import check_writable, write_atomically
    from wayloom.segmentation.catalogue import DEFAULT_MODEL, find_model
    from wayloom.segmentation.network import Network

    for file in filter(None, (csv, latex, picture)):
        check_writable(file)
    first, stop = parse_frames(frames)
    network = Network(find_model(model or DEFAULT_MODEL), threads or default_threads())
    drives = find_labelled_drives(dataset, source.value, first, stop)
    pictures: list[bytes] = []

    def show(done: LabelledPoints) -> None:
        drawn = write_figure(done, picture.name) if picture and not pictures else None
        pictures.extend([drawn] if drawn else [])

    with ProgressBars(quarters=True) as bars:
        result = benchmark_labels(
            drives, network, LabelBenchmarkSettings(variants=ABLATION if ablation else {}), work_dir=work,
            threads=threads or default_threads(), progress=bars("labels"), show=show,
        )  # fmt: skip
    words(as_json)(as_text(result))
    texts = {csv: lambda: as_csv(result), latex: lambda: as_latex(result)}
    for target, text in texts.items():
        if target:
            write_atomically(target, text().encode())
    if picture and pictures:
        write_atomically(picture, pictures[0])
    if as_json:
        print_json(result.as_json())


def parse_frames(text: str | None) -> tuple[int, int | None]:
    """FIRST:STOP, each of which may be left out. Raises ConfigError."""
    from wayloom.errors import ConfigError

    first, _, stop = (text or "").partition(":")
    try:
        bounds = int(first or 0), int(stop) if stop else None
    except ValueError:
        bounds = -1, None
    if bounds[0] < 0 or (bounds[1] is not None and bounds[1] <= bounds[0]):
        raise ConfigError(f"{text!r} are no frames", record="--frames", remedy="give FIRST:STOP, counted from 0")
    return bounds
