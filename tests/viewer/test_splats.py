"""Gaussians in the form that the browser takes."""

import numpy as np
import pytest
import torch

from splatrl.geometry import quats_to_rotations
from splatrl.viewer.page import around
from splatrl.viewer.splats import parts_of
from tests.tiny import tiny_gaussians


def test_parts_hold_every_gaussian_once_and_double_in_size() -> None:
    gaussians = tiny_gaussians()
    parts = parts_of(gaussians, first=40)
    assert [len(part.centers) for part in parts] == [40, 80, len(gaussians) - 120]
    assert sum(len(part.centers) for part in parts) == len(gaussians)
    centers = np.concatenate([part.centers for part in parts])
    assert np.array_equal(np.unique(centers, axis=0), np.unique(gaussians.means.numpy(), axis=0))
    assert [len(part.centers) for part in parts_of(gaussians)] == [len(gaussians)]


def test_gaussians_that_cover_most_come_first() -> None:
    gaussians = tiny_gaussians()[:3].clone()
    gaussians.scales = torch.tensor([[0.1, 0.1, 0.01], [0.2, 0.2, 0.01], [0.3, 0.01, 0.01]])
    gaussians.opacities = torch.tensor([0.9, 0.1, 0.9])
    (part,) = parts_of(gaussians)
    assert np.array_equal(part.centers, gaussians.means[[0, 1, 2]].numpy())
    gaussians.opacities = torch.tensor([0.1, 0.9, 0.9])
    (part,) = parts_of(gaussians)
    assert np.array_equal(part.centers, gaussians.means[[1, 2, 0]].numpy())


def test_covariances_and_colours_are_those_of_the_gaussians() -> None:
    gaussians = tiny_gaussians()[:1].clone()
    gaussians.quats = torch.nn.functional.normalize(torch.tensor([[0.3, 0.5, -0.2, 0.7]]))
    gaussians.scales = torch.tensor([[0.5, 0.2, 0.1]])
    gaussians.sh = torch.tensor([[[-5.0, 0.0, 0.5]]])
    (part,) = parts_of(gaussians)
    turn = quats_to_rotations(gaussians.quats)[0].double().numpy()
    assert part.covariances[0] == pytest.approx(turn @ np.diag([0.25, 0.04, 0.01]) @ turn.T, abs=2e-4)
    assert part.colors[0].tolist() == [0, 128, 163]  # 0.5 + 0.28209 · sh
    assert part.opacities.tolist() == [[230]]


def test_huge_gaussians_keep_their_shape_in_half_precision() -> None:
    gaussians = tiny_gaussians()[:2].clone()
    gaussians.quats = torch.nn.functional.normalize(torch.tensor([[0.9, 0.1, -0.3, 0.3], [1.0, 0.0, 0.0, 0.0]]))
    gaussians.scales = torch.tensor([[900.0, 900.0, 90.0], [200.0, 1.0, 1.0]])
    gaussians.opacities = torch.tensor([0.9, 0.8])
    huge, large = parts_of(gaussians)[0].covariances.astype(np.float64)
    assert np.linalg.eigvalsh(huge) / np.linalg.eigvalsh(huge)[2] == pytest.approx([0.01, 1, 1], abs=2e-3)
    assert large == pytest.approx(np.diag([4e4, 1.0, 1.0]))  # fits, and is unchanged


def test_the_colour_of_a_gaussian_is_the_mean_over_the_viewpoints() -> None:
    gaussians = tiny_gaussians()[:1].clone()
    gaussians.sh = torch.zeros(1, 4, 3)
    gaussians.sh[0, 2] = 0.4  # brighter the more one looks upwards
    eyes = gaussians.means + torch.tensor([[0.0, 0.0, 5.0], [3.0, 0.0, 4.0]])
    (part,) = parts_of(gaussians, eyes)
    mean = 0.5 - 0.48860251 * 0.4 * (1.0 + 0.8) / 2
    assert part.colors[0].tolist() == [round(255 * mean)] * 3
    assert parts_of(gaussians)[0].colors[0].tolist() == [128] * 3


def test_viewpoints_for_colours_are_around_and_above_the_scene() -> None:
    eyes = around(((-2.0, -1.0, 0.0), (2.0, 3.0, 2.0)))
    assert torch.allclose(eyes.mean(0), torch.tensor([0.0, 1.0, 1.0 + 0.7 * 4.0]), atol=1e-5)
    assert torch.allclose((eyes - torch.tensor([0.0, 1.0, 1.0]))[:, :2].norm(dim=1), torch.tensor(0.8 * 4.0))
