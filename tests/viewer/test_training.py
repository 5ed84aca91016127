"""The viewer shows a training while it runs, and a trained policy."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

from splatrl.building import build_trainer, build_world
from splatrl.configuration import load_config, save_config
from splatrl.envs.tasks.base import Outcome
from splatrl.runs import load_policy
from splatrl.training import load_checkpoint
from splatrl.viewer import training
from splatrl.viewer.page import Page
from splatrl.viewer.rollout import Rollout
from splatrl.viewer.training import TrainingView
from tests.commands.test_train import SETTINGS
from tests.tiny import tiny_overrides
from tests.viewer.visitor import Visitor, until


def train(room: Path, name: str, watched: bool = False) -> Path:
    """Train in the room, watched or not; return the run folder."""
    cfg = load_config([*tiny_overrides(room), *SETTINGS, "collector.total_frames=512"])
    world, folder = build_world(cfg), room / name
    folder.mkdir()
    save_config(cfg, folder)
    trainer = build_trainer(cfg, world, folder)
    if watched:
        page = Page(world.scene, port=0)
        view = TrainingView(page, world, trainer)
        visitor = Visitor(page.address)
        visitor.find("BatchedMeshesMessage")
    trainer.fit()
    if watched:
        until(lambda: view.played > 8, "robots that move")
        assert "frames 512\n- level " in view.status.content and "test success" in view.status.content
        view.note({"frames": 640.0, "success": math.nan})  # no episode has ended, and there was no test
        assert "frames 640" in view.status.content and "test success" in view.status.content
        assert "nan" not in view.status.content
        visitor.close()
        view.close()
        page.close()
        assert not view._thread.is_alive()
    return folder


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of a training that nobody watched."""
    return train(tmp_path_factory.mktemp("room"), "trained")


def equal(a: Any, b: Any) -> bool:
    """Return whether nested values are equal, tensors in values and dtype."""
    if isinstance(a, torch.Tensor):
        return torch.equal(a, b) and a.dtype == b.dtype
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(equal(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(equal, a, b))
    return bool(a == b) or (a != a and b != b)


def test_a_watched_training_has_the_same_checkpoint_as_an_unwatched_one(
    trained: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "EVERY", 0.0)  # look at every batch
    monkeypatch.setattr(training, "RATE", 200)
    folders = (trained, train(trained.parent, "watched", watched=True))
    plain, watched = (load_checkpoint(folder / "checkpoints" / "last.pt") for folder in folders)
    for state in (plain, watched):
        state["seconds"] = 0.0
        state["history"]["seconds"][1].zero_()
    assert equal(plain["ppo"], watched["ppo"])
    assert equal(plain, watched)


@pytest.fixture
def rollout(trained: Path) -> Iterator[Rollout]:
    policy = load_policy(trained)
    page = Page(policy.world.scene, port=0)
    shown = Rollout(page, policy)
    shown.speed.value = 30
    yield shown
    shown.stop()
    page.close()


def test_a_policy_is_shown_from_start_to_end(rollout: Rollout, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rollout, "_wait", lambda: None)
    before = torch.random.get_rng_state()
    ends = [rollout.episode(number) for number in range(4)]
    assert Outcome.RUNNING not in ends and rollout.episodes == 4
    assert rollout.successes == ends.count(Outcome.GOAL)
    assert f"{rollout.successes} of 4 episodes succeeded" in rollout.status.content
    assert torch.equal(torch.random.get_rng_state(), before)
    places = rollout.shown.trail
    assert rollout.episode(3) is ends[3] and rollout.shown.trail == places  # the same number gives the same episode
    assert rollout.episode(2) is ends[2] and rollout.shown.trail != places


def test_a_rollout_can_be_paused_continued_and_stopped(rollout: Rollout) -> None:
    rollout.plays.value = False
    rollout.start()
    until(lambda: "step 0" in rollout.status.content, "the start")
    assert not rollout._stop.wait(0.3) and "step 0" in rollout.status.content
    rollout.plays.value = True
    until(lambda: "step 0" not in rollout.status.content, "a step")
    rollout.stop()
    assert not rollout._thread.is_alive()
