"""A robot that is driven by hand, and the demonstrations that this yields."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from splatrl.datasets import planner_episodes, replay
from splatrl.envs.tasks.base import Outcome
from splatrl.envs.world import World
from splatrl.viewer.driver import Driver
from splatrl.viewer.takes import Takes


def drive(driver: Driver, world: World, most: int = 60) -> None:
    """Follow shortest paths to the end of the episode."""
    for _ in range(most):
        best = world.plan.optimal(driver.state)[0].nonzero()[0]
        driver.act(world.plan.actions[best[0]])
        if driver.done:
            return


@pytest.mark.parametrize(
    "task",
    [
        "grid",
        pytest.param("fps", marks=pytest.mark.slow),
        "drive",
        pytest.param("apple", marks=pytest.mark.slow),
        pytest.param("polar_plane", marks=pytest.mark.slow),
    ],
)
def test_episodes_driven_to_the_goal_are_replayed_byte_for_byte(
    make_world: Callable[..., World], task: str, tmp_path: Path
) -> None:
    world = make_world(task)
    takes = Takes(world, tmp_path, {})
    driver = Driver(world, seed=3, kept=takes.add)
    for _ in range(40):
        drive(driver, world)
        if len(takes.episodes) == 3:
            break
        driver.begin()
    found = takes.demonstrations()
    found.check()
    assert len(found.starts) == 3
    planned = planner_episodes(world, 2).frames.exclude("optimal")  # which only the planner knows
    assert set(found.frames.keys(True, True)) == set(planned.keys(True, True))
    for key, value in planned.items(True, True):
        assert (found.frames[key].dtype, found.frames[key].shape[1:]) == (value.dtype, value.shape[1:]), key
    different, views = replay(world, found)
    assert different == [] and views == len(found)


def test_a_blocked_robot_stays_and_its_episode_ends(world: World) -> None:
    driver = Driver(world)
    before, states = None, []
    for _ in range(20):
        before = driver.state.clone()
        driver.act(torch.tensor(0))
        states.append(driver.state)
        if driver.done:
            break
    assert driver.outcome in (Outcome.COLLISION, Outcome.OUT_OF_BOUNDS)
    assert not driver.succeeded and driver.reward == -10.0
    assert torch.equal(driver.state, before)
    assert driver.episode_return == pytest.approx(-10.0 - 0.2 * (driver.steps - 1), abs=1e-4)


def test_a_key_after_the_end_starts_another_episode(world: World) -> None:
    driver = Driver(world, seed=1)
    drive(driver, world)
    assert driver.done and driver.steps > 0
    driver.act(torch.tensor(4))
    assert not driver.done and driver.steps == 0 and driver.outcome is Outcome.RUNNING


def test_again_restarts_the_episode_from_the_same_start(make_world: Callable[..., World]) -> None:
    world = make_world("snake")
    driver = Driver(world, seed=5)
    start, target, view = driver.state.clone(), driver.now["target"].clone(), driver.pixels.clone()
    for _ in range(3):
        driver.act(torch.tensor(2))
    assert not torch.equal(driver.state, start)
    driver.again()
    assert torch.equal(driver.state, start) and torch.equal(driver.now["target"], target)
    assert torch.equal(driver.pixels, view) and driver.steps == 0


def test_only_successful_episodes_are_kept_and_the_last_can_be_discarded(world: World, tmp_path: Path) -> None:
    takes = Takes(world, tmp_path, {})
    with pytest.raises(ValueError, match="by=keys: expected at least one episode that reached the goal"):
        takes.demonstrations()
    assert not takes.discard()
    driver = Driver(world, kept=takes.add)
    for _ in range(20):
        driver.act(torch.tensor(0))  # into a wall or out of bounds
        if driver.done:
            break
    assert takes.episodes == []
    driver.begin()
    drive(driver, world)
    assert len(takes.episodes) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["1.pt"]
    assert takes.discard() and takes.episodes == [] and not list(tmp_path.iterdir())
