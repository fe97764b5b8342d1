"""Networks are found by name or by file, and refused in one line before any work."""

import hashlib
from pathlib import Path

import pytest
from made_network import THREE, logits_network, put

from wayloom.errors import ModelError
from wayloom.segmentation.catalogue import DEFAULT_MODEL, MODELS, find_model, inspect_file, locate
from wayloom.segmentation.description import ModelDescription


def test_the_catalogue_has_a_licence_a_source_and_a_checksum_for_every_network() -> None:
    for name, description in MODELS.items():
        assert description.name == name
        assert description.licence not in ("", "unknown")
        assert description.source
        assert description.sha256


def test_the_default_network_is_in_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WAYLOOM_MODELS", raising=False)
    found = inspect_file(MODELS[DEFAULT_MODEL])
    assert found.state == "ready"
    assert found.path is not None
    assert found.path.stat().st_size <= 4 * 1024 * 1024


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(ModelError, match="deeplab-slim"):
        find_model("no-such-network")


def test_a_network_of_ones_own_is_found_by_its_toml_or_its_onnx_file(tmp_path: Path) -> None:
    toml = put(tmp_path, "mine", logits_network(), THREE)
    by_toml, by_onnx = find_model(str(toml)), find_model(str(tmp_path / "mine.onnx"))
    assert by_toml == by_onnx
    assert by_toml.name == "mine"
    assert by_toml.classes == (13, 8, 10)
    assert locate(by_toml)[0] == tmp_path / "mine.onnx"


def test_a_bare_onnx_file_asks_for_its_description(tmp_path: Path) -> None:
    (tmp_path / "mine.onnx").write_bytes(logits_network())
    with pytest.raises(ModelError, match=r"mine\.toml"):
        find_model(str(tmp_path / "mine.onnx"))


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("classes = [0, 19]", "train ids"),
        ("classes = [0, 300]", "classes"),
        ("surprise = 1", "surprise"),
        ("layout = 'NWHC'", "layout"),
        ("std = [0, 1, 1]", "std"),
        ("file = 'weights.pt'", "onnx"),
        ("name = 'a b'", "name"),
        ("sha256 = 'abc'", "sha256"),
        ("this is no toml", "TOML"),
    ],
)
def test_a_description_that_cannot_be_is_refused_in_one_line(text: str, fault: str, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(ModelError, match=fault) as caught:
        find_model(str(tmp_path / "mine.toml"))
    assert "\n" not in str(caught.value)
    assert "mine.toml" in str(caught.value)


def test_a_missing_description_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="no such file"):
        find_model(str(tmp_path / "none.toml"))


def test_a_file_is_looked_for_in_the_folders_of_wayloom_models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    description = ModelDescription(name="far", file="sub/far.onnx")
    monkeypatch.setenv("WAYLOOM_MODELS", f"{tmp_path / 'none'}:{tmp_path}")
    assert inspect_file(description).state == "absent"
    with pytest.raises(ModelError, match="WAYLOOM_MODELS"):
        locate(description)
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "far.onnx").write_bytes(b"x")
    assert locate(description) == (tmp_path / "sub" / "far.onnx", hashlib.sha256(b"x").hexdigest())


def test_a_file_with_another_checksum_is_refused(tmp_path: Path) -> None:
    toml = put(tmp_path, "mine", logits_network(), THREE + f'sha256 = "{"0" * 64}"\n')
    assert inspect_file(find_model(toml)).state == "damaged"
    with pytest.raises(ModelError, match="SHA-256"):
        locate(find_model(toml))
