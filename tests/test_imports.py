"""The order of the packages: each may name only earlier ones, and only a few may use Hydra or choose a device."""

import ast
import functools
import pkgutil
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from omegaconf import OmegaConf

import splatrl
from splatrl.configuration import conf_dir
from tests.preloaded import start

PACKAGE = Path(splatrl.__file__).parent
ROOT = Path(__file__).parents[1]
ORDER = [
    {
        "array_files",
        "decoding",
        "device",
        "device_faults",
        "documents",
        "extras",
        "files",
        "geometry",
        "hdr",
        "images",
        "per_scene",
        "spherical_harmonics",
        "values",
        "waits",
    },
    {"cameras"},
    {"bodies"},
    {"native"},
    {"scenes"},
    {"renderers"},
    {"collision"},
    {"physics"},
    {"motions"},
    {"curriculum"},
    {"envs"},
    {"training"},
    {"evaluation"},
    {"datasets"},
    {"export"},
    {"capture"},
    {"configuration"},
    {"made_with"},
    {"building"},
    {"gymnasium_ids"},
    {"runs"},
    {"viewer"},
    {"experiments"},
    {"commands"},
]
"""Packages and single modules under splatrl/ (here: "rooms"), in order; new ones are added here."""
ONLY = {
    "hydra": {"configuration", "building", "commands"},
    "omegaconf": {
        "documents",
        "scenes",
        "configuration",
        "made_with",
        "building",
        "runs",
        "experiments",
        "commands",
    },
    "splatrl.device": {"building", "commands"},
}
"""Modules that only some rooms may import."""
CONF_LIMITS = {"experiment": "experiments", "train.yaml": "configuration"}
"""Last room that the configs of a group, or a root config, may name; ``evaluation`` for all others."""
DEVICE_CHOICES = {"cuda", "mps", "xpu"}
CHOOSERS = {"device", "building", "commands"}
CUDA_ALONE = ("native/cuda/", "renderers/cuda.py", "renderers/gsplat.py", "collision/cuda.py")
"""Files whose code runs only on CUDA devices, so that naming the device there is not a choice."""
DOTTED = re.compile(r"splatrl(\.\w+)+")
MODULE = re.compile(r"-m (splatrl[\w.]*\w)")

MODULES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")
CONFIGS = sorted(conf_dir().rglob("*.yaml"))


def room(path: Path) -> str:
    """Return the room under splatrl/ that contains a file."""
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def rank(name: str) -> int:
    """Return the position of a room in the order."""
    return next(place for place, rooms in enumerate(ORDER) if name in rooms)


def rooms_of(name: str) -> set[str]:
    """Return the rooms that a dotted name leads through and the one that defines its object; none outside splatrl.

    Raises:
        ImportError: if there is no such module.
        AttributeError: if there is no such object in it.
    """
    thing = pkgutil.resolve_name(name)
    homes = (name, getattr(thing, "__module__", None) or "")
    found = {home.split(".")[1] for home in homes if home.startswith("splatrl.")}
    return {each for each in found if any(each in rooms for rooms in ORDER)}


def name_faults(name: str, limit: str) -> list[str]:
    """Return the faults of a dotted name, if rooms up to ``limit`` may be named."""
    try:
        rooms = rooms_of(name)
    except (ImportError, AttributeError):
        return [f"{name}: expected the name of something, there is no such thing"]
    return [f"{name}: {other} comes after {limit}" for other in sorted(rooms) if rank(other) > rank(limit)]


@functools.lru_cache(1)
def nodes_of(source: str) -> list[ast.AST]:
    """Return all nodes of a module's syntax tree; those of the last module are cached."""
    return list(ast.walk(ast.parse(source)))


def imported(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Yield the full names of everything that a module imports, anywhere in it."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: expected an absolute import"
            assert node.module is not None
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def written(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Yield dotted names of splatrl that are a whole string or follow ``-m`` in one, except OmegaConf resolvers."""
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield from MODULE.findall(node.value)
            if DOTTED.fullmatch(node.value) and not OmegaConf.has_resolver(node.value):
                yield node.value


def faults(name: str, source: str) -> list[str]:
    """Return the faults of the names that a module of the room ``name`` imports or has in strings."""
    found, nodes = [], nodes_of(source)
    for target in imported(nodes):
        for prefix, rooms in ONLY.items():
            if f"{target}.".startswith(f"{prefix}.") and name not in rooms:
                found.append(f"{target}: only {sorted(rooms)} may import {prefix}")
        top, _, rest = target.partition(".")
        if top == "splatrl":
            if any(rest.split(".")[0] in rooms for rooms in ORDER):
                found += name_faults(target, name)
            else:
                found.append(f"{target}: expected an import from a room, not from the package's own names")
    return found + [fault for target in written(nodes) for fault in name_faults(target, name)]


def conf_names(node: Any) -> Iterator[str]:
    """Yield the dotted names in a config: all targets, and all other strings that name something in splatrl."""
    if isinstance(node, list):
        node = dict(enumerate(node))
    if isinstance(node, dict):
        for key, value in node.items():
            if isinstance(value, str) and (key == "_target_" or DOTTED.fullmatch(value)):
                yield value
            yield from conf_names(value)


def conf_faults(path: Path, source: str) -> list[str]:
    """Return the faults of the names in a config, given its path in conf/."""
    limit = CONF_LIMITS.get(path.parts[0], "evaluation")
    return [fault for name in conf_names(yaml.safe_load(source)) for fault in name_faults(name, limit)]


def device_choices(source: str) -> list[int]:
    """Return the lines that choose a device: a default device, or the name of one that not every machine has.

    Asking which device a tensor is on is allowed: ``x.is_cuda``, ``device.type == "cuda"``.
    """
    nodes = nodes_of(source)
    compared = {id(part) for node in nodes if isinstance(node, ast.Compare) for part in ast.walk(node)}
    lines = []
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in compared:
            if node.value.split(":")[0] in DEVICE_CHOICES:
                lines.append(node.lineno)
        elif isinstance(node, ast.Attribute) and node.attr in ("is_available", "set_default_device", "set_device"):
            lines.append(node.lineno)
    return lines


def test_every_module_has_a_place_in_the_order_and_every_place_a_module() -> None:
    assert {room(path) for path in MODULES} == set().union(*ORDER)


@pytest.mark.parametrize("name", sorted({room(path) for path in MODULES}))
def test_modules_name_only_their_own_and_earlier_packages_and_few_choose_a_device(name: str) -> None:
    for path in MODULES:
        if room(path) == name:
            source = path.read_text()
            assert faults(name, source) == [], path
            if name not in CHOOSERS and not path.relative_to(PACKAGE).as_posix().startswith(CUDA_ALONE):
                assert device_choices(source) == [], path


def test_configs_name_only_what_exists_in_the_packages_that_they_may_use() -> None:
    for path in CONFIGS:
        assert conf_faults(path.relative_to(conf_dir()), path.read_text()) == [], path


def test_the_names_of_what_configs_build_are_found() -> None:
    named = {name for path in CONFIGS for name in conf_names(yaml.safe_load(path.read_text()))}
    assert {"splatrl.renderers.NativeRenderer", "splatrl.experiments.clip_scores.score_experiment"} <= named
    assert len(named) > 30


def test_every_command_has_a_module_and_an_entry_point() -> None:
    scripts = dict(re.findall(r'^splatrl-(\w+) = "(.*)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE))
    modules = [path.stem for path in (PACKAGE / "commands").glob("*.py") if " as main\n" in path.read_text("utf-8")]
    assert sorted(scripts) == sorted(modules)
    for name, script in scripts.items():
        assert script == f"splatrl.commands.entries:{name}"
        assert pkgutil.resolve_name(script) is pkgutil.resolve_name(f"splatrl.commands.{name}:main")
        assert pkgutil.resolve_name(script).args == (name,)


def test_mistyped_arguments_and_requests_for_help_do_not_import_pytorch() -> None:
    typed = [
        ("train", "--help", "None"),
        ("train", "taks=fps", "splatrl-train: taks: "),
        ("capture", "--help", "0"),
        ("scene", "--up", "2"),
        ("gait", "--help", "0"),
        ("compare", "--help", "0"),
    ]
    code = "import sys\nimport splatrl.commands.entries as e\n"
    for name, word, _ in typed:
        code += f"sys.argv = {['x', word]}\ntry:\n    e.{name}()\n"
        code += "except SystemExit as end:\n    print('\\nended:', end.code, 'torch' in sys.modules)\n"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    ended = [line for line in done.stdout.splitlines() if line.startswith("ended: ")]
    for line, (*words, status) in zip(ended, typed, strict=True):
        assert line.startswith(f"ended: {status}") and line.endswith(" False"), (words, line)


@pytest.mark.parametrize(
    ("name", "source", "fault"),
    [
        ("curriculum", "from splatrl.envs import SplatEnv", "envs comes after curriculum"),
        ("curriculum", "import splatrl.envs.robot", "envs comes after curriculum"),
        ("scenes", "def f():\n    from splatrl import renderers", "renderers comes after scenes"),
        ("motions", "from splatrl.curriculum import Plan", "curriculum comes after motions"),
        ("envs", "from splatrl import SplatEnv", "not from the package's own names"),
        ("envs", "import splatrl", "not from the package's own names"),
        ("envs", "from hydra.utils import instantiate", "may import hydra"),
        ("training", "import omegaconf", "may import omegaconf"),
        ("envs", "from splatrl.device import chosen_device", "may import splatrl.device"),
        ("envs", "def f():\n    from splatrl.scenes import Nothing", "there is no such thing"),
        ("envs", "import splatrl.scenes.nothing", "there is no such thing"),
        ("experiments", "x = ['-m', 'splatrl.commands.train']", "commands comes after experiments"),
        ("experiments", "x = 'python -m splatrl.commands.train task=fps'", "commands comes after experiments"),
        ("commands", "x = ('-m', 'splatrl.train')", "there is no such thing"),
        ("commands", "'python -m splatrl.train.'", "there is no such thing"),
    ],
)
def test_a_module_that_names_a_later_package_or_a_missing_object_is_reported(
    name: str, source: str, fault: str
) -> None:
    assert [fault in found for found in faults(name, source)] == [True]


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("experiments", "from splatrl.experiments import Run\nimport splatrl.building"),
        ("commands", "x = ('-m', 'splatrl.commands.train')\nimport hydra"),
        ("scenes", "'see splatrl.envs.nothing for more'"),
        ("configuration", "x = 'splatrl.run_dir'"),
    ],
)
def test_a_module_may_name_earlier_packages(name: str, source: str) -> None:
    assert faults(name, source) == []


@pytest.mark.parametrize(
    ("path", "source", "fault"),
    [
        ("task/new.yaml", "_target_: splatrl.experiments.Run", "experiments comes after evaluation"),
        ("clips.yaml", "node: {_target_: splatrl.make_env}", "building comes after evaluation"),
        ("clips.yaml", "steps: [{call: splatrl.runs.load_policy}]", "runs comes after evaluation"),
        ("experiment/new.yaml", "score: splatrl.commands.train.run", "commands comes after experiments"),
        ("experiment/new.yaml", "score: splatrl.experiments.score_nothing", "there is no such thing"),
        ("task/new.yaml", "_target_: splatrl.envs.motions.DriveMotion", "there is no such thing"),
        ("memory/new.yaml", "_target_: torchrl.envs.NoFrames", "there is no such thing"),
        ("scene/new.yaml", "scene: {_target_: splatrl.load_scene}", "there is no such thing"),
    ],
)
def test_a_config_that_names_a_later_package_or_a_missing_object_is_reported(
    path: str, source: str, fault: str
) -> None:
    assert [fault in found for found in conf_faults(Path(path), source)] == [True]


def test_a_config_may_name_earlier_packages() -> None:
    assert conf_faults(Path("experiment/new.yaml"), "score: splatrl.experiments.clip_scores.score_experiment") == []
    ours = "a: {_target_: splatrl.collision.Occupancy.from_scene}\nb: [{_target_: splatrl.backyard}]\nc: splatrl is it"
    assert conf_faults(Path("task/new.yaml"), f"{ours}\nd: {{_target_: torchrl.envs.CatFrames}}") == []


@pytest.mark.parametrize("source", ["x.to('cuda')", "device = 'cuda:1'", "torch.cuda.is_available()"])
def test_code_that_chooses_a_device_is_found(source: str) -> None:
    assert device_choices(source) == [1]


@pytest.mark.parametrize("source", ["x.is_cuda", "if device.type == 'cuda': pass", "'no cuda here'", "device='cpu'"])
def test_asking_which_device_is_in_use_is_not_a_choice(source: str) -> None:
    assert device_choices(source) == []


@pytest.mark.parametrize(
    ("module", "absent"),
    [
        ("splatrl", {"hydra", "omegaconf", "torchrl", "torch"}),
        ("splatrl.geometry", {"hydra", "omegaconf", "torchrl"}),
        ("splatrl.capture.sfm.structure", {"hydra", "omegaconf", "torchrl", "torch"}),
        ("splatrl.building", {"av", "matplotlib"}),
    ],
)
def test_importing_a_small_module_imports_no_large_library(module: str, absent: set[str]) -> None:
    asks = f"import sys, {module}; print(*sorted({absent!r} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", asks], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_the_video_library_is_not_imported_before_a_video_is_read() -> None:
    asks = "import sys, splatrl.commands.train, splatrl.capture.pipeline; print('av' in sys.modules)"
    assert start("-c", asks, bare=True).communicate(60)[0] == "False\n"


@pytest.mark.parametrize("name", splatrl.__all__)
def test_every_public_name_of_the_package_is_the_name_of_its_object(name: str) -> None:
    assert getattr(splatrl, name).__name__ == name
    assert name in dir(splatrl)


def test_type_checkers_see_the_names_that_the_package_provides() -> None:
    tree = ast.parse((PACKAGE / "__init__.py").read_text())
    checked = next(node for node in tree.body if isinstance(node, ast.If))
    names = {name.removeprefix("splatrl."): name.rsplit(".")[-1] for name in imported(ast.walk(checked))}
    assert sorted(names.values()) == sorted(splatrl.__all__)
    assert {name: home.rpartition(".")[0] for home, name in names.items()} == splatrl._HOMES


def test_a_name_that_the_package_lacks_is_refused() -> None:
    with pytest.raises(AttributeError, match="module 'splatrl' has no attribute 'nothing'"):
        _ = splatrl.nothing
