"""Frame stacking: views of several steps in one observation, which travel in the TensorDict."""

from typing import Any

import pytest
import torch
from torchrl.envs import Compose, EnvBase, ParallelEnv, StepCounter, ToTensorImage, TransformedEnv

from splatrl.envs.transforms import FrameStack, Latency
from tests.envs.transforms.test_contract import TransformedContract
from tests.envs.transforms.views import seeing_env

SPIN = 4


def stacked(batch: int = 3, seed: int = 0) -> TransformedEnv:
    return TransformedEnv(seeing_env((batch,), seed), Compose(FrameStack(3)))


class TestFrameStack(TransformedContract):
    def make(self, batch_size: tuple[int], seed: int = 0) -> EnvBase:
        return stacked(batch_size[0], seed)


def test_views_are_stacked_from_the_oldest_to_the_latest_and_begin_with_the_first_one() -> None:
    plain, env = seeing_env((3,)), stacked()
    now = plain.reset()
    td = env.reset(now.select("state"), set_state=True)
    seen = [now["pixels"]] * 3
    for _ in range(4):
        assert torch.equal(td["pixels"], torch.cat(seen, -1))
        action = torch.full((3,), SPIN)
        now, td = plain.step(now.set("action", action))["next"], env.step(td.set("action", action.clone()))["next"]
        seen = [*seen[1:], now["pixels"]]
    assert not torch.equal(seen[0], seen[2])


def test_a_step_depends_on_its_input_alone() -> None:
    env = stacked()
    td = env.rollout(4)[:, -1].exclude("next").set("action", torch.full((3,), SPIN))
    first = env.step(td.clone())["next", "pixels"]
    env.rollout(3)
    assert torch.equal(env.step(td.clone())["next", "pixels"], first)


def test_a_given_state_keeps_the_views_that_are_given_with_it() -> None:
    torch.manual_seed(0)  # actions with which no episode ends
    env = stacked()
    given = env.rollout(4)[:, -1].exclude("next", "action")
    again = env.reset(given.clone(), set_state=True)
    assert torch.equal(again["pixels"], given["pixels"])
    begun = env.reset(given.select("state"), set_state=True)
    assert torch.equal(begun["pixels"], given["pixels"][..., -3:].repeat(1, 1, 1, 3))
    assert not torch.equal(begun["pixels"], given["pixels"])


def test_worker_processes_receive_the_stack() -> None:
    envs = ParallelEnv(1, stacked, mp_start_method="fork")
    try:
        batch = envs.rollout(4, break_when_any_done=False)
        given = batch[..., -1].exclude("next", "action").clone()
        envs.rollout(2, break_when_any_done=False)
        assert torch.equal(envs.reset(given.clone(), set_state=True)["pixels"], given["pixels"])
    finally:
        envs.close()


def test_a_transform_that_changes_views_is_refused_outside_the_stack() -> None:
    env = TransformedEnv(seeing_env(), Compose(FrameStack(2), Latency()))
    with pytest.raises(ValueError, match=r"Latency: expected inside FrameStack, .* pixels"):
        env.rollout(2)
    TransformedEnv(seeing_env(), Compose(Latency(), FrameStack(2), StepCounter(step_count_key="n"))).rollout(2)


def test_an_input_without_the_stack_is_refused() -> None:
    env = stacked()
    td = env.reset().set("action", torch.full((3,), SPIN))
    wanted = r"pixels: expected the stack of the last 3 views, torch\.uint8 \[3, 12, 16, 9\], got "
    with pytest.raises(ValueError, match=wanted + "none"):
        env.step(td.exclude("pixels"))
    with pytest.raises(ValueError, match=wanted + r"torch\.uint8 \[3, 12, 16, 3\]"):
        env.reset(td.set("pixels", td["pixels"][..., :3]), set_state=True)
    outer = TransformedEnv(stacked(), ToTensorImage(in_keys=["pixels"]), auto_unwrap=False)
    with pytest.raises(ValueError, match=wanted + r"torch\.float32 \[3, 9, 12, 16\]"):
        outer.rollout(2)


@pytest.mark.parametrize("views", [0, -2, 1.5, "a", True])
def test_a_number_of_views_that_is_none_is_refused(views: Any) -> None:
    with pytest.raises(ValueError, match=r"^stack\.N: expected a whole number of at least 1, got"):
        FrameStack(views)
