import math

import pytest
import torch

from splatrl.bodies import Body, Box, Capsule, Sphere
from splatrl.collision import FclChecker, Occupancy, TorchChecker, verify, verify_sweeps
from splatrl.collision.verify import MARGINS, grown
from tests.collision.cases import BODIES, CUBE, at, clutter, random_poses


class Swollen(TorchChecker):
    """A checker that treats its body as ``error`` metres larger than it is."""

    def __init__(self, occupancy: Occupancy, body: Body, error: float) -> None:
        super().__init__(occupancy, grown(body, error))
        self._thought, self.body = self.body, body
        self._larger = TorchChecker(occupancy, self._thought)

    def collides(self, body_to_world: torch.Tensor) -> torch.Tensor:
        return self._larger.collides(body_to_world)

    def sweeps(self, start: torch.Tensor, end: torch.Tensor) -> torch.Tensor:
        return self._larger.sweeps(start, end)


def test_the_margin_of_a_sphere_is_its_distance_from_a_touch():
    checker, oracle = Swollen(CUBE, Sphere(0.2), 1e-3), TorchChecker(CUBE, Sphere(0.2))
    gaps = (5e-4, 2e-3, -5e-4, 2e-5)
    found = verify(checker, oracle, at(*[(0.1 + 0.2 + gap, 0.05, 0.05) for gap in gaps]))
    assert [one.row for one in found.disagreements] == [0, 3]
    assert found.agreed == 2
    assert found.hits == 1
    for one, gap in zip(found.disagreements, (5e-4, 2e-5), strict=True):
        assert one.answer and not one.expected
        assert 0.99 * gap <= one.margin <= 2.01 * gap


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("error", [2e-3, -2e-3])
def test_no_margin_is_larger_than_the_checkers_error(body, error):
    occupancy = clutter()
    poses = random_poses(1500, (-0.9, 0.1, -0.4), (0.9, 1.6, 0.8))
    found = verify(Swollen(occupancy, body, error), FclChecker(occupancy, body), poses)
    assert found.disagreements
    assert all(one.answer == (error > 0) and one.expected == (error < 0) for one in found.disagreements)
    assert len(found.missed) == (len(found.disagreements) if error < 0 else 0)
    assert not found.beyond(2 * abs(error) + 1e-6)


def test_sweeps_are_compared_like_poses():
    start = at(*[(0.05, y, 0.05) for y in (-0.4, -0.4, -0.4)])
    end = at((0.05, -0.21, 0.05), (0.05, -0.1995, 0.05), (0.05, -0.2005, 0.05))
    found = verify_sweeps(Swollen(CUBE, Sphere(0.2), 1e-3), TorchChecker(CUBE, Sphere(0.2)), start, end)
    assert [one.row for one in found.disagreements] == [2]
    assert 4.9e-4 <= found.disagreements[0].margin <= 1.1e-3
    assert found.poses == 3


def test_checkers_that_agree_give_a_short_report():
    checker = TorchChecker(CUBE, Sphere(0.2))
    found = verify(checker, checker, at((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)))
    assert str(found) == "2 of 2 agreed; hits by the oracle: 1"
    assert found.disagreements == ()
    assert verify(checker, checker, torch.zeros(0, 4, 4)).agreed == 0


def test_the_report_lists_rows_by_margin_and_counts_the_rest():
    checker, oracle = Swollen(CUBE, Sphere(0.2), 1e-2), TorchChecker(CUBE, Sphere(0.2))
    lines = str(verify(checker, oracle, at(*[(0.3001 + 3e-4 * k, 0.05, 0.05) for k in range(25)]))).splitlines()
    assert lines[0].startswith("0 of 25 agreed; hits by the oracle: 0; 0 missed, margins up to")
    assert "free" in lines[1] and "margin" in lines[1]
    assert len(lines) == 22
    assert lines[-1] == "  and 5 with smaller margins"


def test_a_margin_beyond_the_largest_tried_is_infinite():
    oracle = TorchChecker(CUBE, Sphere(0.2))
    far = at((0.1 + 0.2 + 1.5 * MARGINS[-1], 0.05, 0.05))
    found = verify(Swollen(CUBE, Sphere(0.2), 1.0), oracle, far)
    assert math.isinf(found.disagreements[0].margin)


def test_bodies_grow_and_shrink_on_all_sides_until_nothing_is_left():
    assert grown(Box((0.4, 0.3, 0.1)), 0.1).size == pytest.approx((0.6, 0.5, 0.3))
    assert grown(Capsule(0.1, 0.3), -0.05) == Capsule(0.05, 0.3)
    assert grown(Box((0.4, 0.3, 0.1)), -0.05) is None
    assert grown(Sphere(0.1), -0.1) is None
    assert grown(Capsule(0.1, 0.3), -0.2) is None


def test_checkers_of_different_bodies_are_not_compared():
    with pytest.raises(ValueError, match="oracle: expected a checker for Sphere"):
        verify(TorchChecker(CUBE, Sphere(0.1)), TorchChecker(CUBE, Sphere(0.2)), at((0.0, 0.0, 0.0)))
