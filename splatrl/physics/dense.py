"""A small network of dense layers whose output is bitwise the same in any batch."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from splatrl.array_files import read_arrays
from splatrl.files import replacing

MOST = 2**24
"""Maximum bytes of a file's weights."""


class Dense(nn.Module):
    """Dense layers with ReLUs between them and a tanh at the end.

    PyTorch sums matrix products in an order that depends on the batch size. Here products are summed pairwise, in an
    order that depends on the layer alone, so that a robot's step is a function of its state alone.

    Args:
        layers: weight [out, in] and bias [out] of each layer, float32.

    Raises:
        ValueError: for layers that do not fit together, or numbers that are not finite.
    """

    def __init__(self, layers: Sequence[tuple[Tensor, Tensor]]):
        super().__init__()
        if not layers:
            raise ValueError("layers: expected at least one, got none")
        given = layers[0][0].shape[-1]
        for number, (weight, bias) in enumerate(layers):
            fits = weight.ndim == 2 and weight.shape == (len(bias), given) and bias.ndim == 1 and len(bias)
            plain = weight.dtype == bias.dtype == torch.float32
            if not fits or not plain or not (weight.isfinite().all() and bias.isfinite().all()):
                raise ValueError(
                    f"layer {number}: expected finite float32 weight [out, {given}] and bias [out], "
                    f"got {weight.dtype} {list(weight.shape)} and {list(bias.shape)}"
                )
            given = len(bias)
            self.register_buffer(f"weight{number}", weight.T.contiguous(), persistent=False)
            self.register_buffer(f"bias{number}", bias, persistent=False)
        self.count = len(layers)

    @property
    def layers(self) -> list[tuple[Tensor, Tensor]]:
        """Weight [in, out] and bias [out] of each layer."""
        return [(self.get_buffer(f"weight{each}"), self.get_buffer(f"bias{each}")) for each in range(self.count)]

    @property
    def size(self) -> tuple[int, int]:
        """Number of inputs and number of outputs."""
        return self.layers[0][0].shape[0], self.layers[-1][0].shape[1]

    @classmethod
    def load(cls, path: Path, given: int, told: int) -> "Dense":
        """Read weights from a file of arrays ``weight0``, ``bias0``, ``weight1`` and so on, without running any code.

        Args:
            path: the .npz file.
            given: number of inputs.
            told: number of outputs.

        Raises:
            FileNotFoundError: if there is no such file.
            ValueError: for a file of another kind or with other sizes, in one line that names the file.
        """
        arrays = read_arrays(path, MOST)
        try:
            numbers = range(len(arrays) // 2)
            layers = [
                [torch.from_numpy(arrays[f"{name}{number}"]) for name in ("weight", "bias")] for number in numbers
            ]
            found = cls([(weight, bias) for weight, bias in layers])
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise ValueError(f"{path}: expected weights of dense layers, got {error}") from error
        if found.size != (given, told):
            inputs, outputs = found.size
            raise ValueError(f"{path}: expected {given} inputs and {told} outputs, got {inputs} and {outputs}")
        return found

    def save(self, path: Path) -> None:
        """Write the weights in the format that ``load`` reads, with the same bytes each time."""
        arrays: dict[str, NDArray[np.float32]] = {}
        for number, (weight, bias) in enumerate(self.layers):
            arrays |= {f"weight{number}": weight.T.contiguous().numpy(), f"bias{number}": bias.numpy()}
        with replacing(path) as stream:
            np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]

    def forward(self, values: Tensor) -> Tensor:
        """Apply the network: [B, in] float32 -> [B, out] float32 in [-1, 1]."""
        last = self.count - 1
        for number, (weight, bias) in enumerate(self.layers):
            values = pairwise_sum(values.unsqueeze(2) * weight) + bias
            values = values.clamp_min(0.0) if number < last else values.tanh()
        return values


def pairwise_sum(values: Tensor) -> Tensor:
    """Sum over the middle axis by repeatedly adding its halves: [B, K, H] -> [B, H]."""
    while (count := values.shape[1]) > 1:
        half = count // 2
        added = values[:, :half] + values[:, half : 2 * half]
        values = torch.cat([added, values[:, -1:]], 1) if count % 2 else added
    return values.squeeze(1)
