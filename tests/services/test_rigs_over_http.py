"""Rigs over HTTP: what is known, from which drives, and the file."""

import hashlib
from pathlib import Path

import httpx2
import pytest
from typer.testing import CliRunner

from service_kit.running import ApiAlone
from wayloom.cli.main import app
from wayloom.errors import NotFoundError
from wayloom.store import drives, rigs
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.rigs import ByGnss, Evidence, EvidenceEpoch, NewRigVersion

CONTENT = b"format_version = 2\n"
TOLD = {"information": [[4e5, 0.0, 0.0, 0.0], *[[0.0] * 4] * 3], "pull": [8e3, 0.0, 0.0, 0.0]}


@pytest.fixture(scope="module")
def known(api_process: ApiAlone) -> tuple[str, str]:
    """A rig with two epochs of one drive each: its id, and the id of the second drive."""
    digest = BlobStore(api_process.data / "blobs").put(CONTENT)
    database = Database(f"sqlite:///{api_process.data / 'wayloom.db'}")
    with database.write() as session:
        ids = []
        for name in ("before", "after"):
            manifest = Manifest(name=name, vehicle_id="taxi", files=(ManifestFile(path="log/0", size=1, sha256="0" * 64),))
            ids.append(drives.register(session, manifest, "city")[0].id)
        key = rigs.ensure(session, "taxi", "roof").id
        starts = (1_780_000_000, 1_780_086_400)
        new = [
            NewRigVersion(start * 10**9, "e" * 64, digest, (of,), "first drive", {}) for start, of in zip(starts, ids, strict=True)
        ]
        epochs = {
            ids[0]: EvidenceEpoch(starts[0] * 10**9, None, stray=False),
            ids[1]: EvidenceEpoch(starts[1] * 10**9, 99.5, stray=False),
        }
        added = [Evidence(of, "b" * 64, "c" * 64, start * 10**9) for start, of in zip(starts, ids, strict=True)]
        assert rigs.write(session, key, 0, epochs, new, added, {ids[1]: ByGnss({"ratio": 1.001, "sigma": 3e-4}, TOLD)})
    database.close()
    return key, ids[1]


def test_a_rig_shows_its_drives_its_epochs_and_its_versions(http: httpx2.Client, known: tuple[str, str]) -> None:
    key, second = known
    found = http.get(f"/v1/rigs/{key}").json()
    assert (found["vehicle_id"], found["rig_id"]) == ("taxi", "roof")
    assert [epoch["chi_square"] for epoch in found["epochs"]] == [None, 99.5]
    assert [version["version"] for version in found["versions"]] == [2, 1]
    assert found["versions"][0]["drives"] == [second]
    assert found["drives"][1]["gnss_ratio"] == 1.001
    (receiver,) = found["receivers"]
    assert receiver["drives"] == [second]
    assert receiver["time_offset_s"] == pytest.approx(0.02, abs=1e-4)
    assert 1e-3 < receiver["sigma_time_offset_s"] < 6e-3
    assert found in http.get("/v1/rigs").json()["rigs"]


def test_the_file_of_a_version_can_be_had(http: httpx2.Client, known: tuple[str, str]) -> None:
    for path in ("RIG.toml", "versions/1/RIG.toml"):
        answer = http.get(f"/v1/rigs/{known[0]}/{path}")
        assert answer.content == CONTENT
        assert answer.headers["ETag"] == f'"{hashlib.sha256(CONTENT).hexdigest()}"'


@pytest.mark.parametrize("path", ["0" * 32, "{key}/versions/9/RIG.toml", "{key}x"])
def test_what_is_not_there_is_a_problem_document(http: httpx2.Client, known: tuple[str, str], path: str) -> None:
    answer = http.get(f"/v1/rigs/{path.format(key=known[0])}")
    assert answer.status_code in (404, 422)
    assert answer.headers["Content-Type"].startswith("application/problem+json")


def test_the_command_line_lists_rigs_and_shows_one_with_its_file(
    api_process: ApiAlone, known: tuple[str, str], tmp_path: Path
) -> None:
    runner, url = CliRunner(), api_process.url
    listed = runner.invoke(app, ["rigs", "list", url])
    assert "taxi roof: 2 drives, version 2, GNSS clock +20.0 ms" in listed.output
    shown = runner.invoke(app, ["rigs", "show", url, "taxi", "--out", str(tmp_path / "RIG.toml")])
    assert "changed (chi-square 100)" in shown.output
    assert (tmp_path / "RIG.toml").read_bytes() == CONTENT
    assert isinstance(runner.invoke(app, ["rigs", "show", url, "nobody"]).exception, NotFoundError)
