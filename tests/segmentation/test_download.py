"""Networks that are fetched: checked, converted where need be, and never half there."""

import hashlib
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest
from made_network import THREE, logits_network

from wayloom.errors import ModelError
from wayloom.segmentation.catalogue import MODELS, locate
from wayloom.segmentation.description import ModelDescription, read_description
from wayloom.segmentation.download import fetch
from wayloom.segmentation.network import Network


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        return None


@pytest.fixture
def shop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Path, str]]:
    """A folder and the URL under which a server gives its files."""
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    folder = tmp_path / "shop"
    folder.mkdir()
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder))) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield folder, f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def test_a_network_is_fetched_into_the_folder_and_found_there(
    shop: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = logits_network()
    (shop[0] / "net.onnx").write_bytes(data)
    toml = tmp_path / "far.toml"
    toml.write_text(f'{THREE}file = "sub/far.onnx"\nurl = "{shop[1]}/net.onnx"\nsha256 = "{hashlib.sha256(data).hexdigest()}"\n')
    description = read_description(toml).model_copy(update={"folder": None})
    told: list[float] = []
    path = fetch(description, tmp_path / "models", lambda share, what: told.append(share))
    assert path == tmp_path / "models" / "sub" / "far.onnx"
    assert path.read_bytes() == data
    assert told[-1] == 1.0
    monkeypatch.setenv("WAYLOOM_MODELS", str(tmp_path / "models"))
    assert locate(description)[0] == path


@pytest.mark.models
def test_published_weights_are_converted_to_the_file_of_the_catalogue(
    shop: tuple[Path, str], tmp_path: Path, models_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    weights = models_dir / "efficientvit-b0-cityscapes" / "efficientvit_seg_b0_cityscapes.pt"
    (shop[0] / "b0.pt").write_bytes(weights.read_bytes())
    description = MODELS["efficientvit-b0"].model_copy(update={"url": f"{shop[1]}/b0.pt"})
    path = fetch(description, tmp_path / "models")
    assert hashlib.sha256(path.read_bytes()).hexdigest() == description.sha256
    monkeypatch.setenv("WAYLOOM_MODELS", str(tmp_path / "models"))
    assert Network(MODELS["efficientvit-b0"]).gives_scores


@pytest.mark.parametrize(("name", "fault"), [("other.onnx", "SHA-256"), ("none.onnx", "404")])
def test_what_does_not_come_as_described_leaves_nothing(name: str, fault: str, shop: tuple[Path, str], tmp_path: Path) -> None:
    (shop[0] / "other.onnx").write_bytes(b"another")
    description = ModelDescription(name="far", file="far.onnx", url=f"{shop[1]}/{name}", sha256="0" * 64)
    with pytest.raises(ModelError, match=fault):
        fetch(description, tmp_path / "models")
    assert list((tmp_path / "models").iterdir()) == []


def test_a_place_that_does_not_answer_is_told_in_one_line(tmp_path: Path) -> None:
    description = ModelDescription(name="far", file="far.onnx", url="http://127.0.0.1:9/net.onnx", sha256="0" * 64)
    with pytest.raises(ModelError, match="cannot be fetched") as caught:
        fetch(description, tmp_path)
    assert "\n" not in str(caught.value)


def test_nothing_is_fetched_unchecked_and_a_network_may_name_no_place(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="unchecked"):
        ModelDescription(name="far", file="far.onnx", url="https://example.org/net.onnx")
    with pytest.raises(ValueError, match="url"):
        ModelDescription(name="far", file="far.onnx", url="file:///etc/passwd", sha256="0" * 64)
    with pytest.raises(ModelError, match="names no place"):
        fetch(MODELS["deeplab-slim"], tmp_path)
