"""Layered settings: which layer wins, where each value comes from, what is refused and in which words."""

import itertools
import os
import tomllib
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import pytest
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from wayloom.cli.config import as_toml, document
from wayloom.config.service import ServiceSettings
from wayloom.config.sources import Option, child_environment, leaves, load, value_of, variable
from wayloom.errors import ConfigError
from wayloom.pipeline.settings import ProcessSettings, WayloomSettings, load_settings
from wayloom.pipeline.usable import check_usable


@pytest.fixture(autouse=True)
def no_variables(monkeypatch: pytest.MonkeyPatch):
    for name in [name for name in os.environ if name.startswith("WAYLOOM_")]:
        monkeypatch.delenv(name)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "fleet.toml"


def refused(*words: str, config: Path | None = None, options: tuple[Option, ...] = ()) -> str:
    """The one line with which the settings are refused."""
    with pytest.raises(ConfigError) as caught:
        check_usable(load_settings(config, *options))
    line = str(caught.value)
    assert "\n" not in line
    for word in words:
        assert word in line
    return line


def test_an_option_stands_above_a_variable_above_the_file_above_the_default(file: Path, monkeypatch: pytest.MonkeyPatch):
    file.write_text("[odometry]\nwindow = 8\npoints = 500\nlevels = 4\n")
    monkeypatch.setenv("WAYLOOM_ODOMETRY__POINTS", "600")
    monkeypatch.setenv("WAYLOOM_ODOMETRY__LEVELS", "3")
    loaded = load_settings(file, Option("--levels", "odometry.levels", 2))
    odometry = loaded.settings.odometry
    assert (odometry.huber, odometry.window, odometry.points, odometry.levels) == (9.0, 8, 600, 2)
    origins = [str(loaded.origin(("odometry", name))) for name in ("huber", "window", "points", "levels")]
    assert origins == ["default", str(file), "WAYLOOM_ODOMETRY__POINTS", "--levels"]


def test_an_option_that_was_not_given_and_an_empty_variable_say_nothing(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("WAYLOOM_MAP_ORIGIN", "")
    loaded = load_settings(None, Option("--threads", "threads", None), threads=7)
    assert loaded.settings.threads == 7
    assert loaded.settings.map_origin is None
    assert str(loaded.origin(("threads",))) == "default"


def test_a_variable_names_the_file_and_an_option_another(file: Path, monkeypatch: pytest.MonkeyPatch):
    file.write_text("threads = 3\n")
    monkeypatch.setenv("WAYLOOM_CONFIG", str(file))
    assert load_settings().settings.threads == 3
    other = file.with_name("other.toml")
    other.write_text("threads = 4\n")
    assert load_settings(other).settings.threads == 4


def test_a_file_in_the_working_folder_is_not_read_unasked(file: Path, monkeypatch: pytest.MonkeyPatch):
    file.with_name("wayloom.toml").write_text("threads = 3\n")
    monkeypatch.chdir(file.parent)
    assert load_settings().settings.threads == 1


def test_paths_of_a_file_start_at_its_folder_and_names_of_networks_do_not(file: Path):
    file.write_text('rig = "rigs"\ndata_dir = "data"\n[segmentation]\nmodel = "own.onnx"\n')
    settings = load_settings(file).settings
    assert (settings.rig, settings.data_dir) == (file.parent / "rigs", file.parent / "data")
    assert settings.segmentation.model == str(file.parent / "own.onnx")
    file.write_text('[segmentation]\nmodel = "efficientvit-b0"\n')
    assert load_settings(file).settings.segmentation.model == "efficientvit-b0"


def test_the_network_and_the_device_have_short_variables_below_their_own(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("WAYLOOM_MODEL", "short")
    monkeypatch.setenv("WAYLOOM_DEVICE", "cpu")
    segmentation = load_settings().settings.segmentation
    assert (segmentation.model, segmentation.device) == ("short", "cpu")
    monkeypatch.setenv("WAYLOOM_SEGMENTATION__MODEL", "own")
    assert load_settings().settings.segmentation.model == "own"


@pytest.mark.parametrize("text", ["8.4,49.0,110", "[8.4, 49.0, 110]"])
def test_a_place_is_read_the_same_way_from_variable_and_option(text: str, monkeypatch: pytest.MonkeyPatch):
    assert load_settings(None, Option("--origin", "map_origin", text)).settings.map_origin == (8.4, 49.0, 110.0)
    monkeypatch.setenv("WAYLOOM_MAP_ORIGIN", text)
    assert load_settings().settings.map_origin == (8.4, 49.0, 110.0)


@pytest.mark.parametrize("text", ["999,0,0", "8.4,149,0", "nan,49,0", "8.4,49", "here", "[8.4", "8,49,0,1"])
def test_a_place_that_is_none_is_refused_by_the_variables_name(text: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("WAYLOOM_MAP_ORIGIN", text)
    refused("WAYLOOM_MAP_ORIGIN: ", "LON,LAT,HEIGHT")


def test_a_bad_value_is_refused_by_file_and_key_or_option(file: Path):
    file.write_text("[odometry.imu]\nmax_gap_s = -1.0\n")
    refused(f"{file}, odometry.imu.max_gap_s: -1.0: ", "greater than 0", "seconds without a sample", config=file)
    refused("--threads: 99: ", options=(Option("--threads", "threads", 99),))


def test_an_unknown_key_is_refused_with_the_likely_one(file: Path, monkeypatch: pytest.MonkeyPatch):
    file.write_text("[odometry]\nwindows = 8\n")
    refused(f"{file}, odometry.windows: ", "did you mean odometry.window?", config=file)
    file.write_text("thread = 8\n")
    refused(f"{file}, thread: ", "did you mean threads?", config=file)
    file.write_text("[odometri]\nwindow = 8\n")
    refused(f"{file}, odometri: no setting is called so", config=file)
    monkeypatch.setenv("WAYLOOM_ODOMETRY__WINDOWS", "8")
    refused("WAYLOOM_ODOMETRY__WINDOWS: ", "did you mean WAYLOOM_ODOMETRY__WINDOW?")


def test_a_table_that_is_a_value_and_a_value_that_is_a_table_are_refused(file: Path):
    file.write_text("odometry = 3\n")
    refused(f"{file}, odometry: is a table", "[odometry]", config=file)
    file.write_text("[threads]\ncount = 3\n")
    refused(f"{file}, threads: ", config=file)


def test_a_file_that_is_absent_or_no_toml_is_refused(file: Path):
    refused(str(file), "No such file", config=file)
    file.write_text("threads 3\n")
    refused(str(file), "no TOML", config=file)
    file.write_bytes(b"\xff\xfe")
    refused(str(file), "no TOML", config=file)


def test_a_rule_between_values_names_the_one_that_was_given(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("WAYLOOM_TILES__MIN_ZOOM", "19")
    refused("WAYLOOM_TILES__MIN_ZOOM: ", "min_zoom 19 <= features_max_zoom 18")


def test_a_secret_is_refused_without_being_said(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("WAYLOOM_API_KEY", "tooshort")
    assert "tooshort" not in refused("WAYLOOM_API_KEY: ")


def test_what_is_not_there_is_refused_by_where_it_was_asked_for(file: Path, monkeypatch: pytest.MonkeyPatch):
    file.write_text('rig = "none.toml"\n')
    refused(f"{file}, rig: ", str(file.with_name("none.toml")), "no such file", config=file)
    file.with_name("none.toml").write_text("format_version = 9\n")
    refused(f"{file}, rig: ", "format_version", config=file)
    refused(
        "--model: ", "unknown network 'resnet'", "efficientvit-b0", options=(Option("--model", "segmentation.model", "resnet"),)
    )
    monkeypatch.setenv("WAYLOOM_DEVICE", "abacus")
    refused("WAYLOOM_DEVICE: 'abacus'")
    monkeypatch.setenv("WAYLOOM_DEVICE", "tensorrt")
    refused("WAYLOOM_DEVICE: ", "no provider for tensorrt")


def test_who_runs_no_network_needs_neither_its_file_nor_its_device(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("WAYLOOM_DEVICE", "tensorrt")
    monkeypatch.setenv("WAYLOOM_MODEL", "deeplab-slim")
    check_usable(load_settings(), runs_stages=False)
    monkeypatch.setenv("WAYLOOM_MODEL", "resnet")
    with pytest.raises(ConfigError, match="WAYLOOM_MODEL: unknown network"):
        check_usable(load_settings(), runs_stages=False)


def test_a_part_of_the_settings_leaves_the_other_tables_alone(file: Path):
    file.write_text('database_url = "sqlite:///x"\nthreads = 3\n[odometry]\nwindow = 8\n')
    assert load(ServiceSettings, file, part=True).settings.database == "sqlite:///x"
    with pytest.raises(ConfigError, match="no setting is called so"):
        load(ServiceSettings, file)


def test_a_mistyped_variable_is_told_and_one_of_another_part_is_not(monkeypatch: pytest.MonkeyPatch):
    for model in (ServiceSettings, ProcessSettings, WayloomSettings):
        for key in leaves(model):
            monkeypatch.setenv(variable(key), "")
    for name in ("WAYLOOM_MODELS", "WAYLOOM_SERVER", "WAYLOOM_DATA", "WAYLOOM_DOMAIN"):
        monkeypatch.setenv(name, "x")
    for model in (ServiceSettings, ProcessSettings, WayloomSettings):
        assert load(model).origins == {}
    monkeypatch.setenv("WAYLOOM_THREDS", "7")
    assert refused("WAYLOOM_THREDS: no setting is called so").startswith("WAYLOOM_THREDS")
    refused("did you mean WAYLOOM_THREADS?")


UNUSED = ("access", "oidc_client_secret")
"""Beside a file that holds the secret it is refused."""


def changed(model: type[BaseModel]) -> dict[tuple[str, ...], Any]:
    """For every field another value than its default."""
    own = {
        ("rig",): "/rigs", ("geoid",): "/geoid.gtx", ("map_origin",): (8.0, 49.0, 1e-7), ("api_key",): "k" * 16,
        ("segmentation", "device"): "cpu", ("labelling", "votes"): "hard", ("tiles", "min_zoom"): 11, ("steps",): "a:B",
        ("map_id",): "town", ("data_dir",): "/data", ("merge", "voxel_m"): 0.11, ("merge", "reach_m"): 1.9,
        ("merge", "surface_cell_m"): 0.7, ("uploads", "retention"): 14.0,
        ("excluded_areas",): "/areas.geojson",
        ("access", "oidc_issuer"): "https://id.example", ("access", "oidc_scope"): "openid", UNUSED: None,
        ("access", "oidc_client_secret_file"): "/secret",
        ("access", "oidc_roles"): ("ops=operator",), ("access", "oidc_default_role"): "viewer",
    }  # fmt: skip
    return {key: own.get(key, other(info)) for key, info in leaves(model).items()}


def other(info: FieldInfo) -> Any:
    default = info.get_default()
    if isinstance(default, bool):
        return not default
    if isinstance(default, tuple):
        return tuple(type(item)(item + 1) for item in default) or ("https://one.example", "https://two.example:8443")
    if isinstance(default, int | float):
        shifted = (default + 1, default - 1, default * 1.01, default * 0.99)
        return next(value for value in shifted if valid(info, type(default)(value)) and type(default)(value) != default)
    if get_origin(info.annotation) is Literal:
        return next(choice for choice in reversed(get_args(info.annotation)) if choice != default)
    return "text-of-16-letters"


def valid(info: FieldInfo, value: float) -> bool:
    bounds = {type(rule).__name__: rule for rule in info.metadata}
    tests = {"Ge": lambda rule: value >= rule.ge, "Gt": lambda rule: value > rule.gt, "Le": lambda rule: value <= rule.le}
    tests["Lt"] = lambda rule: value < rule.lt
    return all(tests[name](rule) for name, rule in bounds.items() if name in tests)


def nested(values: dict[tuple[str, ...], Any]) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for key, value in values.items():
        table = tree
        for name in key[:-1]:
            table = table.setdefault(name, {})
        table[key[-1]] = value
    return tree


def test_a_child_gets_exactly_the_settings_of_its_parent(file: Path, monkeypatch: pytest.MonkeyPatch):
    settings = WayloomSettings.model_validate(nested(changed(WayloomSettings)))
    assert [key for key, info in leaves(WayloomSettings).items() if value_of(settings, key) == info.get_default()] == [UNUSED]
    file.write_text("threads = 3\nmap_versions_kept = 1\n")
    monkeypatch.setenv("WAYLOOM_CONFIG", str(file))
    monkeypatch.setenv("WAYLOOM_MODEL", "of the parent's own parent")
    monkeypatch.setenv("WAYLOOM_ODOMETRY__SEED", "5")
    monkeypatch.setenv("WAYLOOM_MODELS", "/networks")
    for parent in (settings, WayloomSettings(data_dir=Path("/x"))):
        environment = child_environment(parent)
        assert environment["WAYLOOM_MODELS"] == "/networks"
        with monkeypatch.context() as child:
            for name in [name for name in os.environ if name.startswith("WAYLOOM_")]:
                child.delenv(name)
            for name, text in environment.items():
                child.setenv(name, text)
            assert load_settings().settings == parent


def test_what_is_shown_can_be_fed_back_and_keeps_secrets(file: Path):
    values = changed(WayloomSettings)
    loaded = load_settings(None, *(Option("test", ".".join(key), value) for key, value in values.items()))
    text = as_toml(loaded)
    secrets = {key: None for key, info in leaves(WayloomSettings).items() if not info.repr}
    assert secrets.keys() == {("api_key",), ("database_url",), ("broker_url",), UNUSED}
    del secrets[UNUSED]
    assert "k" * 16 not in text
    assert tomllib.loads(text)
    file.write_text(text)
    assert load_settings(file).settings == loaded.settings.model_copy(update=nested(secrets))
    assert text.count("# test") == len(values) - 1  # all but UNUSED


def test_the_json_form_holds_every_value_and_its_origin(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("WAYLOOM_ODOMETRY__IMU__USE", "false")
    shown = document(load_settings())
    assert shown["settings"]["odometry"]["imu"]["use"] is False
    assert shown["origins"]["odometry.imu.use"] == "WAYLOOM_ODOMETRY__IMU__USE"
    assert set(shown["origins"]) == {".".join(key) for key in leaves(WayloomSettings)}


def test_a_drives_stages_are_told_every_stages_settings_and_no_key():
    settings = WayloomSettings.model_validate(nested(changed(WayloomSettings)))
    told = settings.of_drives()
    assert type(told) is ProcessSettings
    assert all(value_of(told, key) == value_of(settings, key) for key in leaves(ProcessSettings))


def test_no_two_fields_share_a_variable():
    names = [variable(key) for key in leaves(WayloomSettings)]
    assert all(a != b for a, b in itertools.pairwise(sorted(names)))
