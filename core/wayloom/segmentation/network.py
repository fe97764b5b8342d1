"""Inference of one network on images by ONNX Runtime, imported here and in `providers` alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import onnxruntime
from numpy.typing import NDArray

from wayloom.config.classes import VOID
from wayloom.errors import ModelError
from wayloom.segmentation.catalogue import locate
from wayloom.segmentation.description import ModelDescription
from wayloom.segmentation.kernels.network_input import scaled_grey, scaled_pixels, scaled_planes
from wayloom.segmentation.kernels.upsampling import upsampled_argmax
from wayloom.segmentation.onnx_file import check_onnx
from wayloom.segmentation.providers import providers_of, resolved_device
from wayloom.segmentation.scores import BEST, Scores, scores_from_logits
from wayloom.segmentation.tiling import tiles_along

Image = NDArray[np.uint8]
Labels = NDArray[np.uint8]

_FIT: Final = "correct `layout`, `size`, `multiple` or `tile_px` of its description"


@dataclass(frozen=True, slots=True)
class Labelled:
    """Segmentation of one image: labels (h, w) uint8 train ids, 255 = void; scores, None from a network without any."""

    labels: Labels
    scores: Scores | None


class Network:
    """A loaded network. Same image, same labels, whatever the number of threads (on one kind of device).

    description  what it is; sha256 of its file; `colour` in the description says whether grey images are beneath it
    device       on what it runs
    """

    def __init__(self, description: ModelDescription, threads: int = 1, device: str = "auto") -> None:
        """Check the file (SHA-256, format, no outside data), load it and try it on a blank image.

        device : "auto", "cpu", "cuda", "tensorrt", "openvino" or "coreml"
        Raises ModelError.
        """
        self.description = description
        self.device = resolved_device(device)
        self.path, self.sha256 = locate(description)
        self._session = _load(self.path, threads, self.device)
        _check_input(description, self._session, self.path)
        self._input: str = self._session.get_inputs()[0].name
        self._takes_several = not isinstance(self._session.get_inputs()[0].shape[0], int)
        self._train_ids = np.array(description.classes, np.uint8)
        self._train_id_table = np.full(256, VOID, np.uint8)
        self._train_id_table[: len(self._train_ids)] = self._train_ids
        self._levels = _levels(description)
        self._try_out()

    @property
    def gives_scores(self) -> bool:
        """Whether it gives logits of whole frames, and not an arg max or squares alone."""
        return self.description.output == "logits" and self.description.size == "dynamic"

    def labels(self, image: Image) -> Labels:
        """Train ids of every pixel, 255 = void.

        image    (h, w) grey or (h, w, 3) RGB uint8
        returns  (h, w) uint8
        """
        return self._labels_of_tiles(_as_rgb(image)) if self.description.size == "tiles" else self._labels_of_frame(image)

    def logits(self, image: Image) -> NDArray[np.float32]:
        """(gh, gw, C) logits of the network's own classes on its grid, which covers the image padded to the network's multiple.

        image    (h, w) grey or (h, w, 3) RGB uint8
        Raises ModelError for a network that gives an arg max only.
        """
        if not self.gives_scores:
            raise ModelError(f"network {self.description.name} gives an arg max only", remedy="use a network with logits")
        return self._logits(image)

    def scores(self, image: Image, k: int = BEST) -> Scores:
        """The k likeliest of our 19 classes for each cell of the network's grid (softmax).

        image    (h, w) grey or (h, w, 3) RGB uint8
        Raises ModelError for a network that gives an arg max only.
        """
        return self._scores(self.logits(image), image, k)

    def label_images(self, images: Sequence[Image], k: int = BEST) -> list[Labelled]:
        """Labels of each image, and their scores where the network gives any.

        Devices beside the CPU get all in one run, where the network takes several images; a CPU's caches hold one better.
        images : each (h, w) grey or (h, w, 3) RGB uint8, of one size
        """
        if not self.gives_scores:
            return [Labelled(self.labels(image), None) for image in images]
        padded = [self._prepared(image) for image in images]
        if self._takes_several and self.device != "cpu":
            grids = list(self._run(*padded)[0])
        else:
            grids = [self._run(image)[0][0] for image in padded]
        done = []
        for image, grid in zip(images, grids, strict=True):
            logits = self._channels_last(grid)
            done.append(Labelled(self._labels_of_logits(logits, image), self._scores(logits, image, k)))
        return done

    def give_back(self) -> None:
        """Free what it keeps for the next images on a CPU, 100 MB and more after those of two threads; they may still come."""
        if self.device != "cpu":
            return
        options = onnxruntime.RunOptions()
        options.add_run_config_entry("memory.enable_memory_arena_shrinkage", "cpu:0")
        self._session.run(None, {self._input: self._batch([self._blank()])}, options)

    def _labels_of_frame(self, image: Image) -> Labels:
        """The whole frame, padded by its own border to the network's multiple, at once."""
        height, width = image.shape[:2]
        if self.description.output == "ids":
            labels = _in_train_ids(self._train_ids, _as_plane(self._run(self._prepared(image))[0]))
            if self.description.zoom != 1:
                return np.asarray(cv2.resize(labels, (width, height), interpolation=cv2.INTER_NEAREST_EXACT), np.uint8)
            return labels[:height, :width]
        return self._labels_of_logits(self._logits(image), image)

    def _labels_of_tiles(self, rgb: Image) -> Labels:
        """Near-square tiles, each resized to the network's square and its labels back, joined in the middle of their overlap."""
        height, width = rgb.shape[:2]
        side = self.description.tile_px
        labels = np.full((height, width), VOID, np.uint8)
        for row in tiles_along(height, width):
            for column in tiles_along(width, height):
                tile = rgb[row.start : row.stop, column.start : column.stop]
                squeezed = cv2.resize(tile, (side, side), interpolation=cv2.INTER_LINEAR)
                square = self._square_labels(np.asarray(squeezed, np.uint8))
                size = (column.stop - column.start, row.stop - row.start)
                full = cv2.resize(square, size, interpolation=cv2.INTER_NEAREST_EXACT)
                labels[row.keep_start : row.keep_stop, column.keep_start : column.keep_stop] = full[
                    row.keep_start - row.start : row.keep_stop - row.start,
                    column.keep_start - column.start : column.keep_stop - column.start,
                ]
        return labels

    def _square_labels(self, square: Image) -> Labels:
        output = self._run(square)[0]
        if self.description.output == "ids":
            return _in_train_ids(self._train_ids, _as_plane(output))
        side = self.description.tile_px
        return self._upsampled(self._channels_last(output[0]), (side, side), (side, side))

    def _labels_of_logits(self, logits: NDArray[np.float32], image: Image) -> Labels:
        return self._upsampled(logits, self._covered(image), (image.shape[0], image.shape[1]))

    def _upsampled(self, logits: NDArray[np.float32], covered: tuple[int, int], size: tuple[int, int]) -> Labels:
        """Train ids of the likeliest classes; by OpenCV's look-up, which takes a tenth of numpy's time."""
        return np.asarray(cv2.LUT(upsampled_argmax(logits, *covered, *size), self._train_id_table), np.uint8)

    def _scores(self, logits: NDArray[np.float32], image: Image, k: int) -> Scores:
        return scores_from_logits(logits, self._train_ids, self._covered(image), k)

    def _prepared(self, image: Image) -> Image:
        """The frame as the network sees it, grey or RGB as it is: padded to its multiple, or resized to one."""
        d = self.description
        if d.zoom == 1:
            return _padded(image, d.multiple)
        height, width = (max(1, round(n * d.zoom / d.multiple)) * d.multiple for n in image.shape[:2])
        return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR), np.uint8)

    def _covered(self, image: Image) -> tuple[int, int]:
        """Height and width, in pixels of the image, of what the network sees."""
        height, width = image.shape[:2]
        if self.description.zoom != 1:
            return height, width
        multiple = self.description.multiple
        return -(-height // multiple) * multiple, -(-width // multiple) * multiple

    def _logits(self, image: Image) -> NDArray[np.float32]:
        """(gh, gw, C) logits of the frame as it is prepared."""
        return self._channels_last(self._run(self._prepared(image))[0][0])

    def _channels_last(self, grid: NDArray[Any]) -> NDArray[np.float32]:
        return np.ascontiguousarray(grid if self.description.layout == "NHWC" else grid.transpose(1, 2, 0), np.float32)

    def _run(self, *images: Image) -> list[NDArray[Any]]:
        """The network's outputs for images of one size, which are stacked."""
        try:
            outputs: list[NDArray[Any]] = self._session.run(None, {self._input: self._batch(images)})
        except Exception as error:  # onnxruntime's errors have no other base
            size = f"{images[0].shape[1]}x{images[0].shape[0]}"
            raise ModelError(f"does not run on {size} pixels ({_one_line(error)})", file=self.path, remedy=_FIT) from error
        return outputs

    def _batch(self, images: Sequence[Image]) -> NDArray[Any]:
        """(n, 3, h, w) or (n, h, w, 3): the input for grey or RGB images of one size, as the description scales it."""
        planes = self.description.layout == "NCHW"
        if self.description.dtype == "uint8":
            stacked = np.stack([_as_rgb(image) for image in images])
            return np.ascontiguousarray(stacked.transpose(0, 3, 1, 2)) if planes else stacked
        height, width = images[0].shape[:2]
        batch = np.empty((len(images), 3, height, width) if planes else (len(images), height, width, 3), np.float32)
        for image, filled in zip(images, batch, strict=True):
            if not planes:
                scaled_pixels(_as_rgb(image), self._levels, filled)
            elif image.ndim == 2:
                scaled_grey(image, self._levels, filled)
            else:
                scaled_planes(image, self._levels, filled)
        return batch

    def _try_out(self) -> None:
        """Run a blank image through, so that a network that does not fit its description is refused before any work."""
        blank = self._blank()
        _check_output(self.description, self._run(blank)[0], len(blank), self.path)

    def _blank(self) -> Image:
        """The smallest image that it takes."""
        d = self.description
        side = d.tile_px if d.size == "tiles" else -(-64 // d.multiple) * d.multiple
        return np.zeros((side, side, 3), np.uint8)


def _load(path: Path, threads: int, device: str) -> Any:
    data = path.read_bytes()
    check_onnx(data, str(path))
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    options.log_severity_level = 4
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        session = onnxruntime.InferenceSession(data, options, providers=providers_of(device))
    except Exception as error:  # onnxruntime's errors have no other base
        raise ModelError(f"onnxruntime cannot load it ({_one_line(error)})", file=path, remedy="export it again") from error
    if session.get_providers()[0] != providers_of(device)[0]:  # it fell back without a word
        raise ModelError(
            f"onnxruntime cannot use {device} here", file=path, remedy="check the device's drivers, or choose the device cpu"
        )
    return session


def _levels(d: ModelDescription) -> NDArray[np.float32]:
    """(3, 256): (byte * scale - mean) / std of each channel."""
    scaled = np.arange(256).astype(np.float32) * np.float32(d.scale)
    return np.asarray((scaled - np.array(d.mean, np.float32)[:, None]) / np.array(d.std, np.float32)[:, None], np.float32)


def _check_input(d: ModelDescription, session: Any, path: Path) -> None:
    inputs = session.get_inputs()
    if len(inputs) != 1:
        raise ModelError(f"has {len(inputs)} inputs, not one image", file=path, remedy="export the network with the image as input")
    shape, kind = inputs[0].shape, inputs[0].type
    expected = {"float32": "tensor(float)", "uint8": "tensor(uint8)"}[d.dtype]
    if kind != expected:
        raise ModelError(f"its input is {kind}, its description says {d.dtype}", file=path, remedy="correct `dtype`")
    channels = shape[1 if d.layout == "NCHW" else 3] if len(shape) == 4 else None
    if len(shape) != 4 or (isinstance(channels, int) and channels != 3):
        raise ModelError(f"its input has shape {shape}, not one RGB image in {d.layout}", file=path, remedy="correct `layout`")


def _check_output(d: ModelDescription, output: NDArray[Any], side: int, path: Path) -> None:
    shape = output.shape
    if d.output == "ids":
        if not np.issubdtype(output.dtype, np.integer) or _as_plane(output).shape != (side, side):
            raise ModelError(
                f"its output is {output.dtype} {list(shape)}, not one class id for each pixel", file=path, remedy="correct `output`"
            )
        return
    if output.ndim != 4 or not np.issubdtype(output.dtype, np.floating):
        raise ModelError(f"its output is {output.dtype} {list(shape)}, not logits", file=path, remedy="correct `output`")
    count = shape[1 if d.layout == "NCHW" else 3]
    if count != len(d.classes):
        raise ModelError(f"gives {count} classes, its description names {len(d.classes)}", file=path, remedy="correct `classes`")


def _as_plane(ids: NDArray[Any]) -> NDArray[Any]:
    """(h, w) of the ids, whose axes of length 1 are dropped."""
    return ids.reshape([n for n in ids.shape if n != 1] or [1])


def _in_train_ids(train_ids: NDArray[np.uint8], ids: NDArray[Any]) -> Labels:
    """Ids of the network to train ids; an id that its description does not name is void."""
    known = (ids >= 0) & (ids < len(train_ids))
    labels: Labels = np.where(known, train_ids[np.where(known, ids, 0)], np.uint8(VOID))
    return labels


def _as_rgb(image: Image) -> Image:
    return np.repeat(image[:, :, None], 3, axis=2) if image.ndim == 2 else image


def _padded(image: Image, multiple: int) -> Image:
    """Height and width rounded up to the multiple; the border's pixels are repeated at the bottom and the right."""
    below, right = -image.shape[0] % multiple, -image.shape[1] % multiple
    return np.asarray(cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE), np.uint8) if below or right else image


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
