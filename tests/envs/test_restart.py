"""Automatic resets equal those of TorchRL."""

import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp

from splatrl.envs.restart import where_marked, with_rows
from splatrl.renderers.base import among_zeros
from tests.envs.test_device import NAMES, made, whole_overlay
from tests.tiny import CountingRenderer, tiny_env, tiny_renderer

__all__ = ["whole_overlay"]


def by_hand(env: EnvBase, after: TensorDictBase) -> TensorDictBase:
    """Reset as a loop of a user's own does, which hands over all that the last step left."""
    return env.reset(after.set("_reset", after["done"].clone())).exclude("_reset") if after["done"].any() else after


@pytest.mark.usefixtures("whole_overlay")
@pytest.mark.parametrize("name", NAMES)
def test_rows_that_are_done_begin_as_in_torchrl_and_the_others_go_on(name: str) -> None:
    ends = []
    for reset in (lambda env, td: env.maybe_reset(td), EnvBase.maybe_reset, by_hand):
        env, seen = made(name, 7), []
        torch.manual_seed(2)
        td = env.reset()
        for _ in range(7):
            after = step_mdp(env.step(env.rand_action(td)))
            kept = after.clone()
            td = reset(env, after)
            seen.append((kept, td.clone()))
            assert len(ends) or torch.equal(after["pixels"], kept["pixels"])  # keeps its input
        ends.append(seen)
    ended = 0
    for (kept, mine), (_, theirs), (_, typed) in zip(*ends, strict=True):
        assert set(mine.keys(True)) == set(theirs.keys(True)) == set(typed.keys(True))
        for key in theirs.keys(True, True):
            assert torch.equal(mine[key], theirs[key]) and torch.equal(mine[key], typed[key]), key
        done = kept["done"].squeeze(1)
        ended += int(done.sum())
        assert torch.equal(mine["state"][~done], kept["state"][~done])
    assert ended > 0  # else this shows nothing


@pytest.mark.usefixtures("whole_overlay")
def test_a_reset_without_a_mask_keeps_nothing_of_the_last_episodes() -> None:
    found = []
    for given in (False, True):
        env, _ = made("shaken sim2real", 7), torch.manual_seed(2)
        last = step_mdp(env.step(env.rand_action(env.reset())))
        begun = env.reset(last.clone()) if given else env.reset()
        found.append(begun["pixels"])
        assert not torch.equal(begun["camera_offset"], last["camera_offset"])
    assert torch.equal(*found)


def test_a_restart_renders_only_the_rows_that_begin_anew() -> None:
    counting = CountingRenderer(tiny_renderer())
    env = tiny_env([6], renderer=counting)
    torch.manual_seed(0)
    td = env.reset()
    ended = 0
    for step in range(1, 12):
        stepped, td = env.step_and_maybe_reset(env.rand_action(td))
        ended += int(stepped["next", "done"].sum())
        assert counting.rendered == 6 * (1 + step) + ended
    assert 0 < ended < 66


@pytest.mark.parametrize("dtype", [torch.uint8, torch.bool, torch.int64, torch.float32, torch.bfloat16])
@pytest.mark.parametrize("shape", [(), (1,), (2, 3)])
def test_new_rows_replace_the_given_ones_and_the_others_stay(dtype: torch.dtype, shape: tuple[int, ...]) -> None:
    generator = torch.Generator().manual_seed(0)
    old, fresh = ((100 * torch.rand(count, *shape, generator=generator)).to(dtype) for count in (7, 3))
    rows, before = torch.tensor([5, 0, 3]), old.clone()
    alone = among_zeros(fresh, rows, 7)
    for turned in (lambda values: values, lambda values: values.transpose(1, -1) if values.ndim > 2 else values):
        merged, other = with_rows([turned(old), old], rows, [turned(fresh), fresh])
        assert torch.equal(merged, turned(other)) and torch.equal(old, before)
    assert torch.equal(merged[rows], turned(fresh)) and torch.equal(alone[rows], fresh)
    assert torch.equal(merged[[1, 2, 4, 6]], turned(old)[[1, 2, 4, 6]]) and not alone[[1, 2, 4, 6]].any()
    assert torch.equal(with_rows([old], rows[:0], [fresh[:0]])[0], old)


@pytest.mark.parametrize("dtype", [torch.uint8, torch.int64, torch.float32])
@pytest.mark.parametrize("shape", [(1,), (4, 4, 3), (3, 3, 3)])
def test_marked_rows_are_fresh_and_the_others_stay(dtype: torch.dtype, shape: tuple[int, ...]) -> None:
    generator = torch.Generator().manual_seed(0)
    old, fresh = ((200 * torch.rand(5, *shape, generator=generator)).to(dtype) for _ in range(2))
    only, rows = torch.tensor([True, False, False, True, False]), torch.tensor([0, 3])
    for new in (fresh, fresh.transpose(1, -1).contiguous().transpose(1, -1)):  # the latter is not contiguous
        assert torch.equal(where_marked(only, new, old), with_rows([old], rows, [fresh[rows]])[0])


@pytest.mark.parametrize("row", [-1, 7])
def test_a_row_index_out_of_range_is_refused(row: int) -> None:
    with pytest.raises(ValueError, match="rows: expected row indices of the batch"):
        with_rows([torch.zeros(7, 2)], torch.tensor([0, row]), [torch.ones(2, 2)])


def test_gradients_flow_to_the_new_rows() -> None:
    old, fresh = torch.zeros(3, 2), torch.ones(1, 2, requires_grad=True)
    with_rows([old], torch.tensor([1]), [fresh])[0].sum().backward()
    assert torch.equal(fresh.grad, torch.ones(1, 2))
