"""Pretraining on pairs of views: a network learns to tell from where another view was seen."""

import math
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pytest
import torch
from omegaconf import DictConfig

from splatrl.building import build_model, build_trainer, build_world, trainers
from splatrl.configuration import load_config
from splatrl.envs.world import World, Worlds
from splatrl.made_with import check_made_with
from splatrl.training import Matcher, MatchingSettings, load_checkpoint, views
from splatrl.training.history import unpacked
from splatrl.training.matching import drawn, seen_from, views_of
from splatrl.waits import Bar, late_bar
from tests.two_rooms import in_both

FEW = ["task.nearest=0.3", "task.goals=6", "task.test_goals=3", "robot.body.radius=0.1"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[DictConfig, World | Worlds]:
    cfg = load_config([*in_both(tmp_path_factory.mktemp("rooms"), "imagenav"), *FEW])
    return cfg, build_world(cfg)


def test_seen_from_gives_a_pose_in_the_frame_of_another() -> None:
    here = torch.tensor([[1.0, 1.0, math.pi / 2], [0.0, 0.0, 0.0]])
    there = torch.tensor([[1.0, 3.0, math.pi], [-1.0, 2.0, 0.0]])
    expected = torch.tensor([[2.0, 0.0, 0.0, 1.0], [-1.0, 2.0, 1.0, 0.0]])
    torch.testing.assert_close(seen_from(here, there), expected, atol=1e-6, rtol=0.0)


def test_both_views_of_a_pair_show_one_scene_and_most_look_nearly_the_same_way() -> None:
    torch.manual_seed(0)
    count = 4000
    planar = torch.cat([torch.zeros(count, 2), math.tau * torch.rand(count, 1)], 1)
    scene = (torch.rand(count) < 0.3).long() + 2  # two scenes of different sizes; the first two have no views
    shown = views_of(torch.zeros(count, 1, 1, 3, dtype=torch.uint8), planar, scene)
    here, there = drawn(shown, 20_000)
    assert torch.equal(scene[here], scene[there])
    turn = planar[there, 2] - planar[here, 2]
    turn = torch.atan2(turn.sin(), turn.cos())
    for degrees in (15.0, 60.0, 120.0):
        share = float((turn.abs() < math.radians(degrees)).float().mean())
        assert share == pytest.approx((degrees / 180.0) ** (1 / 3), abs=0.02)
    assert float((turn > 0).float().mean()) == pytest.approx(0.5, abs=0.02)


def test_views_are_those_of_robots_and_of_their_goals(made: tuple[DictConfig, World | Worlds]) -> None:
    _, world = made
    shown = views(world.env(8, seed=3), 24)
    begun = [env.reset() for env in [world.env(8, seed=3)] for _ in range(3)]
    assert torch.equal(shown.image, torch.cat([one[key] for key in ("pixels", "imagegoal") for one in begun]))
    assert torch.equal(shown.planar, torch.cat([one[key] for key in ("state", "goal") for one in begun]))
    scene = torch.cat([one["scene"] for one in begun] * 2).squeeze(1)
    assert 0 < scene.sum() < 48
    here, there = drawn(shown, 500)
    assert torch.equal(scene[here], scene[there]) and (here != there).any()


def test_a_network_learns_to_tell_from_where_another_view_was_seen(made: tuple[DictConfig, World | Worlds]) -> None:
    cfg, world = made
    env = world.env(16, seed=3)
    shown, losses = views(env, 512), []
    for pairs in (64, 24_000):
        torch.manual_seed(0)
        losses.append(Matcher(build_model(cfg, env), MatchingSettings(512, pairs, 64, 2e-3)).fit(shown))
    assert losses[1] < 0.5 * losses[0]


def test_a_policy_that_reads_anything_else_is_refused(tmp_path: Path) -> None:
    cfg = load_config([*in_both(tmp_path, "pointnav"), *FEW])
    model = build_model(cfg, build_world(cfg).env(2))
    with pytest.raises(
        ValueError, match=r"matching\.frames: expected 0, or a policy that reads .* reads depth, pointgoal"
    ):
        Matcher(model, MatchingSettings(1, 1, 1, 1e-3))


def test_matching_frames_count_and_come_before_all_others(
    made: tuple[DictConfig, World | Worlds], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bars: list[str] = []

    def bar(what: str, total: int, unit: str) -> Bar:
        bars.append(what)
        return late_bar(what, total, unit)

    monkeypatch.setattr(trainers, "late_bar", bar)
    cfg = made[0].copy()
    cfg.merge_with_dotlist(
        ["matching.frames=64", "matching.pairs=256", "env.num_envs=16", "collector.total_frames=256"]
    )
    cfg.merge_with_dotlist(["dagger.rounds=1", "dagger.epochs=1", "dagger.frames_per_round=64"])
    cfg.merge_with_dotlist(["collector.frames_per_batch=128", "logger.num_test_episodes=4"])
    trainer = build_trainer(cfg, made[1], tmp_path)
    trainer.fit()
    first, second, third = trainer.history
    assert [row["frames"] for row in trainer.history] == [64, 128, 256]
    assert "loss_matching" in first and "loss_cloning" in second and "loss_objective" in third
    assert bars == ["test"] * 3, "each test has a bar, should it take long"


def test_a_training_stopped_after_matching_continues_there_with_the_same_bytes(
    made: tuple[DictConfig, World | Worlds], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracked: list[int] = []
    monkeypatch.setattr(trainers, "make_tracker", lambda *settings: tracked.append(settings[-1]))
    cfg = made[0].copy()
    cfg.merge_with_dotlist(["matching.frames=32", "matching.pairs=64", "env.num_envs=16", "collector.total_frames=128"])
    cfg.merge_with_dotlist(["dagger.rounds=2", "dagger.epochs=1", "dagger.frames_per_round=16"])
    cfg.merge_with_dotlist(["collector.frames_per_batch=64", "logger.num_test_episodes=4"])
    build_trainer(cfg, made[1], tmp_path / "whole").fit()
    stopped = build_trainer(cfg, made[1], tmp_path / "stopped")
    match, teach = stopped.prepare

    def stop() -> Iterator[dict[str, float]]:
        yield from islice(teach(), 1)
        raise KeyboardInterrupt

    stopped.prepare = [match, stop]
    with pytest.raises(KeyboardInterrupt):
        stopped.fit()
    torch.manual_seed(99)
    again = build_trainer(cfg, made[1], tmp_path / "stopped", check_made_with)
    assert len(again.prepare) == 1 and again.ppo.frames == 32 and not again.prepared
    assert tracked == [0, 0, 32], "a tracker replaces what it was told beyond these frames"
    again.fit()
    one, other = (load_checkpoint(tmp_path / name / "checkpoints" / "last.pt") for name in ("whole", "stopped"))
    assert all(torch.equal(value, other["ppo"]["model"][key]) for key, value in one["ppo"]["model"].items())
    rows = [[row | {"seconds": 0.0} for row in unpacked(state["history"])] for state in (one, other)]
    assert repr(rows[0]) == repr(rows[1]) and one["prepared"]  # nan equals nan


@pytest.mark.parametrize(("values", "name"), [((-1, 1, 1), "frames"), ((1, 0, 1), "pairs"), ((1, 1, 0), "mini_batch")])
def test_settings_out_of_range_are_named(values: tuple[int, int, int], name: str) -> None:
    with pytest.raises(ValueError, match=rf"matching\.{name}"):
        MatchingSettings(*values, 1e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("dagger.frames_per_round=17", r"dagger\.frames_per_round: expected a multiple of env\.num_envs = 4, got 17"),
        ("dagger.rounds=16", r"collector\.total_frames: expected at least 264, the sum of 8 of matching\.frames, 0"),
        ("cloning.lr=-1", r"cloning\.lr: expected a number of at least 0\.0, got -1"),
    ],
)
def test_settings_of_imitation_are_checked_before_the_matching(
    change: str, message: str, made: tuple[DictConfig, World | Worlds], tmp_path: Path
) -> None:
    cfg = made[0].copy()
    cfg.merge_with_dotlist(["matching.frames=8", "dagger.rounds=2", "dagger.frames_per_round=16", "env.num_envs=4"])
    cfg.merge_with_dotlist(["collector.frames_per_batch=16", "collector.total_frames=256"])
    cfg.merge_with_dotlist(["logger.num_test_episodes=4", change])
    with pytest.raises(Exception, match=message):  # Hydra wraps what constructors raise
        build_trainer(cfg, made[1], tmp_path)
    assert not any(tmp_path.iterdir())
