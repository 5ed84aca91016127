"""The order of the rooms: each imports only from those before it, and few know Hydra or choose a device."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import splatrl

PACKAGE = Path(splatrl.__file__).parent
ORDER = [
    {"files", "faults", "geometry", "spherical_harmonics"},
    {"cameras"},
    {"bodies"},
    {"native"},
    {"scenes"},
    {"renderers"},
    {"collision"},
    {"curriculum"},
    {"envs"},
    {"training"},
    {"evaluation"},
    {"reconstruct"},
    {"device"},
    {"configuration"},
    {"world"},
    {"experiments"},
    {"train", "evaluate", "commands", "experiment_command", "clips_command"},
]
"""Rooms and single modules under splatrl/; a new one finds its place here."""
ENTRY_POINTS = {"train", "evaluate", "commands", "experiment_command", "clips_command"}
HYDRA_USERS = {
    "hydra": {"configuration", "world"} | ENTRY_POINTS,
    "omegaconf": {"configuration", "world", "scenes"} | ENTRY_POINTS,
}
DEVICE_CHOICES = {"cuda", "mps", "xpu"}
CUDA_ALONE = ("native/cuda/", "renderers/cuda.py", "renderers/gsplat.py", "collision/cuda.py")
"""What runs on a CUDA device and on no other: to name it is no choice."""

MODULES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def room(path: Path) -> str:
    """The room under splatrl/ in which a file lies."""
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def rank(name: str) -> int:
    """Place of a room in the order."""
    return next(place for place, rooms in enumerate(ORDER) if name in rooms)


def imported(tree: ast.AST) -> Iterator[str]:
    """Full names of all that a module imports, wherever it does."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: expected an absolute import"
            assert node.module is not None
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def faults(name: str, source: str) -> list[str]:
    """What is wrong with the imports of a module of the room ``name``."""
    found = []
    for target in imported(ast.parse(source)):
        top, _, rest = target.partition(".")
        if top in HYDRA_USERS and name not in HYDRA_USERS[top]:
            found.append(f"{target}: only {sorted(HYDRA_USERS[top])} may import {top}")
        if top == "splatrl":
            other = rest.split(".")[0]
            if not any(other in rooms for rooms in ORDER):
                found.append(f"{target}: expected an import from a room, not from the package's own names")
            elif rank(other) > rank(name):
                found.append(f"{target}: {other} comes after {name}")
    return found


def device_choices(source: str) -> list[int]:
    """Lines that choose a device: a default device, or a name of one that is not everywhere.

    Asking what device a tensor has is free: ``x.is_cuda``, ``device.type == "cuda"``.
    """
    tree = ast.parse(source)
    compared = {id(part) for node in ast.walk(tree) if isinstance(node, ast.Compare) for part in ast.walk(node)}
    lines = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in compared:
            if node.value.split(":")[0] in DEVICE_CHOICES:
                lines.append(node.lineno)
        elif isinstance(node, ast.Attribute) and node.attr in ("is_available", "set_default_device", "set_device"):
            lines.append(node.lineno)
    return lines


def test_every_module_has_a_place_in_the_order() -> None:
    assert {room(path) for path in MODULES} <= set().union(*ORDER)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_a_module_imports_only_from_rooms_before_its_own(path: Path) -> None:
    assert faults(room(path), path.read_text()) == []


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_only_entry_points_and_the_module_they_ask_choose_a_device(path: Path) -> None:
    if room(path) not in ENTRY_POINTS | {"device"} and not path.relative_to(PACKAGE).as_posix().startswith(CUDA_ALONE):
        assert device_choices(path.read_text()) == []


@pytest.mark.parametrize(
    ("name", "source", "fault"),
    [
        ("curriculum", "from splatrl.envs import SplatEnv", "envs comes after curriculum"),
        ("curriculum", "import splatrl.envs.robot", "envs comes after curriculum"),
        ("scenes", "def f():\n    from splatrl import renderers", "renderers comes after scenes"),
        ("envs", "from splatrl import SplatEnv", "not from the package's own names"),
        ("envs", "import splatrl", "not from the package's own names"),
        ("envs", "from hydra.utils import instantiate", "may import hydra"),
        ("training", "import omegaconf", "may import omegaconf"),
    ],
)
def test_an_import_that_goes_up_is_found(name: str, source: str, fault: str) -> None:
    assert [fault in found for found in faults(name, source)] == [True]


@pytest.mark.parametrize("source", ["x.to('cuda')", "device = 'cuda:1'", "torch.cuda.is_available()"])
def test_the_choice_of_a_device_is_found(source: str) -> None:
    assert device_choices(source) == [1]


@pytest.mark.parametrize("source", ["x.is_cuda", "if device.type == 'cuda': pass", "'no cuda here'", "device='cpu'"])
def test_asking_for_a_device_is_no_choice(source: str) -> None:
    assert device_choices(source) == []
