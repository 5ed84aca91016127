"""A film whose second half has another scale than its first is told from one that keeps it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from splatrl.capture.drift import lost_scale
from splatrl.capture.world import moved, place
from tests.capture.walks import CAMERAS, walk


@pytest.mark.parametrize(("scale", "lost"), [(1.0, False), (0.6, False), (0.2, True)])
def test_a_scale_that_is_lost_half_way_is_found(scale: float, lost: bool) -> None:
    first = walk()
    about = np.eye(4)
    about[:3, :3] *= scale
    about[:3, 3] = (1 - scale) * first.camera_to_world[-1, :3, 3].numpy()
    second = moved(first, about)
    both = replace(
        first,
        paths=[*first.paths, *second.paths],
        camera_to_world=torch.cat([first.camera_to_world, second.camera_to_world]),
        points=torch.cat([first.points, second.points]),
        colors=torch.cat([first.colors, second.colors]),
        seen_point=torch.cat([first.seen_point, second.seen_point + len(first.points)]),
        seen_by=torch.cat([first.seen_by, second.seen_by + CAMERAS]),
        seconds=torch.arange(2 * CAMERAS, dtype=torch.float64) / 4,
    )
    said = lost_scale(place(both, marker=None, camera_height=1.4))
    assert (said is not None) == lost
    assert not lost or "m above the floor at" in str(said)
