"""Dense layers whose bytes do not depend on the batch."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from splatrl.physics.dense import Dense, pairwise_sum


def layers(*sizes: int) -> list[tuple[Tensor, Tensor]]:
    draw = torch.Generator().manual_seed(0)
    return [(torch.randn(b, a, generator=draw) / a**0.5, torch.randn(b, generator=draw)) for a, b in pairwise(sizes)]


def test_it_computes_what_pytorch_does() -> None:
    given = layers(7, 12, 5, 3)
    values = torch.randn(9, 7, generator=torch.Generator().manual_seed(1))
    expected = values
    for weight, bias in given[:-1]:
        expected = torch.relu(expected @ weight.T + bias)
    expected = torch.tanh(expected @ given[-1][0].T + given[-1][1])
    assert torch.allclose(Dense(given)(values), expected, atol=1e-5)


def test_a_row_has_the_same_bytes_in_any_batch_and_order() -> None:
    net = Dense(layers(46, 64, 64, 12))
    values = torch.randn(67, 46, generator=torch.Generator().manual_seed(2))
    whole = net(values)
    order = torch.randperm(67, generator=torch.Generator().manual_seed(3))
    assert torch.equal(net(values[order]), whole[order])
    for row in (0, 13, 66):
        assert torch.equal(net(values[row : row + 1]), whole[row : row + 1])


@pytest.mark.parametrize("count", [1, 2, 5, 46])
def test_pairwise_sums_equal_plain_sums(count: int) -> None:
    values = torch.arange(3 * count * 2, dtype=torch.float64).reshape(3, count, 2)
    assert torch.equal(pairwise_sum(values), values.sum(1))


def test_weights_round_trip_through_a_file_that_has_the_same_bytes_each_time(tmp_path: Path) -> None:
    net = Dense(layers(4, 6, 2))
    net.save(tmp_path / "a.npz")
    net.save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    values = torch.ones(2, 4)
    assert torch.equal(Dense.load(tmp_path / "a.npz", 4, 2)(values), net(values))
    with pytest.raises(ValueError, match=r"a\.npz: expected 5 inputs and 2 outputs, got 4 and 2"):
        Dense.load(tmp_path / "a.npz", 5, 2)


@pytest.mark.parametrize(
    "arrays",
    [
        {"weight0": np.zeros((2, 4), np.float32), "other": np.zeros(2, np.float32)},
        {"weight0": np.zeros((2, 4), np.float64), "bias0": np.zeros(2, np.float64)},
        {"weight0": np.full((2, 4), np.nan, np.float32), "bias0": np.zeros(2, np.float32)},
        {"weight0": np.zeros((2, 4), np.float32), "bias0": np.zeros(3, np.float32)},
        {"weight0": np.zeros(4, np.float32), "bias0": np.zeros((), np.float32)},
        {"weight0": np.array(["a"]), "bias0": np.array(["b"])},
        {},
    ],
)
def test_invalid_weight_files_are_refused_in_one_line(arrays: dict[str, np.ndarray], tmp_path: Path) -> None:
    path = tmp_path / "bad.npz"
    np.savez(path, **arrays)
    with pytest.raises(ValueError, match=r"bad\.npz: expected weights of dense layers") as error:
        Dense.load(path, 4, 2)
    assert "\n" not in str(error.value)
