"""The checker for robots that pass through everything."""

import torch

from splatrl.bodies import Box
from splatrl.collision import NoChecker, Occupancy
from splatrl.collision.native import NativeChecker
from splatrl.geometry import rigid
from tests.collision.cases import assert_empty_answers
from tests.tiny import BODY


def test_nothing_is_hit_where_another_checker_finds_a_wall() -> None:
    points = torch.cartesian_prod(*[torch.linspace(0.0, 0.95, 20)] * 3).numpy()
    occupancy = Occupancy.from_points(points, 0.05)
    start = rigid(torch.eye(3), torch.tensor([[0.5, 0.5, 0.5], [-2.0, 0.5, 0.5], [3.0, 3.0, 3.0]]))
    end = rigid(torch.eye(3), torch.tensor([[0.5, 0.5, 0.5], [2.0, 0.5, 0.5], [3.0, 3.0, 4.0]]))
    solid, nothing = NativeChecker(occupancy, BODY), NoChecker(occupancy, BODY)
    assert solid.collides(start).tolist() == [True, False, False]
    assert solid.sweeps(start, end).tolist() == [True, True, False]
    assert nothing.body == BODY
    for found in (nothing.collides(start), nothing.sweeps(start, end)):
        assert found.tolist() == [False] * 3 and found.dtype == torch.bool
    fraction, clearance = nothing.free_fraction(start, end), nothing.clearance(start[:, :3, 3])
    assert fraction.tolist() == [1.0] * 3 and fraction.dtype == torch.float32
    assert clearance.isinf().all() and clearance.shape == (3,) and (clearance > 0).all()


def test_empty_batches_give_empty_answers() -> None:
    assert_empty_answers(NoChecker(None, Box((0.1, 0.1, 0.1))))
