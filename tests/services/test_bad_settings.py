"""Settings that cannot be used end every process of the service at its start: one line that names where they stand, status 2."""

import subprocess
import sys
from pathlib import Path

import pytest

from service_kit.running import environment

PROCESSES = {
    "up": ("wayloom.cli.main", "up", "--port", "0"),
    "api": ("wayloom_services",),
    "worker": ("wayloom_workers", "worker"),
    "migration": ("wayloom.store",),
}


def started(process: str, tmp_path: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", *PROCESSES[process]]
    variables = environment(WAYLOOM_DATA_DIR=str(tmp_path / "data"), **variables)
    return subprocess.run(command, env=variables, capture_output=True, text=True, timeout=60, cwd=tmp_path)


@pytest.mark.parametrize("process", ["up", "api", "worker"])
@pytest.mark.parametrize(
    ("variables", "said"),
    [
        ({"WAYLOOM_MAP_ORIGIN": "999,0,0"}, "WAYLOOM_MAP_ORIGIN: '999': "),
        ({"WAYLOOM_RIG": "rigs/none.toml"}, "WAYLOOM_RIG: rigs/none.toml: no such file or folder"),
        ({"WAYLOOM_MODEL": "resnet"}, "WAYLOOM_MODEL: unknown network 'resnet'"),
        ({"WAYLOOM_DEVICE": "abacus"}, "WAYLOOM_DEVICE: 'abacus'"),
        ({"WAYLOOM_ODOMETRY__WINDOWS": "6"}, "WAYLOOM_ODOMETRY__WINDOWS: no setting is called so"),
    ],
)
def test_a_bad_variable_ends_it_at_the_start(process: str, variables: dict[str, str], said: str, tmp_path: Path) -> None:
    done = started(process, tmp_path, **variables)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert said in done.stderr


@pytest.mark.parametrize("process", ["up", "api", "worker"])
def test_an_unknown_key_of_the_file_ends_it_at_the_start(process: str, tmp_path: Path) -> None:
    (tmp_path / "fleet.toml").write_text("[labelling]\nreech = 3\n")
    done = started(process, tmp_path, WAYLOOM_CONFIG="fleet.toml")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert "fleet.toml, labelling.reech: no setting is called so; did you mean labelling.reach?" in done.stderr


def test_the_migration_reads_its_address_from_a_file_of_all_settings(tmp_path: Path) -> None:
    (tmp_path / "fleet.toml").write_text(f'database_url = "sqlite:///{tmp_path / "map.db"}"\n[labelling]\nreach = 3\n')
    done = started("migration", tmp_path, WAYLOOM_CONFIG="fleet.toml")
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "map.db").is_file()
