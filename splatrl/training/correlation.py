"""A trunk that compares every cell of one image with every cell of another."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn.functional import normalize, relu

from splatrl.training.heads import orthogonal
from splatrl.training.trunk import GAIN, two_convolutions


class CorrelationTrunk(nn.Module):
    """Convolutions shared by two images, and the similarity of each cell of one image to each cell of the other.

    This is the correlation volume of optical flow (Dosovitskiy et al. 2015, FlowNet; over all pairs as in Teed and Deng
    2020, RAFT), as cosines of features from which their mean over the image is subtracted. A dense layer reads it
    together with the features themselves.

    Args:
        height: height of the images, pixels.
        width: width of the images, pixels.
        depth: channels of both images together.
        channels: output channels of the two convolutions.
        features: size of the output.

    Raises:
        ValueError: if the images are too small for the convolutions, or ``channels`` does not hold two numbers.
    """

    def __init__(self, height: int, width: int, depth: int, channels: Sequence[int], features: int):
        super().__init__()
        self.convolutions = two_convolutions(height, width, depth // 2, channels)
        cells = self.convolutions(torch.zeros(1, depth // 2, height, width)).flatten(2).shape[2]
        self.dense = orthogonal(nn.Linear(cells * (cells + 2 * channels[1]), features), GAIN)

    def forward(self, image: Tensor) -> Tensor:
        """Encode two images joined as channels: [..., H, W, 2 · C] float32 -> [..., features] float32."""
        images = image.reshape(-1, *image.shape[-3:])
        found = [self.convolutions(each.permute(0, 3, 1, 2)).flatten(2) for each in images.chunk(2, -1)]
        here, there = (normalize(each - each.mean(2, keepdim=True), dim=1) for each in found)
        alike = here.transpose(1, 2) @ there  # [N, cells, cells]
        read = torch.cat([each.flatten(1) for each in (alike, *found)], 1)
        return relu(self.dense(relu(read))).reshape(*image.shape[:-3], -1)
