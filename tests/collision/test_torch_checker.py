"""The readable torch checker, and exact touches with the answers of the native checker, the torch checker and FCL."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from splatrl.bodies import Body, Box, Capsule, Sphere
from splatrl.collision import DistanceField, FclChecker, Occupancy, TorchChecker, torch_checker, verify
from splatrl.collision.displacement import Displacement
from splatrl.collision.native import NativeChecker
from splatrl.collision.verify import grown
from splatrl.geometry import axis_rotations, rigid
from tests.collision.cases import (
    BODIES,
    CUBE,
    EMPTY,
    assert_empty_answers,
    assert_nothing_hit,
    at,
    clutter,
    random_poses,
)
from tests.collision.oracle import separation


def moves(count: int, seed: int, turning: bool) -> tuple[torch.Tensor, torch.Tensor]:
    start, end = (random_poses(count, (-0.9, 0.1, -0.4), (0.9, 1.6, 0.8), seed + k) for k in (0, 1))
    if not turning:
        end[:, :3, :3] = start[:, :3, :3]
    return start, end


def between(start: torch.Tensor, end: torch.Tensor, share: torch.Tensor | float) -> torch.Tensor:
    """Return poses along moves that do not turn, in float64 because rounding to float32 would leave the line."""
    pose = start.double()
    share = torch.as_tensor(share, dtype=torch.float64).expand(len(start))
    pose[:, :3, 3] += share[:, None] * (end.double() - start.double())[:, :3, 3]
    return pose


@pytest.mark.parametrize("count", [500, pytest.param(5000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("body", BODIES)
def test_torch_and_fcl_agree_with_separating_axes_and_closest_points(body, count):
    occupancy = clutter()
    lower, upper = occupancy.bounds
    poses = random_poses(count, lower - 0.2, upper + 0.2)
    gaps = torch.tensor([separation(body, pose, occupancy) for pose in poses.double().numpy()])
    expected = gaps < 0
    assert 0.2 < expected.float().mean() < 0.8
    for checker, rounding in ((TorchChecker(occupancy, body), 1e-8), (FclChecker(occupancy, body), 1e-5)):
        sure = gaps.abs() > rounding
        assert sure.float().mean() > 0.99
        assert torch.equal(checker.collides(poses)[sure], expected[sure])


@pytest.mark.parametrize("body", BODIES)
def test_a_straight_sweep_is_the_union_of_many_poses(body):
    checker = TorchChecker(clutter(2, 0.01), body)
    start, end = moves(300, 3, turning=False)
    swept = checker.sweeps(start, end)
    dense = torch.zeros(300, dtype=torch.bool)
    for share in np.linspace(0, 1, 201):
        open_ = (~dense).nonzero()[:, 0]
        dense[open_] = checker.collides(between(start[open_], end[open_], float(share)))
    assert 0.2 < swept.float().mean() < 0.95
    assert not (dense & ~swept).any()
    assert (swept & ~dense).sum() <= 6  # grazed between two poses


@pytest.mark.parametrize("body", BODIES)
def test_a_move_stops_just_before_the_first_contact(body):
    checker = TorchChecker(clutter(), body)
    start, end = moves(200, 5, turning=False)
    fraction = checker.free_fraction(start, end)
    some = (fraction > 0) & (fraction < 1)
    assert some.sum() > 50
    assert not checker.collides(between(start, end, fraction))[some].any()
    assert checker.collides(between(start, end, fraction + 2e-6))[some].all()
    assert (fraction[checker.collides(start)] == 0.0).all()
    assert torch.equal(fraction < 1, checker.sweeps(start, end))


@settings(max_examples=8)
@given(seed=st.integers(0, 10_000), body=st.sampled_from(BODIES))
def test_a_turning_sweep_misses_nothing_and_is_hardly_wider_than_the_body(seed, body):
    occupancy = clutter(seed, 0.01)
    start, end = moves(6, seed, turning=True)
    swept = TorchChecker(occupancy, body).sweeps(start, end)
    move = Displacement(start.double(), end.double(), body.radius, 0.01)
    rows = torch.arange(6).repeat_interleave(move.steps + 1)
    poses = torch.cat([move.at(rows[rows == k], torch.arange(int(move.steps[k]) + 1)) for k in range(6)])

    def dense(tested: Body) -> torch.Tensor:
        return torch.zeros(6).index_add(0, rows, TorchChecker(occupancy, tested).collides(poses).float()) > 0

    assert not (dense(body) & ~swept).any()
    # a tenth of a voxel (√3 of it at box corners), as much for the middle orientation, half a step between poses
    assert not (swept & ~dense(grown(body, (1 + math.sqrt(3)) * 0.1 * occupancy.resolution + 0.005))).any()


def test_a_turn_stops_before_an_obstacle_in_its_way():
    rod = Box((0.8, 0.04, 0.04))
    checker = TorchChecker(Occupancy.from_keys([[2, 2, 0]], 0.1), rod)  # 45° to the left
    turns = [at((0.0, 0.0, 0.05), rotation=axis_rotations(2, torch.tensor(yaw))) for yaw in (0.2, 1.4, -1.2)]
    fraction = checker.free_fraction(torch.cat([turns[0], turns[0]]), torch.cat(turns[1:]))
    assert fraction[1] == 1.0
    # the rod's upper edge, 0.02 m off its middle, meets the corner at (0.3, 0.2)
    yaw = math.atan2(0.2, 0.3) - math.asin(0.02 / math.hypot(0.2, 0.3))
    exact = (yaw - 0.2) / 1.2
    assert exact - 0.05 < fraction[0] <= exact


def test_a_swept_capsule_hits_a_corner_within_a_radius_of_its_parallelogram():
    capsule = Capsule(0.1, 0.4)
    checker = TorchChecker(CUBE, capsule)
    side = 0.1 / math.sqrt(3)  # the radius along the diagonal from the corner, per axis
    for gap, hit in ((-1e-6, True), (1e-6, False)):
        middle = torch.full((3,), 0.1 + (side + gap))  # the corner's nearest point on the swept parallelogram
        u, v = torch.tensor([1.0, -1.0, 0.0]), torch.tensor([1.0, 1.0, -2.0])
        u, v = u / u.norm(), v / v.norm()
        rotation = torch.stack([v, torch.cross(u, v, dim=0), u], 1)
        rotation = rotation if torch.linalg.det(rotation) > 0 else rotation * torch.tensor([-1.0, 1.0, 1.0])
        start, end = (at(tuple((middle + sign * 0.3 * v).tolist()), rotation=rotation) for sign in (-1, 1))
        assert checker.sweeps(start, end).tolist() == [hit]


@pytest.mark.parametrize("body", BODIES)
def test_the_chunk_size_does_not_change_the_answers(body, monkeypatch):
    start, end = moves(7, 8, turning=True)
    checker = TorchChecker(clutter(), body)
    expected = checker.collides(start), checker.free_fraction(start, end)
    monkeypatch.setattr(torch_checker, "_PAIRS", 97)
    assert torch.equal(checker.collides(start), expected[0])
    assert torch.equal(checker.free_fraction(start, end), expected[1])


@pytest.mark.parametrize("body", BODIES)
def test_nothing_is_hit_in_an_empty_grid_and_empty_batches_give_empty_answers(body):
    for empty in EMPTY:
        assert_nothing_hit(TorchChecker(empty, body))
    assert_empty_answers(TorchChecker(CUBE, body))


def test_clearance_is_at_most_a_voxel_diagonal_above_the_bound_of_the_distance_field():
    occupancy = clutter()
    points = random_poses(1500, (-1.5, -0.5, -1.0), (1.5, 2.0, 1.5))[:, :3, 3]
    clearance = TorchChecker(occupancy, Sphere(0.1)).clearance(points)
    bound = torch.from_numpy(DistanceField(occupancy).clearance(points))
    assert (clearance >= bound - 1e-6).all()
    inside = ((points > torch.tensor(occupancy.bounds[0])) & (points < torch.tensor(occupancy.bounds[1]))).all(1)
    assert inside.sum() > 50
    assert (clearance <= bound + math.sqrt(3) * occupancy.resolution + 1e-6)[inside].all()
    assert torch.equal(clearance == 0, torch.from_numpy(occupancy.contains(points)))


@pytest.mark.parametrize("body", BODIES)
def test_poses_far_outside_the_grid_are_free(body):
    checker = TorchChecker(CUBE, body)
    far = at((1e6, 0.0, 0.0), (0.0, -1e6, 0.0), (0.0, 0.0, 3e30), (-1e38, 1e30, 0.0))
    assert not checker.collides(far).any()
    assert not checker.sweeps(far, far).any()
    assert checker.sweeps(at((-100.0, 0.02, 0.03)), at((100.0, 0.02, 0.03))).tolist() == [True]


def test_invalid_poses_are_refused_by_row():
    checker = TorchChecker(CUBE, Sphere(0.1))
    poses = at((0.0, 0.0, 0.0), (0.0, math.nan, 0.0))
    with pytest.raises(ValueError, match=r"body_to_world: expected finite numbers, got .* in row 1"):
        checker.collides(poses)
    with pytest.raises(ValueError, match=r"end: expected finite numbers, got .* in row 1"):
        checker.sweeps(at(*[(0.0, 0.0, 0.0)] * 2), poses)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@pytest.mark.parametrize("body", BODIES)
def test_a_gpu_answers_as_the_cpu_does(body):
    checker = TorchChecker(clutter(), body)
    start, end = moves(200, 4, turning=True)
    device = torch.device("cuda")
    fraction = checker.free_fraction(start.to(device), end.to(device))
    assert fraction.device.type == "cuda"
    torch.testing.assert_close(fraction.cpu(), checker.free_fraction(start, end), atol=1e-6, rtol=0)
    assert not verify(checker, FclChecker(checker.occupancy, body), start).beyond(1e-5)


def turned(*eighths: tuple[int, float]) -> torch.Tensor:
    """Multiply rotations, each given as (axis, angle in eighths of a turn)."""
    rotation = torch.eye(3, dtype=torch.float64)
    for axis, eighth in eighths:
        rotation = rotation @ axis_rotations(axis, torch.tensor(eighth * math.pi / 4, dtype=torch.float64))
    return rotation


HALF = math.sqrt(0.5)
TIP = math.atan(HALF) / (math.pi / 4)  # together with a turn of 45°, brings a cube's diagonal onto an axis
SLAB, BLOCK, BALL, ROD = Box((0.5, 0.25, 0.125)), Box((0.5, 0.5, 0.5)), Sphere(0.25), Capsule(0.125, 0.5)
VOXEL = Occupancy(np.ones((1, 1, 1), bool), (0, 0, 0), 0.5)
TOUCHES = {
    # touches of VOXEL: body, rotation, centre, direction away from it, and whether FCL calls it a hit; None where the
    # touch cannot be represented in float32, so that rounding decides
    "box, face to face": (SLAB, turned(), (0.75, 0.25, 0.25), (1, 0, 0), True),
    "box, face to face, half off": (SLAB, turned(), (0.75, 0.5, 0.5), (1, 0, 0), True),
    "box, edge to edge": (SLAB, turned(), (0.75, 0.625, 0.25), (1, 1, 0), True),
    "box, corner to corner": (SLAB, turned(), (0.75, 0.625, 0.5625), (1, 1, 1), True),
    "box at 90°, face to face": (SLAB, turned((2, 2)), (0.625, 0.25, 0.25), (1, 0, 0), None),
    "box at 45°, edge to face": (BLOCK, turned((2, 1)), (0.5 + 0.5 * HALF, 0.25, 0.25), (1, 0, 0), None),
    "box at 45°, face to edge": (BLOCK, turned((2, 1)), (0.5 + 0.25 * HALF, 0.5 + 0.25 * HALF, 0.25), (1, 1, 0), None),
    "box at 45°, edge along edge": (BLOCK, turned((2, 1)), (0.5 + 0.5 * HALF, 0.5, 0.25), (1, 0, 0), None),
    "box at 45°, edge across edge": (BLOCK, turned((0, 1)), (0.25, 0.5, 0.5 + 0.5 * HALF), (0, 0, 1), None),
    "box on its tip, corner to face": (
        BLOCK,
        turned((1, TIP), (2, -1)),
        (0.5 + 0.25 * math.sqrt(3), 0.25, 0.25),
        (1, 0, 0),
        None,
    ),
    "sphere to face": (BALL, turned(), (0.25, 0.25, 0.75), (0, 0, 1), True),
    "sphere to edge": (Sphere(0.3125), turned(), (0.25, 0.6875, 0.75), (0, 3, 4), True),
    "sphere to corner": (Sphere(0.4375), turned(), (0.625, 0.6875, 0.875), (2, 3, 6), True),
    "capsule, cap to face": (ROD, turned(), (0.25, 0.25, 0.875), (0, 0, 1), False),
    "capsule, side to face": (ROD, turned(), (0.625, 0.25, 0.25), (1, 0, 0), False),
    "capsule, side to edge": (Capsule(0.3125, 0.5), turned(), (0.6875, 0.75, 0.25), (3, 4, 0), False),
    "capsule, cap to corner": (Capsule(0.4375, 0.5), turned(), (0.625, 0.6875, 1.125), (2, 3, 6), False),
    "capsule at 45°, side to edge": (ROD, turned((1, 1)), (0.5 + 0.125 * HALF, 0.25, -0.125 * HALF), (1, 0, -1), None),
}


def answers_at(name: str, gap: float) -> tuple[bool, bool, bool]:
    """Return the answers of the native checker, the torch checker and FCL at ``gap`` metres from a touch."""
    body, rotation, center, out, _ = TOUCHES[name]
    way = torch.nn.functional.normalize(torch.tensor(out, dtype=torch.float64), dim=0)
    pose = rigid(rotation, torch.tensor(center, dtype=torch.float64) + gap * way)[None].float()
    native, twin, oracle = (
        bool(checker(VOXEL, body).collides(pose)) for checker in (NativeChecker, TorchChecker, FclChecker)
    )
    return native, twin, oracle


@pytest.mark.parametrize("name", TOUCHES)
def test_a_touch_is_a_hit_and_a_gap_is_not(name):
    assert answers_at(name, -2e-5) == (True, True, True)
    assert answers_at(name, 2e-5) == (False, False, False)
    if (by_fcl := TOUCHES[name][4]) is not None:
        assert answers_at(name, 0.0) == (True, True, by_fcl)
    else:
        native, twin, _ = answers_at(name, 0.0)
        assert native or not twin  # when in doubt, the native checker reports a hit


@pytest.mark.parametrize("name", TOUCHES)
def test_a_move_that_ends_in_a_touch_hits_and_one_that_ends_before_does_not(name):
    body, rotation, center, out, by_fcl = TOUCHES[name]
    way = torch.nn.functional.normalize(torch.tensor(out, dtype=torch.float64), dim=0)
    gaps = torch.tensor([-2e-5, 2e-5] if by_fcl is None else [-2e-5, 2e-5, 0.0], dtype=torch.float64)
    end = rigid(rotation, torch.tensor(center, dtype=torch.float64) + gaps[:, None] * way).float()
    start = end.clone()
    start[:, :3, 3] += torch.tensor(out).float()
    for checker in (NativeChecker(VOXEL, body), TorchChecker(VOXEL, body)):
        assert checker.sweeps(start, end).tolist() == [True, False, True][: len(gaps)]
        assert (checker.free_fraction(start, end)[::2] > 0.999).all()


def test_a_body_sliding_along_a_wall_hits_it_and_one_sliding_beside_it_does_not():
    wall = Occupancy(np.ones((1, 8, 8), bool), (0, 0, 0), 0.5)  # up to x = 0.5
    start, end = (at((0.75, y, 2.0), (0.75 + 2e-5, y, 2.0)) for y in (0.5, 3.5))
    for body in (Box((0.5, 0.25, 0.125)), Sphere(0.25), Capsule(0.25, 0.5)):
        for checker in (NativeChecker(wall, body), TorchChecker(wall, body)):
            assert checker.sweeps(start, end).tolist() == [True, False]
