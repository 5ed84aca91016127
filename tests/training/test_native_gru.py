"""The compiled GRU against PyTorch's own."""

import math

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.modules import set_recurrent_mode

from splatrl.native import _core
from splatrl.training import native_gru
from splatrl.training.memory import STATE, Memory, gru
from splatrl.training.native_gru import remembered, suits

CASES = [(128, 128, (64, 64, 1, 37)), (48, 16, (5,)), (16, 80, (1,) * 70 + (2, 3))]
"""Sizes of features and memory, and the lengths of episodes."""


def case(features: int, memory: int, lengths: tuple[int, ...]) -> tuple[nn.GRU, Tensor, Tensor, Tensor, Tensor]:
    """Make a GRU with saturated gates among others, features, first frames, states before them, and slopes."""
    torch.manual_seed(0)
    cell = nn.GRU(features, memory, batch_first=True)
    for parameter in cell.parameters():
        parameter.data *= 3.0
    ends = torch.tensor(lengths).cumsum(0)
    begins = torch.cat([torch.zeros(1, dtype=torch.int64), ends[:-1]])
    seen = torch.randn(int(ends[-1]), features).requires_grad_()
    return cell, seen, begins, 0.5 * torch.randn(len(lengths), memory), torch.randn(int(ends[-1]), memory)


def results(states: Tensor, seen: Tensor, cell: nn.GRU, slope: Tensor) -> list[Tensor]:
    return [states.detach(), *torch.autograd.grad(states, [seen, *cell.parameters()], slope)]


def in_torch(cell: nn.GRU, seen: Tensor, begins: Tensor, states: Tensor) -> Tensor:
    """Return the states that PyTorch's GRU gives in double precision, one episode at a time."""
    cell = cell.double()
    episodes = seen.double().tensor_split(begins[1:])
    return torch.cat([cell(x[None], h.double()[None, None])[0][0] for x, h in zip(episodes, states, strict=True)])


@pytest.mark.parametrize("isa", _core.supported_isas())
@pytest.mark.parametrize("sizes", CASES)
def test_states_and_gradients_match_those_of_pytorchs_gru(
    sizes: tuple, isa: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SPLATRL_ISA", isa)
    assert _core.isa() == isa
    cell, seen, begins, states, slope = case(*sizes)
    found = results(remembered(seen, begins, states, cell), seen, cell, slope)
    right = results(in_torch(cell, seen, begins, states), seen, cell, slope.double())
    for mine, theirs in zip(found, right, strict=True):
        assert mine.dtype == torch.float32 and (mine - theirs).abs().max() <= 3e-6 * theirs.abs().max()


def test_cores_and_other_episodes_change_no_byte(monkeypatch: pytest.MonkeyPatch) -> None:
    cell, seen, begins, states, slope = case(*CASES[0])
    found = []
    for cores in (1, 2, 5):
        monkeypatch.setattr(native_gru, "_threads", lambda frames, cores=cores: cores)
        found.append(results(remembered(seen, begins, states, cell), seen, cell, slope))
    for other in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], other, strict=True))
    alone = remembered(seen[64:128], begins[:1], states[1:2], cell)
    assert torch.equal(alone, found[0][0][64:128])


def test_a_state_that_overflows_is_not_hidden() -> None:
    cell, seen, begins, states, _ = case(*CASES[1])
    for value in (float("nan"), 1e30):
        odd = seen.detach().clone()
        odd[2, 0] = value
        after = remembered(odd, begins, states, cell)
        assert after[:2].isfinite().all()
        assert after[2:].isnan().any(1).all() if value != value else after.abs().max() <= 1.0


def test_no_frames_have_a_gradient_of_zero() -> None:
    cell, seen, begins, states, slope = case(*CASES[0])
    after = remembered(seen[:0], begins[:0], states[:0], cell)
    assert after.shape == (0, 128)
    assert not any(g.any() for g in torch.autograd.grad(after, list(cell.parameters()), slope[:0]))


def test_pytorchs_gru_gives_the_same_where_the_compiled_one_cannot(monkeypatch: pytest.MonkeyPatch) -> None:
    cell, seen, begins, states, slope = case(*CASES[0])
    assert suits(seen, cell) == (_core.isa() in native_gru.FAST)
    assert not suits(seen.double(), cell)
    assert not suits(seen[:, :100], nn.GRU(100, 128))
    assert not suits(seen, nn.GRU(128, 100))
    module = gru(128, 128)
    module.gru = cell
    found = results(module.along(seen, begins, states), seen, cell, slope)
    monkeypatch.setattr("splatrl.training.memory.suits", lambda *_: False)
    expected = results(module.along(seen, begins, states), seen, cell, slope)
    for mine, theirs in zip(found, expected, strict=True):
        torch.testing.assert_close(mine, theirs, atol=2e-5, rtol=1e-4)


@pytest.mark.parametrize("memory", [16, 7])  # compiled, and PyTorch's
def test_episodes_within_a_batch_are_learned_from_as_step_by_step(memory: int) -> None:
    torch.manual_seed(0)
    module = gru(32, memory)
    features, state = torch.randn(4, 9, 32).requires_grad_(), torch.randn(4, 9, memory)
    is_init = torch.rand(4, 9, 1) < 0.3
    assert is_init[:, 0].any() and not is_init[:, 0].all()
    found = []
    for stepwise in (None, True):
        module.stepwise = stepwise
        after = module._through(features, state, is_init)
        found.append([after, *torch.autograd.grad(after.square().sum(), [features, *module.parameters()])])
    for mine, theirs in zip(*found, strict=True):
        torch.testing.assert_close(mine, theirs, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("batch", [(2, 3, 5), (5,)])
def test_rows_of_a_batch_may_have_any_shape(batch: tuple[int, ...]) -> None:
    module = gru(32, 16)
    told = {"features": torch.randn(6, 5, 32), STATE: torch.randn(6, 5, 1, 16), "is_init": torch.rand(6, 5, 1) < 0.3}
    with set_recurrent_mode(True):
        expected = module(TensorDict(told, [6, 5]))["hidden"]
        rows = {key: value[: math.prod(batch[:-1])].reshape(*batch, *value.shape[2:]) for key, value in told.items()}
        found = module(TensorDict(rows, batch))
    assert torch.equal(found["hidden"].reshape(-1, 5, 16), expected[: math.prod(batch[:-1])])
    assert found["next", STATE].shape == (*batch, 1, 16)


def test_one_step_is_the_first_of_many() -> None:
    module: Memory = gru(32, 16)
    features, state, is_init = torch.randn(3, 5, 32), torch.randn(3, 5, 16), torch.rand(3, 5, 1) < 0.5
    after = module.after(features, state, is_init)
    assert after.shape == (3, 5, 16)
    for row in range(3):
        first = module._through(*(each[row].unsqueeze(1) for each in (features, state, is_init)))
        torch.testing.assert_close(first.squeeze(1), after[row], atol=1e-6, rtol=1e-5)
    torch.testing.assert_close(module.after(features[0, 0], state[0, 0], is_init[0, 0]), after[0, 0])


def test_the_compiled_gru_is_left_out_of_traced_and_mapped_code() -> None:
    module = gru(32, 16).requires_grad_(False)
    begins = torch.tensor([0, 3])
    given, other = torch.randn(5, 32), torch.randn(5, 32)
    traced = torch.jit.trace(lambda seen: module.along(seen, begins), given)
    assert "Remembering" not in str(traced.graph)
    torch.testing.assert_close(traced(other), module.along(other, begins), atol=1e-6, rtol=1e-5)
    found = list[bool]()
    torch.vmap(lambda rows: found.append(suits(rows, module.gru)) or rows)(torch.randn(2, 3, 32))
    assert found == [False]


def test_an_invalid_shape_or_order_of_episodes_is_refused() -> None:
    cell, seen, _, states, _ = case(*CASES[0])
    for sizes in [(0, 0, 24, 16), (0, 0, 16, 0), (0, 0, 16, 1 << 20)]:
        with pytest.raises(ValueError, match="sizes: expected"):
            _core.gru_forward(sizes, (0, 0), 0, (0,) * 4, (0, 0), 1)
    for wrong in ([1, 64, 128, 129], [0, 64, 64, 129], [0, 64, 128, 166], [0, 128, 64, 129], []):
        with pytest.raises(ValueError, match="begins: expected"):
            remembered(seen, torch.tensor(wrong, dtype=torch.int64), states, cell)
