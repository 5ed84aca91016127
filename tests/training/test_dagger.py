"""DAgger: the planner labels the states that a policy visits, and the policy learns from them."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from omegaconf import DictConfig
from torch import Tensor
from torchrl.data import Bounded, Categorical

from splatrl.building import build_model, build_trainer, build_world
from splatrl.configuration import load_config
from splatrl.datasets import Imitation, planner_episodes
from splatrl.envs.world import World, Worlds
from splatrl.evaluation import run_episodes
from splatrl.training import PPO, Cloner, CloningSettings, DaggerSettings, LossSettings, OptimSettings, targets, visited
from splatrl.training.collectors import HostCollector
from tests.tiny import tiny_overrides
from tests.two_rooms import in_both

LOSS = LossSettings(0.97, 0.9, 0.2, 1, 64, 0.5, 0.01, True, 0.1)
OPTIM = OptimSettings(1e-3, 1e-5, 0.5, True)


@pytest.fixture(
    scope="module",
    params=["gru", pytest.param("none", marks=pytest.mark.slow), pytest.param("stack", marks=pytest.mark.slow)],
)
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[DictConfig, World]:
    cfg = load_config([*tiny_overrides(tmp_path_factory.mktemp("room")), f"memory={request.param}"])
    return cfg, build_world(cfg)


def make_ppo(cfg: DictConfig, world: World | Worlds, total: int = 10_000) -> PPO:
    torch.manual_seed(0)
    env = world.env(16)
    return PPO(env, build_model(cfg, env), LOSS, OPTIM, 128, total)


def test_states_that_the_policy_visits_are_labelled_by_the_planner(made: tuple[DictConfig, World]) -> None:
    cfg, world = made
    ppo = make_ppo(cfg, world)
    torch.manual_seed(1)
    batch = HostCollector(world.env(16, seed=5), ppo.model, 24).collect()
    torch.manual_seed(1)
    found = visited(world.env(16, seed=5), ppo.learner, [world.plan], 384)
    rows = batch.flatten(0, 1)
    assert torch.equal(found["pixels"], rows["pixels"])
    assert torch.equal(found["target"] > 0, world.plan.optimal(rows["state"]))
    torch.testing.assert_close(found["target"].sum(1), torch.ones(384))
    begins = (found["frame"] == 0).nonzero().squeeze(1)
    assert set(range(0, 384, 24)) <= set(begins.tolist()), "each robot begins an episode"
    ended = rows["next", "done"].squeeze(1).nonzero().squeeze(1)
    assert {row + 1 for row in ended.tolist() if (row + 1) % 24} == {row for row in begins.tolist() if row % 24}
    for row in ended[rows["next", "terminated"].squeeze(1)[ended]][:5].tolist():
        assert found["value_target"][row] == pytest.approx(0.1 * float(rows["next", "reward"][row])), "its last reward"


def test_a_policy_learns_from_its_own_mistakes(made: tuple[DictConfig, World]) -> None:
    cfg, world = made
    ppo, starts = make_ppo(cfg, world), world.plan.starts[::4]
    cloner = Cloner(ppo.model, CloningSettings(8, 64, 3e-3, 0.5))
    reached, frames, env = [], [], world.env(30)
    shown = planner_episodes(world, 6)
    for row in Imitation(ppo, cloner, world, lambda: [shown], DaggerSettings(3, 320, 6), 1)():
        assert row.keys() == {"loss_cloning"}
        frames.append(ppo.frames)
        if len(frames) in (1, 4):
            reached.append(float(run_episodes(env, ppo.model.get_policy_operator(), starts).success.double().mean()))
    assert frames == [len(shown), len(shown) + 320, len(shown) + 640, len(shown) + 960]
    assert reached[-1] > max(0.65, reached[0] + 0.3)


def test_in_several_scenes_each_frame_is_labelled_by_its_own_scenes_planner(tmp_path: Path) -> None:
    settings = ["demos=3", "cloning.epochs=1", "dagger.rounds=1", "dagger.epochs=1", "collector.frames_per_batch=128"]
    cfg = load_config([*in_both(tmp_path), *settings, "collector.total_frames=256", "logger.num_test_episodes=2"])
    world = build_world(cfg)
    build_trainer(cfg, world, tmp_path / "run").fit()
    west, east = (one.plan for one in world.worlds)
    ppo = make_ppo(cfg, world)
    torch.manual_seed(1)
    rows = HostCollector(world.env(16, seed=5), ppo.model, 8).collect().flatten(0, 1)
    torch.manual_seed(1)
    found = visited(world.env(16, seed=5), ppo.learner, [west, east], 128)["target"] > 0
    here = rows["scene"].squeeze(1) == 1
    assert here.any() and not here.all()
    assert torch.equal(found[here], east.optimal(rows["state"][here]))
    assert torch.equal(found[~here], west.optimal(rows["state"][~here]))


def test_a_teacher_labels_discrete_actions(tmp_path: Path) -> None:
    cfg = load_config([*in_both(tmp_path, "pointnav"), "task.goals=8", "task.test_goals=3"])
    world = build_world(cfg)
    ppo = make_ppo(cfg, world)
    found = visited(
        world.env(16, seed=5), ppo.learner, [one.plan for one in world.worlds], 1024, ("depth",), guided=1.0
    )
    assert found["target"].shape == (1024, 4)
    assert ((found["target"] == 0) | (found["target"] == 1)).all() and (found["target"].sum(1) == 1).all()
    ends = (found["frame"] == 0).nonzero().squeeze(1)[1:] - 1
    stops = found["target"][ends, 0] == 1
    assert stops.sum() >= 8  # the teacher's episodes end with a stop, except those that the batch cuts off
    assert not (found["target"][found["frame"] == 0][:, 0] == 1).any()  # goals are further away than that


def test_dagger_may_begin_with_an_untrained_policy(made: tuple[DictConfig, World]) -> None:
    cfg, world = made
    ppo = make_ppo(cfg, world)
    (row,) = Imitation(
        ppo, Cloner(ppo.model, CloningSettings(1, 64, 1e-3, 0.5)), world, None, DaggerSettings(1, 64, 2), 0
    )()
    assert ppo.frames == 64 and row["loss_cloning"] < 1.8


def test_rounds_begin_where_an_episode_is_long_enough(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cfg = load_config([*tiny_overrides(tmp_path), "task.max_steps=2"])
    with pytest.warns(UserWarning, match="training leaves them out"):
        world = build_world(cfg)
    ppo, begun = make_ppo(cfg, world), list[Tensor]()
    cloner = Cloner(ppo.model, CloningSettings(1, 64, 1e-3, 0.5))

    def passes(known: dict[str, Tensor], *_: int) -> Iterator[float]:
        begun.append(known["state"][known["frame"] == 0])
        yield 0.0

    monkeypatch.setattr(cloner, "reads", ("state",))
    monkeypatch.setattr(cloner, "passes", passes)
    list(Imitation(ppo, cloner, world, None, DaggerSettings(1, 64, 1), 0)())
    assert len(begun[0]) >= 16 and world.plan.cost_to_go(begun[0]).max() <= 2


@pytest.mark.parametrize("guided", [1.0, 0.5])
def test_the_teacher_controls_a_fraction_of_the_robots(
    made: tuple[DictConfig, World], guided: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    cfg, world = made
    ppo, batches = make_ppo(cfg, world), []
    collect = HostCollector.collect
    monkeypatch.setattr(HostCollector, "collect", lambda self: batches.append(collect(self)) or batches[-1])
    torch.manual_seed(2)
    visited(world.env(16, seed=5), ppo.learner, [world.plan], 320, guided=guided)
    (batch,) = batches
    right = world.plan.optimal(batch["state"].flatten(0, 1)).gather(1, batch["action"].flatten().unsqueeze(1))
    by_robot = right.view(16, 20).float().mean(1)
    drives = by_robot == 1.0
    assert drives.all() if guided == 1.0 else 3 < drives.sum() < 14 and by_robot[~drives].mean() < 0.7


def test_the_policy_is_fitted_once_more_after_the_last_round(made: tuple[DictConfig, World]) -> None:
    cfg, world = made
    ppo = make_ppo(cfg, world)
    cloner, fits = Cloner(ppo.model, CloningSettings(1, 64, 1e-3, 0.5)), []
    passes = cloner.passes
    cloner.passes = lambda shown, *args: fits.append((len(shown["frame"]), *args)) or passes(shown, *args)  # type: ignore
    rows = list(Imitation(ppo, cloner, world, None, DaggerSettings(2, 64, 1, last_epochs=3), 0)())
    assert len(rows) == 3 and ppo.frames == 128
    assert fits == [(64, 1, False, 0), (128, 1, False, 0), (128, 3, True, 0)]


def test_targets_are_divided_equally_among_all_optimal_actions() -> None:
    optimal = torch.tensor([[True, False, True], [False, True, False], [False, False, False]])
    found = targets(optimal, torch.tensor([3, 0, 1]), Categorical(4))
    assert found[:2].tolist() == [[0.0, 0.5, 0.0, 0.5], [1.0, 0.0, 0.0, 0.0]]
    assert found[2].isnan().all()


def test_the_target_is_drawn_from_the_optimal_continuous_actions() -> None:
    actions = torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    optimal = torch.tensor([[True, False, True]]).repeat(200, 1)
    optimal[7] = False
    torch.manual_seed(0)
    found = targets(optimal, actions, Bounded(-1.0, 1.0, shape=(2,)))
    assert found[7].isnan().all()
    drawn = torch.cat([found[:7], found[8:]])
    shares = [(drawn == action).all(1).float().mean() for action in actions]
    assert shares[0] == pytest.approx(0.5, abs=0.1) and shares[1] == 0.0 and sum(shares) == 1.0


def test_a_policy_with_continuous_actions_learns_what_the_planner_would_do(tmp_path: Path) -> None:
    cfg = load_config([*tiny_overrides(tmp_path, "drive"), "task.motion.spacing=0.5"])
    world = build_world(cfg)
    ppo, shown = make_ppo(cfg, world), planner_episodes(world, 4)
    assert "optimal" not in shown.frames.keys(), "it has no names"  # noqa: SIM118, a TensorDict is no dict
    cloner = Cloner(ppo.model, CloningSettings(10, 64, 1e-3, 0.5))
    losses = [
        row["loss_cloning"] for row in Imitation(ppo, cloner, world, lambda: [shown], DaggerSettings(1, 128, 20), 1)()
    ]
    assert ppo.frames == len(shown) + 128 and min(losses) > 0
    found = visited(world.env(16, seed=5), ppo.learner, [world.plan], 128)
    known = ~found["target"].isnan().any(1)
    assert known.float().mean() > 0.9
    drawn = found["target"][known].unsqueeze(1) == world.plan.actions
    assert drawn.all(2).any(1).all(), "each is one of the planner's"


def test_frame_counts_that_do_not_fit_are_refused(made: tuple[DictConfig, World]) -> None:
    cfg, world = made
    ppo = make_ppo(cfg, world, total=256)
    cloner = Cloner(ppo.model, CloningSettings(1, 64, 1e-3, 0.5))
    for settings, message in (
        (DaggerSettings(1, 100, 1), "dagger.frames_per_round: expected a multiple of env.num_envs = 16, got 100"),
        (DaggerSettings(3, 128, 1), "collector.total_frames: expected at least 384, the sum of 0 frames of demos"),
    ):
        with pytest.raises(ValueError, match=message):
            next(Imitation(ppo, cloner, world, None, settings, 0)())


@pytest.mark.parametrize(
    ("values", "name"), [((-1, 32, 1), "rounds"), ((1, 0, 1), "frames_per_round"), ((1, 32, 0.5), "epochs")]
)
def test_settings_out_of_range_are_named(values: tuple[int, int, int], name: str) -> None:
    with pytest.raises(ValueError, match=f"dagger.{name}: expected a whole number"):
        DaggerSettings(*values)
