"""Nodes of a grid of planar poses, and interpolation between them."""

import math

import torch

from splatrl.motions.pose_grid import PoseGrid


def test_taps_are_the_nodes_around_a_pose() -> None:
    grid = PoseGrid(torch.tensor([-1.0, -0.5]), (5, 3, 4), 0.5, math.tau / 4)
    nodes = grid.nodes()
    assert nodes.shape == (5 * 3 * 4, 3)
    own = grid.taps(nodes)
    heaviest = own.node.gather(1, own.weight.argmax(1, keepdim=True)).squeeze(1)
    assert torch.equal(heaviest, torch.arange(60)) and torch.equal(own.weight.amax(1), torch.ones(60))
    pose = torch.tensor([[-0.9, 0.2, 0.3], [0.6, -0.4, 6.0]])
    taps = grid.taps(pose)
    torch.testing.assert_close(taps.weight.sum(1), torch.ones(2))
    mean = (nodes[taps.node][:, :, :2] * taps.weight.unsqueeze(2)).sum(1)
    torch.testing.assert_close(mean, pose[:, :2], atol=2e-3, rtol=0)
    headings = nodes[taps.node[1]][:, 2].unique()
    torch.testing.assert_close(headings, torch.tensor([0.0, 1.5 * math.pi]))  # wraps around at a full turn
