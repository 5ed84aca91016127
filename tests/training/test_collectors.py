"""A rollout that stays on the device equals TorchRL's, never synchronises, and can be replayed."""

import math
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.modules import ActorValueOperator

from splatrl.curriculum import Curriculum
from splatrl.device_faults import FaultFlag
from splatrl.envs import SplatEnv
from splatrl.envs.drawing import SceneDrawing
from splatrl.envs.restart import restart
from splatrl.training import PPO, actor_critic
from splatrl.training.collectors import CHOSEN, ENDS, DeviceCollector, HostCollector, device_collector
from splatrl.training.cuda_graph import CudaGraph
from splatrl.training.memory import STATE, Memory
from tests.envs.contract import assert_same, base_env
from tests.envs.devices import NoHostReads, NoTransfers, Painter, pretend_device
from tests.envs.test_device import NAMES, made, whole_overlay
from tests.tiny import BlockChecker, tiny_env, tiny_plan, tiny_robot, tiny_task
from tests.training.tape import Taped
from tests.training.test_ppo import LOSS, OPTIM, assert_resumes

__all__ = ["whole_overlay"]

FEATURES = 8
ROBOTS = 7


def network(env: EnvBase, remembers: bool) -> ActorValueOperator:
    """Make a small model that evaluates its memory step by step, as on a GPU."""
    torch.manual_seed(1)
    shape = env.observation_spec["pixels"].shape[1:]
    model = actor_critic(shape, env.action_spec, 1, (4, 4), FEATURES, FEATURES if remembers else 0)
    for part in model.modules():
        if isinstance(part, Memory):
            part.stepwise = True
    return model


def pair(name: str) -> tuple[EnvBase, ActorValueOperator]:
    """Make an env of a world, and a model for it."""
    if name == "remembering fps":  # the model's memory must be as large as the world's
        env = made("remembering fps", ROBOTS)
        memory = env.observation_spec["recurrent_state"].shape[-1]
        torch.manual_seed(1)
        shape = env.observation_spec["pixels"].shape[1:]
        model = actor_critic(shape, env.action_spec, 1, (4, 4), FEATURES, memory)
        next(part for part in model.modules() if isinstance(part, Memory)).stepwise = True
        return env, model
    env = made(name, ROBOTS)
    return env, network(env, False)


def reset_in_every_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make TorchRL's rollout reset in every step, as ``DeviceCollector`` does, and not only if any robot is done."""

    def always(env: EnvBase, td: TensorDictBase) -> bool:
        td.set("_reset", td["done"].clone())
        return True

    monkeypatch.setattr(EnvBase, "any_done", always)


def assert_same_frames(batch: TensorDictBase, expected: TensorDictBase) -> None:
    """Assert that everything in a device's batch equals the same entry of TorchRL's batch."""
    counted = ["collisions"] if "collisions" in set(expected["next"].keys()) else []
    keys = [key for key in ("pixels", STATE, "is_init", *CHOSEN) if key in set(batch.keys())] + [
        ("next", key) for key in (*ENDS, *counted)
    ]
    assert {"pixels", "action"} <= set(keys)
    for key in keys:
        assert torch.equal(batch[key], expected[key]), key


def two_batches(
    name: str, make: Callable[[EnvBase, ActorValueOperator], HostCollector | DeviceCollector], watch: bool = False
) -> tuple[list[TensorDictBase], Tensor, Tensor]:
    """Collect two batches, with learning in between; also return curriculum progress and generator state."""
    env, model = pair(name)
    torch.manual_seed(3)
    collector = make(env, model)
    if isinstance(collector, DeviceCollector):  # it resets after each step, ``HostCollector`` before
        collector.carried = restart(env, collector.carried)
    batches = []
    for weight in (1.0, 1.1):  # learning changes weights in place, and the curriculum advances
        for parameter in model.parameters():
            parameter.data.mul_(weight)
        with NoHostReads() if watch else nullcontext():
            batch = collector.collect()
        batches.append(batch.clone())
    return batches, base_env(env).curriculum.progress.clone(), base_env(env).generator.get_state()


@pytest.mark.usefixtures("whole_overlay")
@pytest.mark.parametrize("name", NAMES)
def test_a_rollout_equals_torchrls_without_host_reads_and_can_be_replayed(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    reset_in_every_step(monkeypatch)
    expected, _, _ = two_batches(name, partial(HostCollector, steps=6))
    eager, progress, drawn = two_batches(name, partial(DeviceCollector, steps=6), watch=True)
    replayed, progress_again, drawn_again = two_batches(name, partial(DeviceCollector, steps=6, capture=Taped))
    assert torch.cat(expected, 1)["next", "done"].any(0).sum() >= 2
    for theirs, mine, again in zip(expected, eager, replayed, strict=True):
        assert mine.shape == (ROBOTS, 6)
        assert_same_frames(mine, theirs)
        assert_same(mine, again)
    assert progress[1] > 0 and torch.equal(progress, progress_again)
    assert torch.equal(drawn, drawn_again)


@pytest.mark.parametrize("name", NAMES)
def test_a_rollout_fetches_nothing_from_the_cpu(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    _, model = pair(name)
    pretend_device(monkeypatch)
    elsewhere = made(name, ROBOTS, "meta")
    for part in model.modules():  # the limits of actions are not parameters
        if hasattr(part, "distribution_kwargs"):
            part.distribution_kwargs = {key: value.to("meta") for key, value in part.distribution_kwargs.items()}
    collector = DeviceCollector(elsewhere, model.to("meta"), 1, begin=elsewhere._reset(set_state=False))
    collector.collect()
    with NoTransfers():
        batch = collector.collect()
    assert {value.device.type for value in batch.values(True, True)} == {"meta"}


def settled(on_device: bool = True, seed: int = 0, **options: object) -> PPO:
    """Make PPO in the tiny room, on a CPU but with the code path of a GPU."""
    env = tiny_env([6], seed, max_steps=4, first=1, threshold=0.01, window=5)
    torch.manual_seed(seed)
    model = actor_critic(env.observation_spec["pixels"].shape[1:], env.action_spec, 1, (8, 16), 32)
    return PPO(env, model, LOSS, OPTIM, 6 * 13, 10**6, on_device=on_device, **options)


def test_advantages_match_those_of_torchrls_rollout(monkeypatch: pytest.MonkeyPatch) -> None:
    reset_in_every_step(monkeypatch)
    found = []
    for on_device in (False, True):
        ppo = settled(on_device)
        if on_device:
            ppo.collector.carried = restart(ppo.env, ppo.collector.carried)
        torch.manual_seed(4)
        batch = ppo.collect()
        assert (batch.get("next_value", None) is not None) == on_device
        assert batch["next", "truncated"][:, :-1].any() and batch["next", "terminated"].any()
        found.append(ppo.learner.advantages(batch))
    for expected, got in zip(*found, strict=True):
        torch.testing.assert_close(got, expected, atol=1e-5, rtol=1e-5)


def test_minibatches_hold_images_pooled_as_in_collection() -> None:
    batch = settled().collect()
    assert batch.get("image", None) is None and batch["pixels"].dtype == torch.uint8
    ppo = settled()
    batch["advantage"], batch["value_target"] = ppo.learner.advantages(batch)
    torch.manual_seed(0)
    parts = list(ppo.learner.minibatches(batch))
    torch.manual_seed(0)
    batch["image"] = ppo.learner._pool(batch["pixels"])
    for part, expected in zip(parts, ppo.learner.minibatches(batch), strict=True):
        assert part.keys() == expected.keys()
        assert all(torch.equal(part[key], expected[key]) for key in part)


@pytest.mark.parametrize(("side", "kept"), [(2, "image"), (1, "pixels")])
def test_a_rollout_keeps_images_pooled_or_not_whichever_is_smaller(side: int, kept: str) -> None:
    curriculum = Curriculum(tiny_plan())
    robot = replace(tiny_robot(), image_width=20, image_height=18)
    env = SplatEnv(SceneDrawing(Painter()), BlockChecker(), robot, tiny_task(), curriculum, [3], 0)
    model = actor_critic((18, 20, 3), env.action_spec, side, (4, 4), FEATURES)
    batch = DeviceCollector(env, model, 5).collect()
    assert {"image", "pixels"} & set(batch.keys()) == {kept}
    assert len(batch["image" if side == 2 else "pixels"].flatten(0, 1).unique(dim=0)) > 2
    frames = PPO(env, model, LOSS, OPTIM, 15, 100, on_device=True).learner.minibatches(
        batch.set("advantage", batch["state_value"]).set("value_target", batch["state_value"])
    )
    assert all(part["image"].shape[1:] == (18 // side, 20 // side, 3) for part in frames)


def test_a_gradient_step_reads_nothing_on_the_host() -> None:
    ppo = settled()
    batch = ppo.collect()
    batch["advantage"], batch["value_target"] = ppo.learner.advantages(batch)
    with NoHostReads():
        for frames in ppo.learner.minibatches(batch):
            ppo.learner.step(frames)


def test_a_resumed_training_is_byte_for_byte_the_same(tmp_path: Path) -> None:
    assert_resumes(settled(), settled(seed=1), tmp_path / "last.pt")


def test_a_checkpoint_from_another_device_is_refused() -> None:
    state = settled().state_dict() | {"device": "cuda"}
    with pytest.raises(ValueError, match="device: expected cuda, on which the checkpoint was made, got cpu"):
        settled().load_state_dict(state)


def test_ppo_learns_with_the_device_collector() -> None:
    env = tiny_env([64], max_steps=20, first=2, threshold=1.0, window=10**6)
    torch.manual_seed(0)
    model = actor_critic(env.observation_spec["pixels"].shape[1:], env.action_spec, 1, (8, 16), 32)
    loss = LOSS.__class__(**{**vars(LOSS), "ppo_epochs": 8, "mini_batch_size": 128})
    optim = OPTIM.__class__(**{**vars(OPTIM), "lr": 3e-3, "anneal_lr": True})
    ppo = PPO(env, model, loss, optim, 768, 768 * 7, on_device=True)
    success = [ppo.iterate()["success"] for _ in range(7)]
    assert sum(success[:2]) / 2 < 0.45
    assert sum(success[-3:]) / 3 > 0.7
    assert not any(math.isnan(value) for value in success)


def test_faults_of_a_rollout_are_raised_after_it() -> None:
    class Refusing(Painter):
        fault = FaultFlag("cpu")

        def raise_faults(self) -> None:
            row = self.fault.take()
            if row is not None:
                raise ValueError(f"row {row}")

    ppo = settled()
    ppo.env.drawing.renderer = Refusing()
    ppo.collect()
    ppo.env.drawing.renderer.fault.flag.fill_(3)
    with pytest.raises(ValueError, match="row 3"):
        ppo.collect()


def test_a_cuda_graph_is_refused_without_cuda_and_left_out_unless_required() -> None:
    env = made("grid", 3)
    with pytest.raises(ValueError, match=r"collector\.cuda_graph: expected an env on a CUDA device .* got Painter and"):
        device_collector(env, network(env, False), 4, True)
    for choice in (None, False):
        collector = device_collector(env, network(env, False), 4, choice)
        assert not isinstance(collector._advance, CudaGraph)
