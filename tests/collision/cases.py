"""Bodies, grids, poses, and answers that the tests of all checkers share."""

from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike

from splatrl.bodies import Box, Capsule, Sphere
from splatrl.collision import Occupancy
from splatrl.geometry import quats_to_rotations, rigid

BODIES = [Box((0.4, 0.3, 0.1)), Sphere(0.17), Capsule(0.08, 0.25)]
CUBE = Occupancy(np.ones((1, 1, 1), bool), (0, 0, 0), 0.1)  # from 0 to 0.1 along each axis
EMPTY = [Occupancy.empty(), Occupancy(np.zeros((3, 4, 5), bool), (0, 0, 0), 0.1)]


def at(*places: tuple[float, float, float], rotation: torch.Tensor | None = None) -> torch.Tensor:
    turn = torch.eye(3) if rotation is None else rotation
    return rigid(turn.float(), torch.tensor(places))


def random_poses(count: int, lower: ArrayLike, upper: ArrayLike, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    quats = torch.randn(count, 4, generator=generator)
    lower, upper = torch.as_tensor(lower).float(), torch.as_tensor(upper).float()
    return rigid(quats_to_rotations(quats), lower + torch.rand(count, 3, generator=generator) * (upper - lower))


def clutter(seed: int = 0, share: float = 0.03) -> Occupancy:
    return Occupancy(np.random.default_rng(seed).random((14, 11, 8)) < share, (-7, 3, -2), 0.1)


def assert_nothing_hit(checker: Any) -> None:
    """Check the answers of a checker whose grid is empty."""
    poses = random_poses(100, (-1, -1, -1), (1, 1, 1))
    assert not checker.collides(poses).any()
    assert (checker.free_fraction(poses, poses.flip(0)) == 1.0).all()
    assert not checker.sweeps(poses, poses.flip(0)).any()
    assert checker.clearance(poses[:, :3, 3]).isinf().all()


def assert_only_a_way_through_hits(checker: Any) -> None:
    """Check the answers of a checker of ``CUBE`` to poses far outside its grid."""
    far = at((1e6, 0.0, 0.0), (0.0, -1e6, 0.0), (0.0, 0.0, 3e30))
    assert not checker.collides(far).any()
    assert not checker.sweeps(far, far).any()
    assert checker.sweeps(at((-50.0, 0.05, 0.05)), at((50.0, 0.05, 0.05))).tolist() == [True]


def assert_empty_answers(checker: Any) -> None:
    """Check the answers of a checker to empty batches."""
    none, nowhere = torch.zeros(0, 4, 4), torch.zeros(0, 3)
    for hits in (checker.collides(none), checker.sweeps(none, none)):
        assert (hits.shape, hits.dtype) == ((0,), torch.bool)
    for lengths in (checker.free_fraction(none, none), checker.clearance(nowhere)):
        assert (lengths.shape, lengths.dtype) == ((0,), torch.float32)
