"""The native checker against FCL and the readable torch checker: only touches within rounding may differ."""

import copy
import math
import pickle

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from splatrl.bodies import Body, Box, Capsule, Sphere
from splatrl.collision import FclChecker, Occupancy, TorchChecker, verify, verify_sweeps
from splatrl.collision.displacement import Displacement
from splatrl.collision.native import NativeChecker
from splatrl.geometry import axis_rotations, quats_to_rotations, rigid
from splatrl.native import _core
from tests.collision.cases import (
    BODIES,
    CUBE,
    EMPTY,
    assert_nothing_hit,
    assert_only_a_way_through_hits,
    at,
    clutter,
    random_poses,
)

SURE = 1e-5
"""Distance from a touch, metres, below which FCL's own rounding decides."""
SCENES = ("clutter", "rooms")


def rooms() -> Occupancy:
    """Make thin walls with a door, a floor and a table, shifted off the origin."""
    lower = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 1.6, 0.0], [0.7, 1.2, 0.6], [0.7, 1.2, 0.0]]
    upper = [
        [4.0, 3.0, 0.05],
        [0.05, 3.0, 1.5],
        [2.05, 0.7, 1.5],
        [2.05, 3.0, 1.5],
        [1.5, 1.9, 0.65],
        [0.75, 1.25, 0.6],
    ]
    shift = [-1.3, 0.4, -0.35]
    return Occupancy.from_boxes(np.add(lower, shift), np.add(upper, shift), 0.05)


@pytest.fixture(scope="module")
def scenes() -> dict[str, Occupancy]:
    return {"clutter": clutter(), "rooms": rooms()}


def poses_in(occupancy: Occupancy, count: int, seed: int = 0) -> torch.Tensor:
    lower, upper = occupancy.bounds
    return random_poses(count, lower - 0.3, upper + 0.3, seed)


def moves_in(occupancy: Occupancy, count: int, turning: bool, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the start and end poses of random moves of up to 0.5 m along each axis."""
    start = poses_in(occupancy, count, seed)
    generator = torch.Generator().manual_seed(seed + 1)
    way = torch.rand(count, 3, generator=generator) - 0.5
    turn = 0.3 * torch.randn(count, 4, generator=generator) + torch.tensor([1.0, 0.0, 0.0, 0.0])
    rotation = start[:, :3, :3] @ quats_to_rotations(turn) if turning else start[:, :3, :3]
    return start, rigid(rotation, start[:, :3, 3] + way)


def hit_in_100_steps(oracle: FclChecker, start: torch.Tensor, end: torch.Tensor) -> torch.Tensor:
    move = Displacement(start.double(), end.double(), oracle.body.radius, 1.0)
    move.steps.fill_(100)
    hits = torch.zeros(len(start), dtype=torch.bool)
    for steps in torch.arange(101).split(10):
        open_ = (~hits).nonzero()[:, 0]
        poses = move.at(open_.repeat_interleave(len(steps)), steps.repeat(len(open_)))
        hits[open_] = oracle.collides(poses).reshape(len(open_), len(steps)).any(1)
    return hits


def assert_parity(occupancy: Occupancy, body: Body, count: int, seed: int = 0) -> None:
    found = verify(NativeChecker(occupancy, body), FclChecker(occupancy, body), poses_in(occupancy, count, seed))
    print(found)
    assert 0.05 * count < found.hits < 0.95 * count
    assert not found.beyond(SURE), str(found)


def assert_nothing_missed(occupancy: Occupancy, body: Body, count: int, turning: bool) -> None:
    start, end = moves_in(occupancy, count, turning)
    hits = hit_in_100_steps(FclChecker(occupancy, body), start, end)
    missed = (hits & ~NativeChecker(occupancy, body).sweeps(start, end)).nonzero()[:, 0]
    assert 0.1 * count < hits.sum() < 0.95 * count
    # a graze is not a miss: compare pose by pose with a body smaller by FCL's rounding
    closer = hit_in_100_steps(FclChecker(occupancy, smaller(body)), start[missed], end[missed])
    assert not closer.any(), f"missed in rows {missed[closer].tolist()}"


def smaller(body: Body) -> Body:
    match body:
        case Box():
            return Box(tuple(extent - 2 * SURE for extent in body.size))
        case Sphere():
            return Sphere(body.radius - SURE)
        case Capsule():
            return Capsule(body.cap_radius - SURE, body.length)


@pytest.mark.parametrize("count", [3000, pytest.param(100_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("name", SCENES)
def test_poses_differ_from_fcl_only_within_rounding(scenes, name, body, count):
    assert_parity(scenes[name], body, count)


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("name", SCENES)
def test_poses_get_the_same_answers_from_the_torch_checker(scenes, name, body):
    occupancy = scenes[name]
    found = verify(NativeChecker(occupancy, body), TorchChecker(occupancy, body), poses_in(occupancy, 3000, 2))
    assert found.hits > 100
    assert not found.beyond(1e-6), str(found)


@pytest.mark.parametrize("count", [200, pytest.param(5000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("turning", [False, True])
@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("name", SCENES)
def test_a_sweep_misses_nothing_that_fcl_finds_in_a_hundred_steps(scenes, name, body, turning, count):
    assert_nothing_missed(scenes[name], body, count, turning)


@pytest.mark.parametrize("count", [250, pytest.param(4000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("name", SCENES)
def test_straight_sweeps_get_the_same_answers_from_the_torch_checker(scenes, name, body, count):
    occupancy = scenes[name]
    start, end = moves_in(occupancy, count, turning=False, seed=3)
    native, twin = NativeChecker(occupancy, body), TorchChecker(occupancy, body)
    found = verify_sweeps(native, twin, start, end)
    assert 0.1 * count < found.hits < 0.95 * count
    assert not found.beyond(1e-6), str(found)
    same = torch.ones(len(start), dtype=torch.bool)
    same[[one.row for one in found.disagreements]] = False
    short = (twin.free_fraction(start, end) - native.free_fraction(start, end))[same]
    assert short.min() > -1e-5
    assert short.max() < 2e-3  # for a body that comes in at a slant, a micrometre of slack is this much of the move


@pytest.mark.parametrize("body", BODIES)
def test_turning_sweeps_differ_from_the_torch_checker_only_near_a_touch(scenes, body):
    occupancy = scenes["rooms"]
    start, end = moves_in(occupancy, 150, turning=True, seed=5)
    found = verify_sweeps(NativeChecker(occupancy, body), TorchChecker(occupancy, body), start, end)
    assert found.hits > 30
    assert not found.beyond(2 * 0.2 * math.sqrt(3) * occupancy.resolution), str(found)


@pytest.mark.parametrize("turning", [False, True])
@pytest.mark.parametrize("body", BODIES)
def test_the_free_fraction_is_free_and_below_1_exactly_where_something_is_hit(scenes, body, turning):
    occupancy = scenes["rooms"]
    checker = NativeChecker(occupancy, body)
    start, end = moves_in(occupancy, 1000, turning, seed=7)
    fraction = checker.free_fraction(start, end)
    assert torch.equal(fraction < 1, checker.sweeps(start, end))
    assert ((fraction >= 0) & (fraction <= 1)).all()
    assert (fraction[checker.collides(start)] == 0).all()
    assert not (checker.collides(end) & (fraction == 1)).any()
    way = (end - start)[:, :3, 3].double()
    stopped = rigid(start[:, :3, :3].double(), start[:, :3, 3].double() + fraction[:, None].double() * way)
    some = (fraction > 0) & (fraction < 1)
    assert some.any()
    if not turning:
        assert not TorchChecker(occupancy, smaller(body)).collides(stopped[some]).any()


@settings(max_examples=40)
@given(
    quat=st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.1),
    place=st.tuples(st.floats(-0.9, 0.9), st.floats(0.1, 1.6), st.floats(-0.4, 0.8)),
    body=st.sampled_from(BODIES),
)
def test_any_rotation_gets_the_same_answer_from_the_torch_checker(quat, place, body):
    occupancy = clutter()
    pose = at(place, rotation=quats_to_rotations(torch.tensor([quat]))[0])
    found = verify(NativeChecker(occupancy, body), TorchChecker(occupancy, body), pose)
    assert not found.beyond(1e-6), str(found)


@settings(max_examples=30)
@given(
    quarters=st.tuples(*[st.integers(0, 7)] * 3),
    place=st.tuples(*[st.integers(-6, 10)] * 3),
    way=st.tuples(*[st.integers(-6, 6)] * 3),
    body=st.sampled_from([Box((0.5, 0.25, 0.125)), Sphere(0.25), Capsule(0.125, 0.5)]),
)
def test_degenerate_rotations_and_moves_get_the_same_answers_from_the_torch_checker(quarters, place, way, body):
    """Rotations by multiples of 45° and moves on a lattice make edges parallel and touches exact everywhere."""
    occupancy = Occupancy(np.random.default_rng(0).random((3, 4, 2)) < 0.2, (0, 0, 0), 0.5)
    rotation = torch.eye(3)
    for axis, quarter in enumerate(quarters):
        rotation = rotation @ axis_rotations(axis, torch.tensor(quarter * math.pi / 4))
    start, end = (
        at(tuple(0.25 * (p + w) for p, w in zip(place, o, strict=True)), rotation=rotation) for o in ((0, 0, 0), way)
    )
    native, twin = NativeChecker(occupancy, body), TorchChecker(occupancy, body)
    assert not verify(native, twin, start).beyond(2e-6)
    assert not verify_sweeps(native, twin, start, end).beyond(2e-6)


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 63, 5000])
def test_neither_threads_nor_the_batch_size_change_an_answer(scenes, threads, count):
    body = BODIES[0]
    one = NativeChecker(scenes["rooms"], body, threads=1)
    many = NativeChecker(scenes["rooms"], body, threads=threads)
    start, end = moves_in(scenes["rooms"], 5000, turning=False)
    assert torch.equal(many.collides(start[:count]), one.collides(start)[:count])
    assert torch.equal(many.sweeps(start[:count], end[:count]), one.sweeps(start, end)[:count])
    assert torch.equal(many.free_fraction(start[:count], end[:count]), one.free_fraction(start, end)[:count])


def answers(checker: NativeChecker, start: torch.Tensor, end: torch.Tensor) -> list[torch.Tensor]:
    return [checker.collides(start), checker.sweeps(start, end), checker.free_fraction(start, end)]


@pytest.mark.parametrize("body", BODIES)
def test_an_answer_does_not_depend_on_the_simd_lane_or_the_rest_of_the_batch(scenes, body):
    checker = NativeChecker(scenes["rooms"], body)
    start, end = moves_in(scenes["rooms"], 80, turning=False)
    expected = answers(checker, start, end)
    assert 5 < expected[0].sum() < expected[1].sum() < 75
    for count in range(1, 40):
        for mine, whole in zip(answers(checker, start[-count:], end[-count:]), expected, strict=True):
            assert torch.equal(mine, whole[-count:])


@pytest.mark.parametrize("isa", _core.supported_isas())
@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("name", SCENES)
def test_every_instruction_set_gives_the_same_answers(scenes, name, body, isa, monkeypatch):
    moves = [moves_in(scenes[name], 300, turning) for turning in (False, True)]
    expected = [answers(NativeChecker(scenes[name], body), *ends) for ends in moves]
    monkeypatch.setenv("SPLATRL_ISA", isa)  # each new checker reads it
    mine = [answers(NativeChecker(scenes[name], body), *ends) for ends in moves]
    assert all(
        torch.equal(a, b) for some, same in zip(mine, expected, strict=True) for a, b in zip(some, same, strict=True)
    )


@pytest.mark.parametrize("aside", [0.0, 1e-9, 3e-7, 1e-5])
@pytest.mark.parametrize("back", [1.0, -1.0])
def test_sweeping_a_capsule_along_its_axis_equals_a_longer_capsule(scenes, aside, back):
    start = poses_in(scenes["rooms"], 2000).double()
    forward, sideways = start[:, :3, 2], start[:, :3, 0]
    middle, end = start.clone(), start.clone()
    middle[:, :3, 3] += 0.15 * back * forward
    end[:, :3, 3] += 0.3 * back * forward + aside * sideways
    hits = NativeChecker(scenes["rooms"], Capsule(0.1, 0.4)).sweeps(start.float(), end.float())
    tight, wide = (
        NativeChecker(scenes["rooms"], Capsule(0.1 + off, 0.7)).collides(middle.float())
        for off in (-2 * SURE, 2 * SURE)
    )
    assert 300 < tight.sum() <= wide.sum() < 1700
    assert ((hits >= tight) & (hits <= wide)).all()


@pytest.mark.parametrize("body", BODIES)
def test_a_body_whose_middle_is_in_a_solid_voxel_hits_however_thin_it_is(body):
    thin = {Box: Box((0.4, 0.3, 1e-3)), Sphere: Sphere(1e-3), Capsule: Capsule(1e-3, 0.4)}[type(body)]
    spots = at((0.03, 0.04, 0.05), (0.0, 0.02, 0.02), (0.1, 0.1, 0.1), (0.102, 0.1, 0.1))
    checker = NativeChecker(Occupancy(np.ones((1, 1, 1), bool), (0, 0, 0), 0.1), thin)
    touched = [True, True, True, type(body) is Box]  # the long side of the box reaches back
    assert checker.collides(spots).tolist() == touched
    away = at((1.0, 1.0, 1.0)).expand(4, 4, 4)
    assert checker.sweeps(spots, away).tolist() == checker.sweeps(away, spots).tolist() == touched
    assert (checker.free_fraction(spots, away) == 0).tolist() == touched


@pytest.mark.parametrize("row", [0, 5, 31, 32, 39])
def test_the_first_of_several_invalid_poses_is_named(row):
    checker = NativeChecker(CUBE, Box((0.2, 0.2, 0.2)))
    bad = at(*[(0.0, 0.0, 0.0)] * 41)
    bad[row, 0, 3], bad[40, 1, 1] = math.nan, 2.0
    with pytest.raises(ValueError, match=f"body_to_world: expected finite numbers, got .* in row {row}"):
        checker.collides(bad)


@pytest.mark.parametrize("body", BODIES)
def test_nothing_is_hit_in_an_empty_grid_or_outside_the_grid(body):
    for empty in EMPTY:
        assert_nothing_hit(NativeChecker(empty, body))
    assert_only_a_way_through_hits(NativeChecker(CUBE, body))


@pytest.mark.parametrize("height", [0, 70, 127, 128, 255])
@pytest.mark.parametrize("body", BODIES)
def test_a_move_up_a_tall_column_hits_the_voxel_at_any_height(body, height):
    tall = np.zeros((1, 1, 256), bool)
    tall[0, 0, height] = True
    checker = NativeChecker(Occupancy(tall, (0, 0, 0), 0.1), body)
    start, end = at((0.05, 0.05, -1.0)), at((0.05, 0.05, 27.0))
    assert checker.sweeps(start, end).all()
    assert checker.sweeps(end, start).all()
    free = checker.free_fraction(start, end).item() * 28.0
    reach = body.size[2] / 2 if isinstance(body, Box) else body.radius
    assert free == pytest.approx(1.0 + 0.1 * height - reach, abs=1e-3)


@pytest.mark.parametrize(
    "shape",
    [
        (0, 0, 0),
        (3, 4, 5),
    ],
)
def test_clearance_is_infinite_where_nothing_is_solid(shape):
    empty = Occupancy(np.zeros(shape, bool), (0, 0, 0), 0.1)
    assert NativeChecker(empty, Sphere(0.1)).clearance(torch.zeros(3, 3)).isinf().all()


def test_clearance_is_a_tight_lower_bound_of_the_distance():
    occupancy = rooms()
    points = poses_in(occupancy, 2000)[:, :3, 3]
    bound = NativeChecker(occupancy, Sphere(0.1)).clearance(points)
    near = torch.from_numpy(occupancy.contains(points))
    assert near.any()
    assert (bound[near] == 0).all()
    distance = TorchChecker(occupancy, Sphere(0.1)).clearance(points[:200])
    assert (bound[:200] <= distance + 1e-5).all()
    of_field = FclChecker(occupancy, Sphere(0.1)).clearance(points)
    assert (bound <= of_field + 1e-6).all()
    assert (bound >= of_field - 0.01 * occupancy.resolution).all()


def test_poses_that_are_not_rigid_are_refused_by_row():
    checker = NativeChecker(CUBE, Box((0.2, 0.2, 0.2)))
    good = at(*[(0.0, 0.0, 0.0)] * 3)
    for spoil, message in (
        (math.nan, "finite numbers"),
        (math.inf, "finite numbers"),
        (3.0, "an orthonormal rotation"),
    ):
        bad = good.clone()
        bad[1, 0, 0] = spoil
        with pytest.raises(ValueError, match=f"body_to_world: expected {message}, got .* in row 1"):
            checker.collides(bad)
        with pytest.raises(ValueError, match=f"end: expected {message}, got .* in row 1"):
            checker.free_fraction(good, bad)
        with pytest.raises(ValueError, match=f"start: expected {message}, got .* in row 1"):
            checker.sweeps(bad, good)
    with pytest.raises(ValueError, match="expected a rotation, not a reflection"):
        checker.collides(torch.diag(torch.tensor([1.0, 1.0, -1.0, 1.0]))[None])
    with pytest.raises(ValueError, match=r"body_to_world: expected shape \[B, 4, 4\], got \[4, 4\]"):
        checker.collides(torch.eye(4))
    with pytest.raises(ValueError, match="end: expected 3 poses, as many as in start, got 2"):
        checker.sweeps(good, good[:2])
    with pytest.raises(ValueError, match=r"points: expected finite coordinates, got .* in row 1"):
        checker.clearance(torch.tensor([[0.0, 0.0, 0.0], [math.nan, 0.0, 0.0]]))


def test_strided_and_double_poses_are_read_correctly(scenes):
    occupancy = scenes["clutter"]
    checker, poses = NativeChecker(occupancy, BODIES[0]), poses_in(occupancy, 500)
    expected = checker.collides(poses)
    assert torch.equal(checker.collides(poses.double()), expected)
    assert torch.equal(checker.collides(poses.mT.contiguous().mT), expected)
    assert torch.equal(checker.collides(poses[::3]), expected[::3])
    assert torch.equal(checker.clearance(poses[:, :3, 3]), checker.clearance(poses[:, :3, 3].contiguous()))


@pytest.mark.parametrize("body", BODIES)
def test_copies_and_pickles_give_the_same_answers(scenes, body):
    checker = NativeChecker(scenes["clutter"], body, threads=1)
    poses = poses_in(scenes["clutter"], 300)
    for twin in (pickle.loads(pickle.dumps(checker)), copy.deepcopy(checker)):
        assert (twin.body, twin.threads) == (body, 1)
        assert torch.equal(twin.collides(poses), checker.collides(poses))


@pytest.mark.parametrize("length", [0.3, 1.0, 2.0])
@pytest.mark.parametrize("gap", [1e-4, 1e-3, 5e-3])
def test_a_capsule_that_glides_past_an_edge_without_touching_it_is_free(length: float, gap: float) -> None:
    kerb = Occupancy.from_boxes([[2.0, 0.0, -0.05]], [[2.05, 1.0, 0.0]], 0.05)
    body, across = Capsule(0.1, length), axis_rotations(1, torch.tensor(math.pi / 2))
    for sign in (1.0, -1.0):
        aside = (0.1 + sign * gap) / math.sqrt(2)
        start = rigid(across, torch.tensor([0.2, -aside, aside]))[None]
        end = start.clone()
        end[:, 0, 3] = 4.0
        answers = [checker(kerb, body) for checker in (NativeChecker, TorchChecker)]
        assert [bool(one.sweeps(start, end)) for one in answers] == [sign < 0] * 2
        native, oracle = (float(one.free_fraction(start, end)) for one in answers)
        assert native == pytest.approx(oracle, abs=1e-5) if sign < 0 else native == 1.0


@pytest.mark.parametrize("aside", [1.0, 1e-3, 1e-5, 1e-7])
def test_a_capsule_hits_a_voxel_up_to_the_distance_at_which_the_torch_checker_does(aside: float) -> None:
    voxel, body = Occupancy.from_boxes([[0.0, 0.0, 0.0]], [[0.2, 0.2, 0.2]], 0.2), Capsule(0.1, 0.4)
    start = random_poses(300, np.full(3, -1.0), np.full(3, 1.0), seed=3).double()
    generator = torch.Generator().manual_seed(4)
    way = 0.3 * start[:, :3, 2] + aside * (torch.rand(300, 3, generator=generator).double() - 0.5)
    towards = torch.nn.functional.normalize(torch.randn(300, 3, generator=generator).double(), dim=1)

    def hits(checker: type[NativeChecker] | type[TorchChecker], away: torch.Tensor) -> torch.Tensor:
        middle = 0.1 + away[:, None] * towards
        moves = (rigid(start[:, :3, :3], middle + share * way).float() for share in (-0.5, 0.5))
        return checker(voxel, body).sweeps(*moves)

    low, high = torch.zeros(300).double(), torch.full((300,), 2.0).double()
    for _ in range(20):
        middle = 0.5 * (low + high)
        hit = hits(TorchChecker, middle)
        low, high = torch.where(hit, middle, low), torch.where(hit, high, middle)
    assert hits(NativeChecker, low - SURE).all()
    assert not hits(NativeChecker, high + SURE).any()
