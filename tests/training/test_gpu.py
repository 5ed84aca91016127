"""Training on a GPU: rollouts that never synchronise, their CUDA graph, checkpoints and the commands."""

import copy
import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from splatrl.building import build_trainer, build_world
from splatrl.configuration import load_config
from splatrl.curriculum import Curriculum
from splatrl.envs import World
from splatrl.training import PPO, Cloner, CloningSettings, actor_critic, load_checkpoint, save_checkpoint
from splatrl.training.collectors import DeviceCollector
from splatrl.training.cuda_graph import CudaGraph
from tests.commands.test_train import UNFILMED, command, finish
from tests.tiny import tiny_overrides
from tests.training.test_ppo import LOSS, OPTIM, parameters

pytestmark = pytest.mark.gpu

WORLDS = {
    "grid": ["grid"],
    "fps": ["fps"],
    "drive": ["drive"],
    "remembering fps": ["fps", "memory=gru"],
    "late pointnav": ["pointnav", "transforms/latency=varied", "sensors=[rgb,depth,pointgoal]"],
    "stacking sim2real": ["sim2real", "memory=stack", "transforms/pose_noise=unsteady", "transforms/appearance=varied"],
}
ROBOTS, STEPS = 16, 6


def overrides(folder: Path, name: str) -> list[str]:
    task, *more = WORLDS[name]
    room = [*tiny_overrides(folder, task), *more, "task.max_steps=7", "collision=auto"]
    return [*(override for override in room if override != "device=cpu"), "device=cuda"]


@pytest.fixture(scope="module")
def worlds(tmp_path_factory: pytest.TempPathFactory, cuda_device: torch.device) -> dict[str, World]:
    """Build all worlds, with the GPU's renderer and checker."""
    folder = tmp_path_factory.mktemp("room")
    return {name: build_world(load_config(overrides(folder, name))) for name in WORLDS}


def learner(world: World, memory: int, seed: int = 0, cuda_graph: bool | None = None) -> PPO:
    env = world.env(ROBOTS, Curriculum(world.plan, 3, threshold=0.01, window=7), seed)
    torch.manual_seed(seed)
    shape = env.observation_spec["pixels"].shape[1:]
    model = actor_critic(shape, env.action_spec, 1, (8, 16), 32, memory).to(env.device)
    return PPO(env, model, LOSS, OPTIM, ROBOTS * STEPS, 10**6, cuda_graph)


def memory_of(name: str) -> int:
    return 128 if "memory=gru" in WORLDS[name] else 0


@pytest.mark.parametrize("name", WORLDS)
def test_a_rollout_and_its_gradient_steps_never_synchronise(worlds: dict[str, World], name: str) -> None:
    ppo = learner(worlds[name], memory_of(name), cuda_graph=False)
    ppo.iterate()  # one-off setup is done
    torch.cuda.set_sync_debug_mode("error")
    try:
        batch = ppo.collector.collect()
        batch["advantage"] = batch["value_target"] = batch["state_value"]
        for frames in ppo.learner.minibatches(batch):
            ppo.learner.step(frames)
    finally:
        torch.cuda.set_sync_debug_mode("default")


@pytest.mark.parametrize("name", WORLDS)
def test_a_rollout_by_cuda_graph_equals_one_without(worlds: dict[str, World], name: str) -> None:
    batches = []
    for cuda_graph in (False, None):
        ppo = learner(worlds[name], memory_of(name), cuda_graph=cuda_graph)
        assert isinstance(ppo.collector, DeviceCollector)
        assert isinstance(ppo.collector._advance, CudaGraph) == (cuda_graph is None)
        torch.manual_seed(3)
        batches.append([ppo.collect().clone() for _ in range(4)])
    for eager, captured in zip(*batches, strict=True):
        for key in eager.keys(True, True):
            assert torch.equal(eager[key], captured[key]), key
    assert batches[0][-1]["next", "done"].any()


@pytest.mark.parametrize("name", ["grid", "drive", "remembering fps"])
def test_learning_by_cuda_graph_equals_learning_without(worlds: dict[str, World], name: str) -> None:
    found = []
    for cuda_graph in (False, None):
        ppo = learner(worlds[name], memory_of(name), cuda_graph=cuda_graph)
        torch.manual_seed(3)
        reports = [ppo.iterate() for _ in range(4)]
        found.append((reports[-1]["loss_critic"], parameters(ppo)))
    torch.testing.assert_close(*(weights for _, weights in found), atol=1e-4, rtol=1e-3)
    assert found[1][0] == pytest.approx(found[0][0], rel=1e-2)


def test_a_policy_with_memory_imitates_as_on_a_cpu(worlds: dict[str, World], cuda_device: torch.device) -> None:
    ppo = learner(worlds["remembering fps"], memory_of("remembering fps"))
    lengths, actions = (5, 1, 7, 3), ppo.env.action_spec.space.n
    shown = {
        "pixels": torch.randint(256, (16, *ppo.env.observation_spec["pixels"].shape[1:])).byte(),
        "target": torch.eye(actions)[torch.randint(actions, (16,))],
        "value_target": torch.rand(16),
        "frame": torch.cat([torch.arange(length) for length in lengths]),
    }
    losses = []
    for device, frames_on in (("cpu", "cpu"), (cuda_device, "cpu"), (cuda_device, cuda_device)):
        torch.manual_seed(2)
        cloner = Cloner(copy.deepcopy(ppo.model).to(device), CloningSettings(1, 6, 1e-3, 0.5))
        losses.append([cloner.fit({key: value.to(frames_on) for key, value in shown.items()}) for _ in range(3)])
    assert losses[1] == pytest.approx(losses[0], rel=1e-3)
    assert losses[2] == pytest.approx(losses[1], rel=1e-5)


@pytest.mark.parametrize("name", WORLDS)
def test_a_few_hundred_frames_change_the_weights_and_advance_the_curriculum(
    worlds: dict[str, World], name: str
) -> None:
    ppo = learner(worlds[name], memory_of(name))
    schedule = ppo.env.curriculum.schedule
    ppo.env.curriculum.schedule = replace(schedule, window=1000)  # so that failures alone do not begin another cohort
    before = parameters(ppo)
    reports = [ppo.iterate() for _ in range(5)]
    assert all(math.isfinite(report["loss_critic"]) and math.isfinite(report["entropy"]) for report in reports)
    assert (parameters(ppo) - before).abs().max() > 1e-4
    assert sum(report["episodes"] for report in reports) > 10
    assert ppo.env.curriculum.progress.sum() > 0


@pytest.mark.parametrize("name", ["grid", "remembering fps"])
def test_a_training_resumed_from_a_checkpoint_collects_the_same_frames(
    worlds: dict[str, World], name: str, tmp_path: Path
) -> None:
    whole = learner(worlds[name], memory_of(name))
    whole.iterate()
    save_checkpoint(tmp_path / "last.pt", whole.state_dict())
    expected = whole.collect().clone()
    resumed = learner(worlds[name], memory_of(name), seed=1)
    resumed.iterate()
    resumed.load_state_dict(load_checkpoint(tmp_path / "last.pt"))
    got = resumed.collect()
    for key in expected.keys(True, True):
        assert torch.equal(got[key], expected[key]), key


def test_the_loss_can_be_compiled(worlds: dict[str, World], tmp_path: Path) -> None:
    small = ["collector.frames_per_batch=96", "env.num_envs=16", "loss.mini_batch_size=64", "loss.ppo_epochs=2"]
    cfg = load_config([*overrides(tmp_path, "grid"), *small, "collector.total_frames=288", "optim.compile=true"])
    trainer = build_trainer(cfg, worlds["grid"], tmp_path)
    assert math.isfinite(trainer.ppo.iterate()["loss_critic"])


def test_a_run_on_a_gpu_is_evaluated_there_and_on_a_cpu(cuda_device: torch.device, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    said = finish(command("train", *overrides(tmp_path, "grid"), *UNFILMED, f"hydra.run.dir={folder}"))
    assert f"device: cuda ({torch.cuda.get_device_name()})" in said
    here = json.loads((folder / "evaluation.json").read_text())
    assert here["frames"] == 1280
    finish(command("evaluate", f"run={folder}", "video=false", "device=cpu"))
    there = json.loads((folder / "evaluation.json").read_text())
    assert abs(there["success_rate"] - here["success_rate"]) < 0.2
