"""Goals that no robot can reach, or not from everywhere."""

import warnings
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from hydra.utils import instantiate
from torch import Tensor

from splatrl.building import build_one_world, build_trainer, build_world, make_env
from splatrl.building.misfits import CUT_OFF, check_goal, check_stack, warn_of_cut_off, warn_of_far_starts
from splatrl.configuration import load_config
from splatrl.curriculum import Plan
from splatrl.curriculum.field import Moves
from splatrl.curriculum.planner import UNREACHABLE
from splatrl.envs.transforms import FrameStack
from splatrl.evaluation.starts import spread_starts
from tests.envs.contract import base_env
from tests.tiny import tiny_overrides
from tests.two_rooms import in_both


def test_a_goal_among_the_robots_that_none_reaches_is_not_said_to_lie_outside() -> None:
    task = instantiate(load_config(["motion@task.motion=orbit"]).task)
    with pytest.raises(ValueError) as refused:
        check_goal(task, task.reached(task.motion.states()))
    assert str(refused.value) == (
        "task.goal: expected a pose that robots can reach, got [0.6, 0.4]; type another landmarks.goal, or another "
        "motion@task.motion"
    )


def test_stacked_views_that_the_policy_does_not_read_are_refused() -> None:
    cfg = load_config(["task=pointnav", "memory=stack"])
    stack = instantiate(cfg.transforms.stack)
    with pytest.raises(ValueError) as refused:
        check_stack([stack], list(cfg.inputs))
    assert str(refused.value) == (
        "memory=stack: expected a policy that reads what is stacked, pixels, got one that reads depth, "
        "pointgoal_with_gps_compass; type memory=gru, or add rgb to sensors=[...]"
    )
    check_stack([stack], ["pixels", "depth"])
    check_stack([FrameStack(4, ("depth",))], ["depth"])


def test_a_tenth_of_the_free_poses_may_be_cut_off_from_the_goal_and_more_are_warned_of(tmp_path: Path) -> None:
    world = build_one_world(load_config(tiny_overrides(tmp_path)))
    rows = world.plan.free.nonzero().squeeze(1)

    def cut(count: int) -> Plan:
        distance = world.plan.distance.clone()
        distance[rows[:count]] = UNREACHABLE
        return replace(world.plan, distance=distance)

    tenth, free = len(rows) // 10, len(rows)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for plan in (world.plan, cut(tenth)):
            warn_of_cut_off(world.scene, plan)
    with pytest.warns(UserWarning, match=f"tiny: {tenth + 1} of {free} free poses cannot reach the goal, and episodes"):
        warn_of_cut_off(world.scene, cut(tenth + 1))
    moves = world.plan.moves
    skipping = replace(cut(tenth + 1), moves=Moves(moves.motion, moves.checker, moves.reached, 4))
    with pytest.warns(UserWarning, match=r"; fewer transforms\.skip\.steps may lead out of there$"):
        warn_of_cut_off(world.scene, skipping)


def test_building_warns_of_free_poses_behind_a_gap_too_narrow_for_the_body(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="24 of 48 .* goal, .*; task.motion.step=0.25 or a narrower"):
        build_one_world(load_config([*tiny_overrides(tmp_path), "robot.body.size=[0.9,0.9,0.2]"]))


@pytest.mark.parametrize("skip", ["none", "four"])
def test_only_training_leaves_out_starts_from_which_an_episode_is_too_short(tmp_path: Path, skip: str) -> None:
    config = [*tiny_overrides(tmp_path), f"transforms/skip={skip}"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "tiny: .* free poses cannot reach the goal")  # with repeated actions
        whole = build_one_world(load_config([*config, "task.max_steps=20"])).plan
        near = build_one_world(load_config([*config, "task.max_steps=5", "starts.farthest=4"])).plan
    steps = whole.distance[whole.start_rows]
    assert 5 < steps.max() <= 20 and near.distance[near.start_rows].max() <= 4
    far, starts = int((steps > 5).sum()), len(steps)
    with pytest.warns(UserWarning) as told:
        world = build_one_world(load_config([*config, "task.max_steps=5"]))
    assert str(told[-1].message) == (
        f"tiny: {far} of {starts} starts are farther from the goal than task.max_steps=5: training leaves them out, "
        "and evaluation counts them as failures"
    )
    assert world.plan.start_rows.equal(whole.start_rows) and world.plan.distance.equal(whole.distance)
    assert world.plan.in_reach.start_rows.equal(whole.start_rows[steps <= 5])
    assert _states(spread_starts(world, 2048).state) == _states(whole.starts)
    assert _states(base_env(world.env(2)).curriculum.starts.ordered) == _states(whole.starts)


def test_a_task_that_goes_on_after_its_goals_has_no_starts_out_of_reach(tmp_path: Path) -> None:
    world = build_one_world(load_config([*tiny_overrides(tmp_path, "snake"), "task.max_steps=2"]))
    assert world.plan.distance.max() > 2 and world.plan.in_reach.start_rows.equal(world.plan.start_rows)


@pytest.mark.parametrize(("curriculum", "kept"), [("distance", False), ("none", True)])
def test_envs_draw_starts_out_of_reach_without_a_curriculum_alone(tmp_path: Path, curriculum: str, kept: bool) -> None:
    settings = [*in_both(tmp_path), f"curriculum={curriculum}", "task.max_steps=5"]
    with pytest.warns(UserWarning, match="training leaves them out"):
        env, world = base_env(make_env(settings)), build_world(load_config(settings))
    plans = [one.plan for one in world.worlds]
    assert all((plan.distance > 5).any() for plan in plans)
    expected = [plan.starts if kept else plan.in_reach.starts for plan in plans]
    ends = torch.tensor([len(states) for states in expected]).cumsum(0)
    found = env.curriculum.starts.ordered.tensor_split(ends[:-1])
    assert [_states(states) for states in found] == [_states(states) for states in expected]
    assert env.curriculum.starts.counts[:, -1].tolist() == [len(states) for states in expected]


def _states(states: Tensor) -> set[tuple[float, ...]]:
    return {tuple(state) for state in states.tolist()}


def test_a_task_whose_episodes_are_too_short_for_every_start_is_refused(tmp_path: Path) -> None:
    world = build_one_world(load_config(tiny_overrides(tmp_path)))
    far = replace(world.plan, start_rows=(world.plan.distance > 4).nonzero().squeeze(1), max_steps=3)
    with pytest.raises(
        ValueError, match=r"^task\.max_steps: expected at least 5, the steps from the nearest start .* 3$"
    ):
        warn_of_far_starts(world.scene, far)


def test_robots_that_orbit_are_not_warned_of_things_on_their_circle() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        world = build_one_world(load_config(["task=circle", "device=cpu"]))
    assert world.plan.cut_off.sum() > CUT_OFF * world.plan.free.sum()


@pytest.mark.parametrize(
    ("given", "warned"),
    [
        (["task=pointnav"], False),
        (["task=imagenav", "sensors=[rgb,depth,pointgoal]"], False),
        (["task=pointnav", "sensors=[rgb,pointgoal]", "~inputs.pointgoal_with_gps_compass"], True),
        (["task=pointnav", "sensors=[lidar,contact]"], True),
        (["task=imagenav", "sensors=[]"], True),
        (["task=drive", "sensors=[lidar]"], False),
    ],
)
def test_training_warns_of_a_policy_that_cannot_know_its_goal(given: list[str], warned: bool, tmp_path: Path) -> None:
    few = ["task.goals=2", "task.test_goals=3", "robot.body.radius=0.1"] if "nav" in given[0] else []
    name = given[0].removeprefix("task=")
    cfg = load_config([*tiny_overrides(tmp_path, name), *few, *given[1:], "logger.num_test_episodes=3"])
    world = build_world(cfg)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        build_trainer(cfg, world, tmp_path / "run")
    assert any("the policy cannot know its goal" in str(one.message) for one in told) is warned
