"""``CorrelationTrunk``, which compares two images cell by cell."""

import pytest
import torch
from torchrl.data import Categorical

from splatrl.training import Input, actor_critic
from splatrl.training.correlation import CorrelationTrunk

ACTIONS = Categorical(4, shape=())
TWO = {"pixels": Input("image", (16, 24, 3)), "imagegoal": Input("image", (16, 24, 3))}


def counting() -> tuple[CorrelationTrunk, int]:
    """Make a trunk whose one feature sums the similarity of each cell of an image to the same cell of the other."""
    torch.manual_seed(0)
    trunk = CorrelationTrunk(16, 24, 6, (4, 8), 1)
    cells = 3 * 5
    with torch.no_grad():
        trunk.dense.weight.zero_()
        trunk.dense.weight[0, : cells * cells] = torch.eye(cells).flatten()
    return trunk, cells


def test_cells_of_an_image_are_fully_similar_only_to_themselves() -> None:
    trunk, cells = counting()
    image, other = torch.rand(2, 1, 16, 24, 3) - 0.5
    same, another = trunk(torch.cat([image, image], -1)), trunk(torch.cat([image, other], -1))
    assert same.item() == pytest.approx(cells, rel=1e-5)
    assert another.item() < 0.7 * cells


def test_a_uniform_change_of_brightness_does_not_affect_the_comparison() -> None:
    trunk, cells = counting()
    torch.nn.init.uniform_(trunk.convolutions[0].bias, 2.0, 3.0)  # so that no ReLU clips anything and all is linear
    image, other = 0.1 * torch.rand(2, 1, 16, 24, 3)
    assert trunk(torch.cat([image, image + 0.1], -1)).item() == pytest.approx(cells, rel=1e-3)
    assert trunk(torch.cat([image, other], -1)).item() < 0.7 * cells


def test_it_reads_batches_of_any_shape_and_serves_as_the_trunk_of_a_policy() -> None:
    torch.manual_seed(0)
    trunk = CorrelationTrunk(16, 24, 6, (4, 8), 7)
    images = torch.rand(2, 3, 16, 24, 6)
    found = trunk(images)
    assert found.shape == (2, 3, 7)
    torch.testing.assert_close(found[1, 2], trunk(images[1, 2]))
    model = actor_critic((16, 24, 3), ACTIONS, 1, (4, 8), 16, inputs=TWO, fusion="correlation")
    assert isinstance(model.module[0].module[1].module.seen, CorrelationTrunk)


@pytest.mark.parametrize(
    ("inputs", "fusion", "match"),
    [
        (TWO, "late", "expected one of early, correlation, got late"),
        (None, "correlation", "expected early unless .* exactly two images of the same shape, got correlation for 0"),
        ({**TWO, "third": TWO["pixels"]}, "correlation", "got correlation for 3"),
        ({**TWO, "imagegoal": Input("image", (16, 24, 1))}, "correlation", "got correlation for 2"),
    ],
)
def test_inputs_that_cannot_be_compared_are_refused(inputs, fusion: str, match: str) -> None:
    with pytest.raises(ValueError, match=rf"network\.fusion: .*{match}"):
        actor_critic((16, 24, 3), ACTIONS, 1, inputs=inputs, fusion=fusion)


def test_images_that_are_too_small_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 8"):
        CorrelationTrunk(7, 24, 6, (4, 8), 16)
    with pytest.raises(ValueError, match=r"network\.channels: expected two numbers"):
        CorrelationTrunk(16, 24, 6, (4,), 16)
