"""A training resumes only with the files with which it began."""

import shutil
from pathlib import Path

import pytest
from omegaconf import DictConfig

from splatrl.configuration import load_config
from splatrl.made_with import check_made_with, made_with

PUSH = ["task=push", "robot=mjcf", "robot.path=arm/robot.xml", "task.motion.things={ball: ball.xml}"]
PUSH += ["+task.motion.looks.ball=look/meta.json"]
WALK = ["task=walk", "task.motion.gait=gait.npz"]
APPLE = ["task=apple", "drawing.sprite=duck.png", "collision=auto", "collision.occupancy.cloud=scan.ply"]
MESH = '<mesh file="shell.stl"/>'
FILES = {
    "arm/robot.xml": '<mujoco><compiler meshdir="meshes"/><include file="parts.xml"/></mujoco>',
    "arm/parts.xml": f"<mujoco><asset>{MESH}</asset></mujoco>",
    "arm/meshes/shell.stl": "a mesh",
    "ball.xml": "<mujoco/>",
    "look/meta.json": "{}",
    "look/means.webp": "an image",
    "gait.npz": "weights",
    "duck.png": "a picture",
    "scan.ply": "points",
}


@pytest.fixture(autouse=True)
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, content in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content)
    monkeypatch.chdir(tmp_path)


def chosen(name: str) -> DictConfig:
    """Return a config that depends on a file."""
    return load_config({"gait.npz": WALK, "duck.png": APPLE, "scan.ply": APPLE}.get(name, PUSH))


@pytest.mark.parametrize("name", FILES)
def test_a_run_is_not_resumed_with_another_content_of_a_file(name: str) -> None:
    before = made_with(chosen(name), "scene")
    check_made_with(made_with(chosen(name), "scene"), before)
    Path(name).write_text(FILES[name] + "\n")
    with pytest.raises(ValueError, match=rf"got different ones: {name}: its content differs; to resume with them"):
        check_made_with(made_with(chosen(name), "scene"), before)


def test_no_way_is_offered_to_resume_with_another_number_of_robots() -> None:
    before, now = (made_with(load_config(["task=grid", f"env.num_envs={robots}"]), "scene") for robots in (16, 8))
    with pytest.raises(ValueError, match=r"env\.num_envs: asked for 8, found 16; a training keeps its number .*s$"):
        check_made_with(now, before)


def test_a_file_that_was_not_there_is_named_by_the_one_that_refers_to_it() -> None:
    before = made_with(chosen("arm/robot.xml"), "scene")
    shutil.copy("arm/meshes/shell.stl", "arm/meshes/hull.stl")
    Path("arm/parts.xml").write_text(f"<mujoco><asset>{MESH}{MESH.replace('shell', 'hull')}</asset></mujoco>")
    with pytest.raises(ValueError, match=r"different ones: arm/parts.xml: its content differs; to resume"):
        check_made_with(made_with(chosen("arm/robot.xml"), "scene"), before)


def test_what_comes_with_splatrl_is_not_among_the_files() -> None:
    assert made_with(load_config(["task=walk"]), "scene")["files"] == {}
