"""Trains `wayloom-city`, the small network in the package, on simulated streets, and exports it to ONNX.

    python -m venv TRAIN && TRAIN/bin/pip install '.[train]'
    TRAIN/bin/python benchmarks/train_network.py --out OUT

PyTorch is needed here and nowhere else. The streets of --seeds are trained on, those of --held-out are only judged; neither is a
seed of a preset of `wayloom simulate`. Training goes for --minutes; with --steps instead a run
depends on its seed alone, and not on how fast the machine is. OUT gets `wayloom-city.onnx`, its TOML, `scores.json`, and the state
from which `--start` goes on.
"""

import argparse
import hashlib
import json
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from itertools import repeat
from pathlib import Path
from queue import Queue
from threading import Thread

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from city_network import MULTIPLE, CityNetwork, export_onnx, twice
from city_views import CLASSES, VOID, Views, batches, class_weights, rendered
from wayloom.config.classes import CLASS_NAMES

CROP = (192, 448)
BATCH = 4
RATE = 3e-3
WARM_UP = 0.04
MEAN = (0.485, 0.456, 0.406)
STD = (0.229, 0.224, 0.225)
Batch = tuple[NDArray[np.uint8], NDArray[np.uint8]]


def main() -> None:
    """Render, train, judge, export."""
    options = _options()
    torch.manual_seed(options.seed)
    torch.set_num_threads(options.threads)
    train = all_views(options.seeds, options.full_seeds, options)
    print(f"{len(train)} views to train on", flush=True)
    network = trained(begun(options.start), train, options.minutes, options.steps, options.seed, options.bf16)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "wayloom-city.onnx"
    torch.save(network.state_dict(), options.out / "wayloom-city.state")
    export_onnx(network, str(path))
    held_out = {"half": all_views(options.held_out, [], options), "full": all_views([], options.held_out[:1], options)}
    scores = {size: judged(network, views) for size, views in held_out.items()}
    for size, score in scores.items():
        print_scores(size, score)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    print(f"{path}: {path.stat().st_size} bytes, sha256 {digest}")
    (options.out / "scores.json").write_text(json.dumps(scores, indent=1) + "\n")
    (options.out / "wayloom-city.toml").write_text(description(digest))


def all_views(half_seeds: list[int], full_seeds: list[int], options: argparse.Namespace) -> Views:
    """The views of some cities in half size and of others in full; each city is rendered once, several at a time."""
    sizes = ["half"] * len(half_seeds) + ["full"] * len(full_seeds)
    with ProcessPoolExecutor(options.processes) as pool:
        parts = list(pool.map(rendered, half_seeds + full_seeds, repeat(options.views), sizes, repeat(options.cache)))
    return Views([image for p in parts for image in p.images], [classes for p in parts for classes in p.classes])


def begun(start: Path | None) -> CityNetwork:
    """A new network, or the one that an earlier run left."""
    network = CityNetwork()
    if start:
        network.load_state_dict(torch.load(start, weights_only=True))
    return network.to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]


def trained(network: CityNetwork, views: Views, minutes: float, steps: int | None, seed: int, bf16: bool) -> CityNetwork:
    """AdamW with a one-cycle rate; what is returned is the running mean of the weights, which is steadier than the last ones."""
    mean = deepcopy(network).eval()
    weights = torch.from_numpy(class_weights(views.classes))
    optimiser = torch.optim.AdamW(network.parameters(), lr=RATE, weight_decay=0.02)
    source = ahead(batches(views, BATCH, CROP, seed))
    started, step, done = time.monotonic(), 0, 0.0
    while done < 1.0:
        for group in optimiser.param_groups:
            group["lr"] = RATE * share_of_rate(done)
        loss = train_step(network, optimiser, next(source), weights, step % 4, bf16)
        step += 1
        follow(mean, network, min(0.995, 1 - 10 / (step + 10)))
        elapsed = time.monotonic() - started
        done = step / steps if steps else elapsed / (60 * minutes)
        if step % 100 == 0:
            print(f"step {step}, {100 * done:.0f} %: loss {loss:.3f}, {elapsed:.0f} s", flush=True)
    print(f"{step} steps of {BATCH} crops in {elapsed:.0f} s", flush=True)
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


def share_of_rate(done: float) -> float:
    """Linear warm-up, then half a cosine down to nothing."""
    if done < WARM_UP:
        return done / WARM_UP
    return 0.5 * (1 + float(np.cos(np.pi * (done - WARM_UP) / (1 - WARM_UP))))


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
def judged(network: CityNetwork, views: Views) -> dict[str, float | dict[str, float]]:
    """Mean IoU and accuracy in percent over the classes present, and IoU of each, over every pixel of whole views."""
    confusion = np.zeros((CLASSES, CLASSES), np.int64)
    for image, truth in zip(views.images, views.classes, strict=True):
        found = labels_of(network, image)
        known = truth != VOID
        confusion += np.bincount(truth[known].astype(int) * CLASSES + found[known], minlength=CLASSES**2).reshape(CLASSES, CLASSES)
    hits, truths, founds = np.diag(confusion), confusion.sum(1), confusion.sum(0)
    iou = {CLASS_NAMES[c]: float(100 * hits[c] / (truths[c] + founds[c] - hits[c])) for c in range(CLASSES) if truths[c]}
    return {"miou": float(np.mean(list(iou.values()))), "oa": float(100 * hits.sum() / confusion.sum()), "iou": iou}


def labels_of(network: CityNetwork, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(h, w) train ids of one (h, w, 3) image, padded to the network's multiple as the product does."""
    height, width = image.shape[:2]
    padded = np.pad(image, ((0, -height % MULTIPLE), (0, -width % MULTIPLE), (0, 0)), mode="edge")
    logits = twice(twice(network(as_input(padded[None]))))
    return logits[0, :, :height, :width].argmax(0).to(torch.uint8).numpy()


def print_scores(size: str, score: dict[str, float | dict[str, float]]) -> None:
    """One line for the means, one for the classes."""
    print(f"held-out streets, {size} size: mIoU {score['miou']:.1f} %, accuracy {score['oa']:.1f} %")
    ious = score["iou"]
    assert isinstance(ious, dict)
    print("  " + ", ".join(f"{name} {value:.1f}" for name, value in ious.items()), flush=True)


def description(digest: str) -> str:
    """The TOML that goes beside the network."""
    return f'''name = "wayloom-city"
title = "small network trained on the simulated city; colour or grey"
file = "wayloom-city.onnx"
sha256 = "{digest}"
licence = "Apache-2.0"
source = "in the package; made by benchmarks/train_network.py from simulated images alone"
layout = "NCHW"
dtype = "float32"
mean = {list(MEAN)}
std = {list(STD)}
size = "dynamic"
multiple = {MULTIPLE}
output = "logits"
colour = false
simulated = true
'''


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--cache", type=Path, default=Path("/tmp/wayloom-views"), help="folder of the rendered views")
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(1001, 1009)), help="cities to train on, half size")
    parser.add_argument("--full-seeds", type=int, nargs="*", default=[1021, 1022, 1023], help="cities to train on, full size")
    parser.add_argument("--held-out", type=int, nargs="+", default=[1901, 1902], help="cities to judge by")
    parser.add_argument("--views", type=int, default=40, help="of each city")
    parser.add_argument("--minutes", type=float, default=25.0)
    parser.add_argument("--steps", type=int, help="instead of --minutes")
    parser.add_argument("--start", type=Path, help="the state file of an earlier run, to go on from")
    parser.add_argument("--threads", type=int, default=1, help="of the training")
    parser.add_argument("--processes", type=int, default=2, help="of the rendering")
    parser.add_argument(
        "--bf16", action="store_true", help="bfloat16 inside the network: a third faster where the processor has it"
    )
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


if __name__ == "__main__":
    main()
