"""A stranger's run folder runs no code: only constructors that appear in conf/ or were allowed are called."""

import json
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hydra._internal.core_plugins.importlib_resources_config_source import ImportlibResourcesConfigSource
from omegaconf import OmegaConf

from splatrl.building import build_world
from splatrl.configuration import load_config, resumed_config, run_config, save_config, targets
from splatrl.configuration.targets import check_targets
from splatrl.runs import load_policy
from splatrl.scenes import read_scene
from tests.tiny import tiny_overrides

WAYS = [  # a key, and the YAML that a stranger puts there
    ("scene.name", "{{_target_: sympy.sympify, a: \"__import__('os').mkdir('{made}')\"}}"),
    ("scene.name", "{{_target_: site.addsitedir, sitedir: {made}}}"),
    ("scene.name", "{{_target_: torch.ops.load_library, path: {made}}}"),
    ("scene.name", "{{_target_: pathlib.Path.touch, self: {{_target_: pathlib.Path, _args_: [{made}]}}}}"),
    ("scene", "{{_target_: os.mkdir, path: {made}}}"),
    ("scene", "{{_target_: builtins.exec, _args_: [\"import os; os.mkdir('{made}')\"]}}"),
    ("scene", "{{_target_: builtins.eval, _args_: [\"__import__('os').mkdir('{made}')\"]}}"),
    ("scene", "{{_target_: runpy.run_path, path_name: {made}}}"),
    ("scene", "{{_target_: subprocess.Popen, args: [mkdir, {made}]}}"),
    ("scene", "{{_target_: splatrl.experiments.running.subprocess.Popen, args: [mkdir, {made}]}}"),
    ("scene", "{{_target_: splatrl.files.os.mkdir, path: {made}}}"),
    ("scene", "{{_target_: splatrl.files.shutil.rmtree, path: {made}}}"),
    ("scene", "{{_target_: splatrl.files.new_folder, path: {made}}}"),
    ("scene", "{{_target_: splatrl.backyard.__globals__, path: {made}}}"),
    ("scene", "{{_target_: torch.load, f: {made}, weights_only: false}}"),
    ("scene", "{{_target_: torch.hub.load, repo_or_dir: {made}, model: x, source: local}}"),
    ("scene", "{{_target_: numpy.load, file: {made}, allow_pickle: true}}"),
    ("scene", "{{_target_: hydra.utils.instantiate, config: {{_target_: os.mkdir, path: {made}}}}}"),
    ("scene", "{{_target_: hydra._internal.core_plugins.basic_launcher.BasicLauncher}}"),
    ("robot.body", "{{_target_: os.mkdir, path: {made}}}"),
    ("robot.body.size", "[{{_target_: os.mkdir, path: {made}}}, 1, 1]"),
    ("robot.body.size", "[[[{{_target_: os.mkdir, path: {made}}}]], 1, 1]"),
    ("task.motion.step", "{{a: {{b: {{_target_: os.mkdir, path: {made}}}}}}}"),
    ("transforms.mine", "{{_target_: os.mkdir, path: {made}}}"),
    ("collision.cpu", "{{_target_: os.mkdir, _partial_: true, path: {made}}}"),
    ("network", "{{_target_: os.mkdir, path: {made}}}"),
    ("curriculum", "{{_target_: os.mkdir, path: {made}}}"),
    ("loss", "{{_target_: os.mkdir, path: {made}}}"),
    ("optim", "{{_target_: importlib.import_module, name: antigravity}}"),
    ("drawing", "{{_target_: os.mkdir, path: {made}}}"),
    ("renderer.cache", "{{_target_: os.mkdir, path: {made}}}"),
    ("renderer.cpu._target_", "os.system"),
    ("renderer.cpu._target_", "${{robot.word}}"),
    ("renderer.cpu._target_", "${{oc.env:SHELL}}"),
    ("renderer.cpu", "\"${{oc.create:'{{_target_: os.mkdir, path: {made}}}'}}\""),
    ("renderer.cpu._target_", "[os.system]"),
    ("renderer.cpu._target_", "null"),
    ("allow_targets", "[os, {{_target_: os.mkdir, path: {made}}}]"),
]


@pytest.fixture(scope="module", autouse=True)
def compiled_parser() -> Iterator[None]:
    """Parse YAML with libyaml if it is available, which is faster; other tests cover the parser itself."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(yaml, "SafeLoader", getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        yield


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run in the tiny room."""
    room = tmp_path_factory.mktemp("room")
    save_config(load_config(tiny_overrides(room)), room)
    return room


@pytest.fixture
def folder(saved: Path, tmp_path: Path) -> Path:
    """An unmodified copy of the run folder."""
    shutil.copy(saved / "config.yaml", tmp_path)
    return tmp_path


def changed(folder: Path, key: str, text: str) -> None:
    """Write YAML for a key into the config of a run folder; it may refer to ``robot.word``, which is not allowed."""
    with (folder / "config.yaml").open() as file:
        cfg: Any = OmegaConf.to_container(OmegaConf.load(file))
    node = cfg
    node["robot"].setdefault("word", "os.system")
    *parents, leaf = key.split(".")
    for parent in parents:
        node = node.setdefault(parent, {})
    node[leaf] = "PLACE"
    section, *_ = key.split(".")
    changed_node = OmegaConf.to_yaml({section: cfg.pop(section)}).replace("PLACE", text)
    others = [f"{name}: {json.dumps(value)}\n" for name, value in cfg.items()]
    (folder / "config.yaml").write_text("".join([*others, changed_node]))


@pytest.mark.parametrize(("key", "text"), WAYS)
def test_a_run_folder_may_name_only_constructors_that_appear_in_conf(key: str, text: str, folder: Path) -> None:
    made = folder / "made"
    changed(folder, key, text.format(made=made))
    if key == "allow_targets":  # the folder's own list is ignored
        assert run_config(folder).allow_targets == []
        return
    with pytest.raises(ValueError, match=r"config\.yaml: .*(a constructor that appears in|references to a single key)"):
        run_config(folder)
    assert not made.exists() and "antigravity" not in sys.modules


@pytest.mark.parametrize("use", [load_policy, lambda run: resumed_config(run, [f"resume={run}"])])
@pytest.mark.parametrize(("key", "text"), WAYS[::12])
def test_the_targets_of_a_run_folder_are_checked_whenever_it_is_used(
    key: str, text: str, use: Callable[[Path], object], folder: Path
) -> None:
    made = folder / "made"
    changed(folder, key, text.format(made=made))
    with pytest.raises(ValueError, match=r"config\.yaml: .*(a constructor that appears in|references to a single key)"):
        use(folder)
    assert not made.exists()


def test_the_error_names_the_key_and_the_target(folder: Path) -> None:
    changed(folder, "robot.body.size", "[1, {a: {_target_: os.system}}, 1]")
    with pytest.raises(ValueError, match=r"robot\.body\.size\.1\.a\._target_: expected .* got 'os\.system'"):
        run_config(folder)


@pytest.mark.parametrize("text", ["${robot}", "{a: {x: '${task.motion}'}}", "${task.motion.step}", "${nowhere.to_be}"])
def test_circular_and_dangling_references_are_refused(text: str, folder: Path) -> None:
    changed(folder, "robot.word", "'${task.motion.step}'" if text == "${robot}" else "x")
    changed(folder, "task.motion.step", text if text != "${robot}" else "'${robot.word}'")
    with pytest.raises(ValueError, match=r"config\.yaml: (config|task\.motion\.step): expected"):
        run_config(folder)


def test_references_that_expand_exponentially_are_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert targets.MAX_VALUES <= 10_000
    monkeypatch.setattr(targets, "MAX_VALUES", 1_000)
    cfg = OmegaConf.load(folder / "config.yaml")
    for level in range(40):
        cfg[f"n{level}"] = {"x": f"${{n{level + 1}}}", "y": f"${{n{level + 1}}}"}
    cfg.n40 = 1
    OmegaConf.save(cfg, folder / "config.yaml")
    with pytest.raises(ValueError, match="expected at most 1,000 values"):
        run_config(folder)


def test_an_allowed_package_may_name_what_it_defines_and_not_what_it_imports(folder: Path) -> None:
    given = "expected a constructor that appears in conf/"
    changed(folder, "network._target_", "tests.configuration.test_targets.tiny_overrides")
    with pytest.raises(ValueError, match=given):
        run_config(folder)
    assert run_config(folder, ["tests"]).network._target_ == "tests.configuration.test_targets.tiny_overrides"
    resumed = resumed_config(folder, [f"resume={folder}", "allow_targets=[tests]"])
    assert resumed.allow_targets == ["tests"]
    for target in (
        "tests.configuration.test_targets.sys.exit",
        "tests.configuration.test_targets.OmegaConf.load",
        "tests.configuration.test_targets.Path",
    ):
        changed(folder, "network._target_", target)
        with pytest.raises(ValueError, match=given):
            run_config(folder, ["tests"])
    changed(folder, "network._target_", "tests.configuration.test_targets.nothing")
    with pytest.raises(ValueError, match=r"expected tests\.configuration\.test_targets\.nothing to be importable"):
        run_config(folder, ["tests"])


def test_targets_are_checked_wherever_a_config_comes_from(tmp_path: Path) -> None:
    cfg = load_config([*tiny_overrides(tmp_path), "scene._target_=builtins.print"])
    with pytest.raises(ValueError, match=r"scene\._target_: expected a constructor that appears in conf/"):
        build_world(cfg)


def test_a_config_without_its_sections_is_refused(folder: Path) -> None:
    whole = OmegaConf.load(folder / "config.yaml")
    for key in ("scene", "logger.video", "collector", "device", "threads"):
        cfg = whole.copy()
        parent, _, leaf = key.rpartition(".")
        del (OmegaConf.select(cfg, parent) if parent else cfg)[leaf]
        OmegaConf.save(cfg, folder / "config.yaml")
        with pytest.raises(ValueError, match=rf"config\.yaml: {key}: expected"):
            run_config(folder)
    (folder / "config.yaml").write_text("[1, 2]")
    with pytest.raises(ValueError, match="expected keys and values"):
        run_config(folder)


@pytest.mark.parametrize("name", ["../../x", "/x", "a/b", "..", ".", "a\\\\b", "a\\nb", "a\\0b", "x" * 300])
def test_a_name_cannot_point_outside_its_folder(name: str, tmp_path: Path) -> None:
    tiny_overrides(tmp_path)
    (tmp_path / "scene.yaml").write_text(f'splat: tiny.ply\nname: "{name}"\n')
    with pytest.raises(ValueError, match=r"scene\.yaml: name: expected a name"):
        read_scene(tmp_path)
    (tmp_path / "scene.yaml").write_text(f'splat: "{name}"\n')
    with pytest.raises(ValueError, match=r"scene\.yaml: splat: expected a name"):
        read_scene(tmp_path)


def test_the_name_of_a_scene_in_a_run_folder_cannot_point_outside_it(folder: Path) -> None:
    changed(folder, "scene.name", "../../x")
    with pytest.raises(Exception, match=r"scene\.name: expected a name, without slashes, got '\.\./\.\./x'"):
        build_world(run_config(folder))


def test_constructors_that_a_plugins_configs_name_are_accepted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "plugin_of_a_test" / "conf" / "motion"
    folder.mkdir(parents=True)
    (folder.parent / "__init__.py").touch()  # Hydra asks for one
    glide = "# @package _global_\nmotion:\n  - {_target_: plugin_of_a_test.Glide, pace: 1e-1}\n"
    (folder / "glide.yaml").write_text(glide)
    (folder / "names_nothing.yaml").write_text("pace: [\n")
    monkeypatch.syspath_prepend(tmp_path)
    source = ImportlibResourcesConfigSource("a plugin", "pkg://plugin_of_a_test.conf")
    cfg = OmegaConf.create({"motion": [{"_target_": "plugin_of_a_test.Glide"}]})
    check_targets(cfg, [source])
    with pytest.raises(ValueError, match=r"motion.0._target_: expected a constructor that appears in conf/"):
        check_targets(OmegaConf.create({"motion": [{"_target_": "plugin_of_a_test.Fall"}]}), [source])
