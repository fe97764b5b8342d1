"""Trains `wayloom-city`, the small network in the package, on simulated streets from nothing, and exports it to ONNX.

    python -m venv TRAIN && TRAIN/bin/pip install '.[train]'
    TRAIN/bin/python benchmarks/train_network.py --out OUT

PyTorch is needed here and nowhere else. The recipe (phases, cities, steps, seeds) stands in `training_recipe.py`. A run depends on
it alone and not on how fast the machine is (about an hour on two cores); one that was stopped goes on after its last whole phase.
OUT gets `wayloom-city.onnx`, its TOML, `scores.json` on the held-out cities, and the state after each phase.
--trial N makes N steps a phase on two views: whether everything works.
"""

import argparse
import hashlib
import json
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from itertools import repeat
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from city_network import CityNetwork, export_onnx, twice
from city_views import CLASSES, VOID, Views, batches, class_weights, rendered
from training_recipe import (
    BATCH,
    CROP,
    HELD_OUT,
    MEAN,
    MULTIPLE,
    PHASES,
    RATE,
    STD,
    Phase,
    confusion_of,
    description,
    note_done,
    phases_left,
    scores_of,
    share_of_rate,
    state_file,
    trial,
)

Batch = tuple[NDArray[np.uint8], NDArray[np.uint8]]


def main() -> None:
    """Render, train phase by phase, judge, export."""
    options = _options()
    torch.set_num_threads(options.threads)
    options.out.mkdir(parents=True, exist_ok=True)
    phases = trial(options.trial) if options.trial else PHASES
    network = made(phases, options)
    path = options.out / "wayloom-city.onnx"
    export_onnx(network, str(path))
    views = 2 if options.trial else phases[0].views
    held_out = {"half": all_views(HELD_OUT, (), views, options), "full": all_views((), HELD_OUT[:1], views, options)}
    scores = {size: judged(network, seen) for size, seen in held_out.items()}
    for size, score in scores.items():
        print_scores(size, score)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    print(f"{path}: {path.stat().st_size} bytes, sha256 {digest}")
    (options.out / "scores.json").write_text(json.dumps(scores, indent=1) + "\n")
    (options.out / "wayloom-city.toml").write_text(description(digest))


def made(phases: tuple[Phase, ...], options: argparse.Namespace) -> CityNetwork:
    """The network after all phases: a new one through each, or what an earlier run left through those that it did not finish."""
    left, state = phases_left(phases, options.out)
    torch.manual_seed(phases[0].seed)
    network = CityNetwork()
    if state is not None:
        print(f"going on from {state}", flush=True)
        network.load_state_dict(torch.load(state, weights_only=True))
    for phase in left:
        views = all_views(phase.half, phase.full, phase.views, options)
        print(f"phase {phase.name}: {len(views)} views, {phase.steps} steps", flush=True)
        network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        network = trained(network, views, phase, options.bf16)
        torch.save(network.state_dict(), state_file(phase, options.out))
        note_done(phase, options.out)
    return network


def all_views(half: Sequence[int], full: Sequence[int], count: int, options: argparse.Namespace) -> Views:
    """The views of some cities in half size and of others in full; each city is rendered once, several at a time."""
    sizes = ["half"] * len(half) + ["full"] * len(full)
    with ProcessPoolExecutor(options.processes) as pool:
        parts = list(pool.map(rendered, [*half, *full], repeat(count), sizes, repeat(options.cache)))
    return Views([image for p in parts for image in p.images], [classes for p in parts for classes in p.classes])


def trained(network: CityNetwork, views: Views, phase: Phase, bf16: bool) -> CityNetwork:
    """AdamW with a one-cycle rate; what is returned is the running mean of the weights, which is steadier than the last ones."""
    mean = deepcopy(network).eval()
    weights = torch.from_numpy(class_weights(views.classes))
    optimiser = torch.optim.AdamW(network.parameters(), lr=RATE, weight_decay=0.02)
    source = ahead(batches(views, min(BATCH, len(views)), CROP, phase.seed))
    started = time.monotonic()
    for step in range(phase.steps):
        for group in optimiser.param_groups:
            group["lr"] = RATE * share_of_rate(step / phase.steps)
        loss = train_step(network, optimiser, next(source), weights, step % 4, bf16)
        follow(mean, network, min(0.995, 1 - 10 / (step + 11)))
        if (step + 1) % 100 == 0 or step + 1 == phase.steps:
            elapsed = time.monotonic() - started
            print(f"step {step + 1} of {phase.steps}: loss {loss:.3f}, {elapsed:.0f} s", flush=True)
    return mean


def train_step(
    network: CityNetwork, optimiser: torch.optim.Optimizer, batch: Batch, weights: Tensor, parity: int, bf16: bool
) -> float:
    """One step on one batch; the loss is taken on every second row and column, whose offset (parity) goes round."""
    network.train()
    images = as_input(batch[0])
    classes = torch.from_numpy(batch[1][:, parity // 2 :: 2, parity % 2 :: 2].astype(np.int64))
    with torch.autocast("cpu", torch.bfloat16, enabled=bf16):
        logits = twice(network(images))
    loss = loss_of(logits.float(), classes, weights)
    optimiser.zero_grad(set_to_none=True)
    loss.backward()  # type: ignore[no-untyped-call]
    torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
    optimiser.step()
    return float(loss.detach())


def as_input(images: NDArray[np.uint8]) -> Tensor:
    """(n, h, w, 3) RGB uint8 to (n, 3, h, w) float32 as the network takes it, channels last in memory."""
    x = torch.from_numpy(images).permute(0, 3, 1, 2).to(torch.float32).div_(255)
    return x.sub_(torch.tensor(MEAN)[:, None, None]).div_(torch.tensor(STD)[:, None, None])


def loss_of(logits: Tensor, classes: Tensor, weights: Tensor) -> Tensor:
    """Cross entropy weighted by class, and half as much Dice over the classes in the batch, which looks at overlap as IoU does."""
    entropy = F.cross_entropy(logits, classes, weights, ignore_index=VOID, label_smoothing=0.02)
    known = classes != VOID
    truth = F.one_hot(torch.where(known, classes, 0), CLASSES).permute(0, 3, 1, 2) * known[:, None]
    shares = logits.softmax(1) * known[:, None]
    overlap = (shares * truth).sum((0, 2, 3))
    size = shares.sum((0, 2, 3)) + truth.sum((0, 2, 3))
    present = truth.sum((0, 2, 3)) > 0
    dice = 1 - (2 * overlap + 1) / (size + 1)
    return entropy + 0.5 * dice[present].mean()


@torch.no_grad()
def follow(mean: CityNetwork, network: CityNetwork, keep: float) -> None:
    """Move the running mean of weights and statistics towards the network."""
    for slow, fast in zip(mean.state_dict().values(), network.state_dict().values(), strict=True):
        if slow.dtype.is_floating_point:
            slow.lerp_(fast, 1 - keep)
        else:
            slow.copy_(fast)


def ahead(source: Iterator[Batch]) -> Iterator[Batch]:
    """The same batches, in the same order, prepared by a thread while the network works."""
    queue: Queue[Batch] = Queue(4)

    def fill() -> None:
        for batch in source:
            queue.put(batch)

    Thread(target=fill, daemon=True).start()
    while True:
        yield queue.get()


@torch.no_grad()
def judged(network: CityNetwork, views: Views) -> dict[str, Any]:
    """Mean IoU and accuracy in percent over the classes present, and IoU of each, over every pixel of whole views."""
    confusion = np.zeros((CLASSES, CLASSES), np.int64)
    for image, truth in zip(views.images, views.classes, strict=True):
        confusion += confusion_of(truth, labels_of(network, image))
    return scores_of(confusion)


def labels_of(network: CityNetwork, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(h, w) train ids of one (h, w, 3) image, padded to the network's multiple as the product does."""
    height, width = image.shape[:2]
    padded = np.pad(image, ((0, -height % MULTIPLE), (0, -width % MULTIPLE), (0, 0)), mode="edge")
    logits = twice(twice(network(as_input(padded[None]))))
    return logits[0, :, :height, :width].argmax(0).to(torch.uint8).numpy()


def print_scores(size: str, score: dict[str, Any]) -> None:
    """One line for the means, one for the classes."""
    print(f"held-out streets, {size} size: mIoU {score['miou']:.1f} %, accuracy {score['oa']:.1f} %")
    print("  " + ", ".join(f"{name} {value:.1f}" for name, value in score["iou"].items()), flush=True)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--cache", type=Path, default=Path("/tmp/wayloom-views"), help="folder of the rendered views")
    parser.add_argument("--trial", type=int, metavar="N", help="N steps a phase on two views: a try of the whole way")
    parser.add_argument("--threads", type=int, default=1, help="of the training")
    parser.add_argument("--processes", type=int, default=2, help="of the rendering")
    parser.add_argument(
        "--bf16",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="bfloat16 inside the network, as the shipped one was made",
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
