"""A user's own package: its task, transform, network and scene work from the command line, as the docs say."""

import json
import os
import sys
from pathlib import Path

import pytest
import torch

from splatrl.building import build_world
from splatrl.configuration import load_config
from splatrl.envs import SplatEnv
from splatrl.motions import ForwardMotion
from tests.envs.contract import EnvContract
from tests.envs.rooms import BOUNDS
from tests.preloaded import start
from tests.tiny import HEIGHT, BlockChecker, tiny_overrides, tiny_renderer, tiny_robot
from tests.two_rooms import in_both

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "tests" / "example_package"
PAGE = (ROOT / "docs" / "extending.md").read_text()
SHOWN = [PACKAGE / "explorer" / f"{name}.py" for name in ("clearing", "networks", "tasks", "transforms")]
SHOWN += sorted([*PACKAGE.rglob("hydra_plugins/*/__init__.py"), *PACKAGE.rglob("*.yaml"), *PACKAGE.glob("*.toml")])
CLEARING = ["task.goal=0", "~task.goal", "~task.rewards", "allow_targets=[explorer]"]
CLEARING += ["task._target_=explorer.clearing.Clearing"]
"""Overrides that replace the task of ``task=grid`` by the package's, without its config."""


def in_new_process(*words: str) -> str:
    """Run ``python`` with the package on its path; return what it prints."""
    surroundings = os.environ | {"PYTHONPATH": str(PACKAGE), "OMP_NUM_THREADS": "1"}
    program = start(*words, env=surroundings, bare=True)
    said, _ = program.communicate(300)
    assert program.wait() == 0, said
    return said


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put the package on Python's path, and unload it afterwards."""
    monkeypatch.syspath_prepend(str(PACKAGE))
    yield
    for name in [name for name in sys.modules if name.split(".")[0] == "explorer"]:
        del sys.modules[name]


@pytest.mark.parametrize("path", SHOWN, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_the_page_shows_the_package_as_it_is(path: Path) -> None:
    assert path.read_text().rstrip() in PAGE


def test_the_package_has_exactly_the_files_that_the_page_lists() -> None:
    listed, parents = set[str](), list[str]()
    for line in PAGE.partition("my_robots/\n")[2].partition("```")[0].splitlines():
        level = (len(line) - len(line.lstrip())) // 2 - 1
        for name in [word for word in line.split() if "/" in word or "." in word]:
            parents[level:] = [name]
            listed |= set() if name.endswith("/") else {"".join(parents[:level]) + name}
    found = {str(path.relative_to(PACKAGE)) for path in PACKAGE.rglob("*") if path.suffix in (".py", ".yaml", ".toml")}
    assert listed == found


def test_configs_of_a_folder_without_an_init_file_are_explained_and_join_a_list_of_scenes() -> None:
    asks = """
from splatrl.configuration.key_help import key_help
from splatrl.configuration.search_path import group_node
print(key_help("train", ["task=explore"]).comments["task.cell"], group_node("scene", "hall")["landmarks"])
"""
    said = in_new_process("-c", asks)
    assert said.split("\n")[0] == "metres {'goal': [0.5, 0.0, 0.0], 'object': [1.2, 0.0, 0.4]}", said


@pytest.mark.parametrize("name", ["tasks.py", "clearing.py"])
def test_a_custom_task_takes_at_most_forty_lines(name: str) -> None:
    assert len((PACKAGE / "explorer" / name).read_text().splitlines()) <= 40


@pytest.mark.usefixtures("example")
def test_a_custom_task_settles_in_every_scene_before_paths_are_planned_there(tmp_path: Path) -> None:
    world = build_world(load_config([*in_both(tmp_path), *CLEARING]))
    west, east = (one.task.place for one in world.worlds)
    assert abs(west[0]) <= 1.0 and 4.0 <= east[0] <= 6.0
    for one in world.worlds:
        away = (one.task.motion.planar(one.plan.states)[:, :2] - one.task.place).norm(dim=1)
        assert one.plan.field is not None and torch.equal(one.plan.at_goal(one.plan.states), away <= 0.3)
        assert away[one.plan.start_rows].min() >= 1.0 and ((away > 0.3) & (away < 1.0)).any()
    assert world.env(4).rollout(2, break_when_any_done=False)["scene"].shape == (4, 2, 1)


@pytest.mark.usefixtures("example")
def test_a_custom_task_settles_after_its_robot_with_physics(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    robot = ["robot=wheels", "motion@task.motion=physics", "task.motion.threads=1"]
    robot += ["task.motion.time_step=0.5", "task.motion.angular_deg=180.0", "task.motion.spacing=0.25"]  # coarse paths
    room = [one for one in tiny_overrides(tmp_path) if not one.startswith(("robot.", "task.motion."))]
    world = build_world(load_config([*room, *robot, *CLEARING]))
    task, starts = world.task, world.plan.starts
    assert len(task.motion.terrain.boxes) > 0 and task.motion.clear(starts).all()
    assert (task.motion.planar(starts)[:, :2] - task.place).norm(dim=1).min() >= 0.99


def test_the_package_trains_from_the_command_line(tmp_path: Path) -> None:
    settings = [
        "task=explore", "scene=hall", "network=linear", "+transforms/grey=on",
        "device=cpu", "collector.total_frames=512", "collector.frames_per_batch=256", "robot.image_width=16",
        "robot.image_height=16", "task.max_steps=16", "task.motion.step=0.5", "task.motion.angle_step_deg=90",
        "task.motion.spacing=0.5", "logger.num_test_episodes=4", "evaluation.starts=8", f"hydra.run.dir={tmp_path}",
    ]  # fmt: skip
    said = in_new_process("-m", "splatrl.commands.train", *settings)
    assert "return" in said and "SPL" not in said  # there is no goal, so there are no paths
    report = json.loads((tmp_path / "evaluation.json").read_text())
    assert report["frames"] == 512 and report["mean_return"] > 0 and "step_spl" not in report
    assert (tmp_path / "rollouts.mp4").stat().st_size > 1000
    config = (tmp_path / "config.yaml").read_text()
    assert all(name in config for name in ("explorer.tasks.Explore", "explorer.transforms.Grey", "explorer.networks"))


@pytest.mark.usefixtures("example")
class TestExplore(EnvContract):
    """The env contract, for a task that has memory but no goal."""

    def make(self, batch_size: tuple[int], seed: int = 0) -> SplatEnv:
        from explorer.tasks import Explore

        from splatrl.curriculum import Curriculum, plan
        from splatrl.envs.drawing import SceneDrawing

        task = Explore(ForwardMotion(HEIGHT, 0.25, 90.0, **BOUNDS), max_steps=15)
        curriculum = Curriculum(plan(task.motion, BlockChecker(), task.reached), None)
        return SplatEnv(SceneDrawing(tiny_renderer()), BlockChecker(), tiny_robot(), task, curriculum, batch_size, seed)

    def test_each_new_cell_is_rewarded_once(self) -> None:
        env = self.make((64,))
        torch.manual_seed(0)
        batch = env.rollout(15, break_when_any_done=False)
        assert torch.equal(batch["next", "visited"].sum(-1, keepdim=True) - batch["visited"].sum(-1, keepdim=True) > 0,
                           batch["next", "reward"] > 0)  # fmt: skip
        last = batch["next", "visited"][:, -1].sum(1)
        assert torch.equal(batch["next", "reward"].sum((1, 2)), (last - 1).float()) and last.max() > 2

    def test_starts_are_all_free_poses_and_there_are_no_paths(self) -> None:
        plan = self.make((1,)).curriculum.starts
        assert plan.levels == 1 and len(plan.ordered) == 468 - 9 * 4  # the block covers 3 × 3 cells
