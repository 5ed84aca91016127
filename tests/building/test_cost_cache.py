"""Costs of shortest paths are computed once, and again whenever something that they depend on has changed."""

import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

import splatrl
import splatrl.building.cost_cache
from splatrl.building import build_one_world
from splatrl.building.cost_cache import remembering
from splatrl.collision import Occupancy
from splatrl.configuration import load_config
from splatrl.files import cache_dir
from splatrl.physics.robots import mjcf_path
from tests.tiny import tiny_gaussians, tiny_overrides


@pytest.fixture
def found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[int]:
    """A list that gets an entry each time that costs are computed."""
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path / "cache"))
    count: list[int] = []
    original = splatrl.building.cost_cache.cost_field
    monkeypatch.setattr(splatrl.building.cost_cache, "cost_field", lambda *parts: count.append(0) or original(*parts))
    return count


def test_a_second_world_reuses_the_costs_of_the_first(found: list[int], tmp_path: Path) -> None:
    cfg = load_config(tiny_overrides(tmp_path))
    first, again = build_one_world(cfg).plan, build_one_world(cfg).plan
    assert len(found) == 1
    assert first.field is not None and again.field is not None
    assert torch.equal(first.field.cost_to_go, again.field.cost_to_go) and torch.equal(first.distance, again.distance)


@pytest.mark.parametrize(
    "change",
    [
        "landmarks.goal=[0.0,1.0,0.0]",
        "robot.body.size=[0.2,0.2,0.2]",
        "collision=none",
        "collision.occupancy.fill=null",
        "transforms/skip=four",
    ],
)
def test_another_goal_body_collision_map_or_repetition_has_costs_of_its_own(
    found: list[int], tmp_path: Path, change: str
) -> None:
    words = tiny_overrides(tmp_path)
    words = [word for word in words if word.partition("=")[0] != change.partition("=")[0]]
    build_one_world(load_config(tiny_overrides(tmp_path)))
    build_one_world(load_config([*words, change]))
    assert len(found) == 2


def test_a_changed_robot_has_costs_of_its_own(
    found: list[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, wheels = tmp_path / "robot.xml", mjcf_path("wheels").read_text()
    own = ["robot=mjcf", f"robot.path={path}", "motion@task.motion=physics"]
    moves: Any = SimpleNamespace(repeats=1, motion=SimpleNamespace(nodes=lambda: torch.zeros(3)))
    costs = SimpleNamespace(cost_to_go=torch.zeros(3))
    monkeypatch.setattr(splatrl.building.cost_cache, "cost_field", lambda moves: found.append(0) or costs)
    for limits, count in (("-0.25 0.5", 1), ("-0.25 0.4", 2), ("-0.25 0.4", 2)):
        path.write_text(wheels.replace("-0.25 0.5", limits))
        cfg = load_config([*tiny_overrides(tmp_path, "drive"), *own])
        remembering(cfg, Occupancy.from_gaussians(tiny_gaussians()))(moves)
        assert len(found) == count


def test_costs_in_a_damaged_cache_are_computed_again(found: list[int], tmp_path: Path) -> None:
    cfg = load_config(tiny_overrides(tmp_path))
    first = build_one_world(cfg).plan
    (kept,) = cache_dir().glob("costs-*.npz")
    with kept.open("wb") as stream:
        np.savez(stream, costs=np.zeros(3))
    again = build_one_world(cfg).plan
    assert len(found) == 2 and torch.equal(first.distance, again.distance)


def test_costs_are_not_cached_for_a_task_from_another_package(found: list[int], tmp_path: Path) -> None:
    words = [*tiny_overrides(tmp_path), "task._target_=tests.building.test_cost_cache.grid", "allow_targets=[tests]"]
    for _ in range(2):
        build_one_world(load_config(words))
    assert len(found) == 2


def grid(**settings: object) -> object:
    """Return a task, as if it came from another package."""
    from splatrl.envs.tasks import Grid

    return Grid(**settings)  # type: ignore[arg-type]


def test_a_change_of_the_python_code_or_the_compiled_core_computes_costs_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = splatrl.building.cost_cache._code.__wrapped__()
    (tmp_path / "core").write_bytes(b"another build")
    with monkeypatch.context() as patch:
        patch.setattr(splatrl.building.cost_cache._core, "__file__", str(tmp_path / "core"))
        assert splatrl.building.cost_cache._code.__wrapped__() != before
    assert splatrl.building.cost_cache._code.__wrapped__() == before
    copy = shutil.copytree(Path(splatrl.__file__).parent, tmp_path / "splatrl", ignore=shutil.ignore_patterns("conf"))
    monkeypatch.setattr(splatrl.building.cost_cache, "__file__", str(copy / "building" / "cost_cache.py"))
    assert splatrl.building.cost_cache._code.__wrapped__() == before
    for name in ("geometry.py", "collision/several.py", "envs/tasks/grid.py", "physics/robots/wheels.xml"):
        source = copy / name
        source.write_text(source.read_text() + "\n")
        now = splatrl.building.cost_cache._code.__wrapped__()
        assert now != before, name
        before = now
