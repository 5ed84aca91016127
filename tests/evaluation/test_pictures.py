"""Videos of a training show physics in real time, and no more episodes than fit into a limited number of frames."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from splatrl.building import build_one_world
from splatrl.configuration import load_config
from splatrl.curriculum.planner import UNREACHABLE
from splatrl.envs.tasks import Outcome
from splatrl.evaluation import Episodes, pictures
from splatrl.evaluation.pictures import Pictures, shown, steps_a_second
from splatrl.motions import DriveMotion, PhysicsMotion
from tests.tiny import tiny_motion, tiny_overrides


def test_actions_that_have_a_duration_are_shown_in_real_time_and_others_at_a_fixed_pace() -> None:
    pytest.importorskip("mujoco")
    speeds = [steps_a_second(PhysicsMotion("wheels", "eye", time_step=time, threads=1)) for time in (0.1, 0.2)]
    assert speeds == [10, 5] and steps_a_second(tiny_motion()) == 6
    assert steps_a_second(DriveMotion(height=0.4, time_step=0.5)) == 2


def test_a_video_shows_fewer_episodes_if_all_would_not_fit_at_the_longest_length() -> None:
    assert shown([5, 5, 5, 5], 400) == [0, 1, 2, 3]
    assert shown([200, 3, 2, 200], 400) == [1, 3]
    assert shown([200, 200, 200, 3], 10) == [3]  # the last one, in full


@pytest.mark.filterwarnings("ignore:.* starts are farther from the goal")
def test_a_video_names_the_numbers_of_actions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[Any] = []
    monkeypatch.setattr(pictures, "rollout_video", lambda *given, **_: told.append(given[5]))
    for task in ("drive", "grid"):
        world = build_one_world(load_config([*tiny_overrides(tmp_path, task), "task.max_steps=1"]))
        env = world.env(1)
        drawn = Pictures(world.scene.gaussians, world.occupancy, world.plan, env, tmp_path)
        drawn.video(env, env.rand_action, 0, 10)
    assert told == [("forward (m/s)", "turn (rad/s)"), world.task.motion.action_names]


def test_a_map_says_how_many_starts_of_how_many_were_tried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world = build_one_world(load_config(tiny_overrides(tmp_path)))
    drawn = Pictures(world.scene.gaussians, world.occupancy, world.plan, world.env(1), tmp_path)
    told: list[str] = []
    monkeypatch.setattr(pictures, "success_map", lambda *given: told.append(given[-2]))
    every = world.plan.states[world.plan.start_rows]
    for start in (every, every.repeat_interleave(2, 0), every[:3].repeat_interleave(2, 0)):
        row = torch.zeros(len(start), dtype=torch.int64)
        drawn.success_map(Episodes(start, row + Outcome.GOAL, row, row.float(), row, row == 0))
    assert told == ["all starts", "all starts", f"3 of {len(every)} starts:"]


def test_maps_are_told_where_the_body_fits_but_has_no_way_to_the_goal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = build_one_world(load_config(tiny_overrides(tmp_path)))
    place = world.task.motion.planar(world.plan.states)[:, :2]
    west = place[:, 0] < -0.4
    walled = replace(world.plan, distance=torch.where(west, UNREACHABLE, world.plan.distance))
    assert torch.equal(walled.cut_off, walled.free & west)
    told: list[torch.Tensor] = []
    monkeypatch.setattr(pictures, "start_map", lambda *given: told.extend(given[-3:-1]))
    row = torch.zeros(len(walled.starts), dtype=torch.int64)
    episodes = Episodes(walled.starts, row + Outcome.GOAL, row, row.float(), row, row == 0)
    Pictures(world.scene.gaussians, world.occupancy, walled, world.env(1), tmp_path).starts(episodes)
    blocked, cut_off = ({tuple(position) for position in positions.tolist()} for positions in told)
    assert cut_off == {tuple(position) for position in place[walled.cut_off].tolist()} and not cut_off & blocked
