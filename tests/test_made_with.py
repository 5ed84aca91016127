"""A training resumes only with the files with which it began."""

import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from omegaconf import DictConfig

from splatrl.configuration import load_config, with_absolute_paths
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


TOLD = {
    "arm/robot.xml": "robot.path",
    "arm/parts.xml": "parts.xml of robot.path",
    "arm/meshes/shell.stl": "meshes/shell.stl of robot.path",
    "ball.xml": "task.motion.things[ball]",
    "look/meta.json": "task.motion.looks[ball]",
    "look/means.webp": "means.webp of task.motion.looks[ball]",
    "gait.npz": "task.motion.gait",
    "duck.png": "drawing.sprite",
    "scan.ply": "collision.occupancy.cloud",
}
"""What messages call the files."""


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
    told = re.escape(f"got different ones: {TOLD[name]}: its content differs; to resume with them")
    with pytest.raises(ValueError, match=told):
        check_made_with(made_with(chosen(name), "scene"), before)


@pytest.mark.parametrize("name", ["arm/robot.xml", "gait.npz", "duck.png"])
def test_a_run_is_resumed_where_its_files_have_been_moved(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = made_with(with_absolute_paths(chosen(name)), "scene")
    for moved in {Path(file).parts[0] for file in FILES}:
        (tmp_path / "home").mkdir(exist_ok=True)
        shutil.move(moved, tmp_path / "home")
    monkeypatch.chdir(tmp_path / "home")
    check_made_with(made_with(with_absolute_paths(chosen(name)), "scene"), before)
    Path(name).write_text(FILES[name] + "\n")
    with pytest.raises(ValueError, match=re.escape(f"got different ones: {TOLD[name]}: its content differs; to")):
        check_made_with(made_with(with_absolute_paths(chosen(name)), "scene"), before)


def test_a_file_in_place_of_a_built_in_one_is_another_setting() -> None:
    before, now = (made_with(with_absolute_paths(load_config(words)), "scene") for words in (APPLE[:1], APPLE[:2]))
    with pytest.raises(ValueError, match=r"drawing\.sprite: asked for .*duck\.png, found apple; to resume"):
        check_made_with(now, before)


def test_the_scenes_of_a_run_may_lie_elsewhere_but_not_be_others() -> None:
    def among(path: str, *more: str) -> dict[str, Any]:
        place = f"{{scene:{{_target_:splatrl.read_scene,path:{path}}},robot:{{height:0.5}}}}"
        several = f"scene.places=[{','.join([place, *more])}]"
        return made_with(load_config(["task=grid", "scene=many", several, f"demos={path}"]), "scene")

    check_made_with(among("/b"), among("/a"))
    with pytest.raises(ValueError, match=r"got different ones: scene\.places: asked for"):
        check_made_with(among("/b", "{scene:{_target_:splatrl.backyard}}"), among("/a"))


@pytest.mark.parametrize("look", ["look", "looks", "look.ply"])
def test_a_folder_in_place_of_a_file_or_of_other_files_is_another_content(look: str) -> None:
    Path("looks").mkdir()
    Path("looks/other.webp").write_text("an image")
    Path("look.ply").write_text("Gaussians")
    before = made_with(load_config([*PUSH[:-1], "+task.motion.looks.ball=looks"]), "scene")
    now = made_with(load_config([*PUSH[:-1], f"+task.motion.looks.ball={look}"]), "scene")
    if look == "looks":
        check_made_with(now, before)
    else:
        with pytest.raises(
            ValueError, match=r"different ones: task\.motion\.looks\[ball\]: its content differs; to resume"
        ):
            check_made_with(now, before)


@pytest.mark.parametrize("typed", ["demos=8", "demos=null"])
def test_a_run_keeps_saying_what_it_learned_from(typed: str) -> None:
    before = made_with(load_config(["task=grid", "demos=demos"]), "scene")
    check_made_with(made_with(load_config(["task=grid", "demos=elsewhere"]), "scene"), before)
    with pytest.raises(ValueError, match=r"different ones: demos: asked for "):
        check_made_with(made_with(load_config(["task=grid", typed]), "scene"), before)


def test_another_number_of_robots_is_left_to_the_training_which_has_no_way_to_resume_with_it() -> None:
    before, now = (made_with(load_config(["task=grid", f"env.num_envs={robots}"]), "scene") for robots in (16, 8))
    check_made_with(now, before)


def test_a_file_that_was_not_there_is_named_by_the_one_that_refers_to_it() -> None:
    before = made_with(chosen("arm/robot.xml"), "scene")
    shutil.copy("arm/meshes/shell.stl", "arm/meshes/hull.stl")
    Path("arm/parts.xml").write_text(f"<mujoco><asset>{MESH}{MESH.replace('shell', 'hull')}</asset></mujoco>")
    with pytest.raises(ValueError, match=r"different ones: parts.xml of robot.path: its content differs; to resume"):
        check_made_with(made_with(chosen("arm/robot.xml"), "scene"), before)


def test_what_comes_with_splatrl_is_not_among_the_files() -> None:
    assert made_with(load_config(["task=walk"]), "scene")["files"] == {}
