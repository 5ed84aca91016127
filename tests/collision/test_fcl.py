import copy
import math
import pickle

import fcl
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from splatrl.bodies import Box, Capsule, Sphere
from splatrl.collision import FclChecker, Occupancy
from splatrl.collision.fcl import _octree, fcl_octrees
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


@pytest.mark.parametrize(
    ("body", "reach"),
    [(Box((0.4, 0.2, 0.6)), (0.2, 0.1, 0.3)), (Sphere(0.25), (0.25,) * 3), (Capsule(0.1, 0.5), (0.1, 0.1, 0.35))],
)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_body_hits_a_voxel_once_its_surface_reaches_it(body, reach, axis):
    poses = []
    for gap in (1e-3, -1e-3):
        above, below = torch.full((3,), 0.05), torch.full((3,), 0.05)
        above[axis], below[axis] = 0.1 + reach[axis] + gap, -reach[axis] - gap
        poses += [above, below]
    hits = FclChecker(CUBE, body).collides(rigid(torch.eye(3), torch.stack(poses)))
    assert hits.tolist() == [False, False, True, True]


def test_whether_a_box_hits_depends_on_its_rotation():
    checker = FclChecker(CUBE, Box((0.4, 0.1, 0.1)))
    beside = (0.05, 0.28, 0.05)  # 0.18 m beside the voxel: the box reaches 0.05 m, turned it reaches 0.2 m
    assert checker.collides(at(beside)).tolist() == [False]
    assert checker.collides(at(beside, rotation=axis_rotations(2, torch.tensor(math.pi / 2)))).tolist() == [True]
    assert checker.collides(at(beside, rotation=axis_rotations(2, torch.tensor(-1.4)))).tolist() == [True]
    assert checker.collides(at(beside, rotation=axis_rotations(1, torch.tensor(math.pi / 2)))).tolist() == [False]


def test_positive_yaw_turns_counter_clockwise():
    checker = FclChecker(Occupancy.from_keys([[1, 1, 0]], 0.1), Box((0.4, 0.02, 0.02)))
    yaw = torch.tensor([math.pi / 4, -math.pi / 4])
    poses = rigid(axis_rotations(2, yaw), torch.tensor([0.0, 0.0, 0.05]).expand(2, 3))
    assert checker.collides(poses).tolist() == [True, False]


@pytest.mark.parametrize("body", BODIES)
def test_the_distance_field_shortcut_does_not_change_fcls_answers(body):
    occupancy = clutter(1, 0.01)
    lower, upper = occupancy.bounds
    poses = random_poses(4000, lower - 0.4, upper + 0.4, 1)
    (tree,) = fcl_octrees(occupancy)
    match body:
        case Box():
            shape = fcl.Box(*body.size)
        case Sphere():
            shape = fcl.Sphere(body.radius)
        case Capsule():
            shape = fcl.Capsule(body.cap_radius, body.length)
    raw = []
    for pose in poses.double().numpy():
        item = fcl.CollisionObject(shape, fcl.Transform(pose[:3, :3], pose[:3, 3]))
        raw.append(fcl.collide(item, tree, fcl.CollisionRequest(), fcl.CollisionResult()) > 0)
    hits = FclChecker(occupancy, body).collides(poses)
    assert 0 < hits.sum() < len(poses)
    assert hits.tolist() == raw


def test_octree_bytes_are_passed_unsigned_where_char_is_unsigned(monkeypatch):
    known, given = _octree(CUBE), []

    def unsigned(resolution, stream):
        given.append(stream)
        if stream.min() < 0:
            raise OverflowError("can't convert negative value to char")
        return known

    monkeypatch.setattr(fcl, "OcTree", unsigned)
    assert FclChecker(CUBE, Sphere(0.1)).collides(at((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))).tolist() == [True, False]
    signed, bare = given
    assert signed.min() < 0 and signed.tobytes() == bare.tobytes() and bare.dtype == np.uint8


def test_a_hit_does_not_carry_over_to_later_poses():
    checker = FclChecker(CUBE, Box((0.6, 0.1, 0.1)))
    near, far = (0.05, 0.05, 0.05), (0.05, 0.05, 0.2)  # 0.05 m away, too near for the distance field to decide
    assert checker.collides(at(near, far, near, far, far)).tolist() == [True, False, True, False, False]
    assert checker.collides(at(far)).tolist() == [False]
    assert checker.clearance(torch.tensor([far])) < checker.body.radius


@pytest.mark.parametrize("empty", EMPTY)
@pytest.mark.parametrize("body", BODIES)
def test_nothing_collides_where_nothing_is_solid(empty, body):
    assert_nothing_hit(FclChecker(empty, body))


def test_empty_batches_give_empty_answers():
    assert_empty_answers(FclChecker(CUBE, Sphere(0.1)))


def test_answers_have_the_promised_dtypes():
    checker = FclChecker(CUBE, Sphere(0.1))
    pose = at((0.3, 0.0, 0.0))
    assert checker.collides(pose).dtype == torch.bool
    assert checker.free_fraction(pose, pose).dtype == torch.float32
    assert checker.sweeps(pose, pose).dtype == torch.bool
    assert checker.clearance(torch.zeros(2, 3)).dtype == torch.float32


def test_invalid_poses_that_fcl_would_call_free_are_refused():
    checker = FclChecker(CUBE, Box((0.2, 0.2, 0.2)))
    poses = at((0.0, 0.0, 0.0), (0.0, math.nan, 0.0), (math.nan, 0.0, 0.0))
    with pytest.raises(ValueError, match=r"body_to_world: expected finite numbers, got .* in row 1"):
        checker.collides(poses)
    with pytest.raises(ValueError, match=r"end: expected finite numbers, got .* in row 1"):
        checker.free_fraction(at(*[(0.0, 0.0, 0.0)] * 3), poses)
    mirrored = torch.diag(torch.tensor([1.0, 1.0, -1.0, 1.0]))[None]
    with pytest.raises(ValueError, match="start: expected a rotation, not a reflection"):
        checker.sweeps(mirrored, mirrored)


@pytest.mark.parametrize("body", BODIES)
def test_a_sweep_finds_the_thin_wall_that_both_ends_miss(body):
    wall = Occupancy(np.ones((1, 20, 20), bool), (10, -10, -10), 0.05)
    checker = FclChecker(wall, body)
    start, end = at((-0.4, 0.02, 0.01)), at((1.4, 0.02, 0.01))
    assert not checker.collides(torch.cat([start, end])).any()
    assert checker.sweeps(start, end).tolist() == [True]
    assert checker.sweeps(start, at((0.1, 0.02, 0.01))).tolist() == [False]


def test_a_turn_hits_what_lies_between_its_ends():
    rod = Box((0.8, 0.04, 0.04))
    checker = FclChecker(Occupancy.from_keys([[2, 2, 0]], 0.1), rod)  # 45° to the left, 0.35 m away
    right, left, back = (
        at((0.0, 0.0, 0.05), rotation=axis_rotations(2, torch.tensor(yaw))) for yaw in (0.2, 1.4, -1.2)
    )
    assert not checker.collides(torch.cat([right, left, back])).any()
    assert checker.sweeps(right, left).tolist() == [True]
    assert checker.sweeps(right, back).tolist() == [False]


def test_the_free_fraction_ends_at_the_last_free_step():
    wall = Occupancy(np.ones((1, 20, 20), bool), (10, -10, -10), 0.05)  # from x = 0.5
    checker = FclChecker(wall, Box((0.2, 0.1, 0.1)))  # so the origin is stopped at x = 0.4
    start = at((0.0, 0.01, 0.0), (0.0, 0.01, 0.0), (0.45, 0.01, 0.0), (0.0, 0.01, 0.0))
    end = at((1.0, 0.01, 0.0), (0.41, 0.01, 0.0), (0.0, 0.01, 0.0), (0.39, 0.01, 0.0))
    fraction = checker.free_fraction(start, end)
    steps = 40  # 1 m in steps of half a voxel
    assert 0.4 - 1 / steps <= fraction[0] <= 0.4
    assert 0.41 * fraction[1] <= 0.4 < 0.41
    assert fraction[2] == 0.0
    assert fraction[3] == 1.0
    assert checker.sweeps(start, end).tolist() == [True, True, True, False]


@pytest.mark.parametrize("body", BODIES)
def test_the_pose_at_the_free_fraction_is_free(body):
    checker = FclChecker(clutter(), body)
    start, end = (random_poses(200, (-0.8, 0.2, -0.3), (0.8, 1.5, 0.7), seed) for seed in (4, 5))
    end[:, :3, :3] = start[:, :3, :3]
    fraction = checker.free_fraction(start, end)
    stopped = start.clone()
    stopped[:, :3, 3] += fraction[:, None] * (end - start)[:, :3, 3]
    assert ((fraction > 0) & (fraction < 1)).any()
    assert not checker.collides(stopped)[fraction > 0].any()
    assert (fraction[checker.collides(start)] == 0.0).all()


@settings(max_examples=15)
@given(seed=st.integers(0, 10_000), body=st.sampled_from(BODIES))
def test_a_sweep_includes_its_ends_and_is_the_same_in_both_directions(seed, body):
    checker = FclChecker(clutter(seed, 0.01), body)
    start, end = (random_poses(20, (-0.8, 0.2, -0.3), (0.8, 1.5, 0.7), seed + k) for k in (0, 1))
    swept = checker.sweeps(start, end)
    assert torch.equal(swept, checker.sweeps(end, start))
    assert (swept >= (checker.collides(start) | checker.collides(end))).all()
    assert torch.equal(checker.sweeps(start, start), checker.collides(start))


@pytest.mark.parametrize("body", BODIES)
def test_copies_and_pickles_give_the_same_answers(body):
    checker = FclChecker(clutter(), body)
    poses = random_poses(100, (-0.8, 0.2, -0.3), (0.8, 1.5, 0.7))
    for twin in (pickle.loads(pickle.dumps(checker)), copy.deepcopy(checker)):
        assert twin.body == body
        assert torch.equal(twin.collides(poses), checker.collides(poses))


def test_a_body_whose_clearance_exceeds_its_radius_is_free():
    occupancy = clutter()
    checker = FclChecker(occupancy, Sphere(0.17))
    poses = random_poses(500, (-1.5, -0.5, -1.0), (1.5, 2.0, 1.5))
    clear = checker.clearance(poses[:, :3, 3]) > 0.17
    assert clear.any()
    assert not checker.collides(poses)[clear].any()


def test_an_occupancy_beyond_the_range_of_the_octree_is_refused():
    with pytest.raises(ValueError, match="expected voxel keys in"):
        FclChecker(Occupancy.from_points([[400.0, 0.0, 0.0]], 0.01), Sphere(0.1))


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("blocks", [0.25, 0.4, 30.0])
def test_one_octree_per_block_gives_the_same_answers_as_a_single_octree(body, blocks):
    occupancy = clutter()
    one, many = FclChecker(occupancy, body), FclChecker(occupancy, body, blocks=blocks)
    poses, ends = (random_poses(400, (-0.9, 0.1, -0.4), (0.9, 1.6, 0.8), seed) for seed in (0, 1))
    hits = one.collides(poses)
    assert 0 < hits.sum() < len(hits)
    assert torch.equal(many.collides(poses), hits)
    assert torch.equal(many.free_fraction(poses[:40], ends[:40]), one.free_fraction(poses[:40], ends[:40]))


def test_every_block_that_contains_a_voxel_has_an_octree():
    occupancy = Occupancy.from_keys([[0, 0, 0], [3, 3, 3], [4, 0, 0], [-1, 0, 0], [-4, 3, 3], [-5, 0, 0]], 0.1)
    assert len(fcl_octrees(occupancy)) == 1
    assert len(fcl_octrees(occupancy, 0.4)) == 4
    assert len(fcl_octrees(occupancy, 100.0)) == 2
    assert fcl_octrees(Occupancy.empty(), 0.4) == []


def test_copies_keep_their_block_size_and_invalid_block_sizes_are_refused():
    assert copy.deepcopy(FclChecker(CUBE, Sphere(0.1), blocks=0.5)).blocks == 0.5
    for blocks in (0.0, -4.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="blocks: expected a number of metres above 0"):
            FclChecker(CUBE, Sphere(0.1), blocks=blocks)
    assert not FclChecker(Occupancy.empty(), Sphere(0.1), blocks=4.0).collides(at((0.0, 0.0, 0.0))).any()
