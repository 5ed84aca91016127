import numpy as np
import pytest

from splatrl.bodies import Box
from splatrl.building import build_world
from splatrl.collision import FclChecker, Occupancy
from splatrl.configuration import load_config
from splatrl.curriculum import plan

ROOM = ((0.0, 0.0, 0.0), (3.0, 2.0, 1.5))


def hollow(lower, upper, resolution=0.05) -> Occupancy:
    """Make a hollow box with walls one voxel thick."""
    low, high = np.array(lower), np.array(upper)
    walls = []
    for axis in range(3):
        for side in (0, 1):
            a, b = low.copy(), high.copy()
            a[axis], b[axis] = (
                (low[axis], low[axis] + resolution) if side == 0 else (high[axis] - resolution, high[axis])
            )
            walls.append((a, b))
    first, last = np.array(walls).transpose(1, 0, 2)
    return Occupancy.from_boxes(first, last, resolution)


def room_with_cupboard(gap: float = 0.0) -> Occupancy:
    """Make a closed room with a hollow cupboard whose front has a full-height gap of the given width."""
    room = hollow(*ROOM) | hollow((2.0, 0.5, 0.05), (2.6, 1.4, 0.9))
    return room.carved([[2.0, 0.9, 0.1]], [[2.05, 0.9 + gap, 0.85]]) if gap else room


INSIDE, MIDDLE = [[2.3, 0.95, 0.5]], [[1.0, 1.0, 0.5]]


def test_a_hollow_cupboard_becomes_solid_and_the_room_stays_free():
    filled = room_with_cupboard().solid(0.2, MIDDLE)
    assert filled.contains(INSIDE).all()
    assert filled.filled == round(0.5 * 0.8 * 0.75 / 0.05**3)
    assert filled.count == room_with_cupboard().count + filled.filled
    assert not filled.contains([[1.0, 1.0, 0.5], [0.07, 0.07, 0.07], [2.97 - 0.05, 1.93, 1.43], [1.97, 1.0, 0.5]]).any()


@pytest.mark.parametrize(("gap", "closed"), [(0.05, True), (0.1, True), (0.2, True), (0.25, False), (0.4, False)])
def test_openings_up_to_the_stated_width_are_closed(gap, closed):
    filled = room_with_cupboard(gap).solid(0.2, MIDDLE)
    assert filled.contains(INSIDE).all() == closed
    assert (filled.filled > 0) == closed


def test_with_a_width_of_zero_only_closed_cavities_are_filled():
    assert room_with_cupboard().solid(0.0, MIDDLE).contains(INSIDE).all()
    assert not room_with_cupboard(0.05).solid(0.0, MIDDLE).filled


def test_the_side_that_contains_the_seeds_stays_free():
    filled = room_with_cupboard().solid(0.2, INSIDE)
    assert filled.contains(MIDDLE).all()
    assert not filled.contains(INSIDE).any()


def test_a_few_seeds_on_the_wrong_side_do_no_harm():
    seeds = np.concatenate([np.array(INSIDE).repeat(3, 0), np.array(MIDDLE).repeat(4, 0)])
    filled = room_with_cupboard().solid(0.2, seeds)
    assert filled.contains(INSIDE).all()
    assert not filled.contains(MIDDLE).any()


def test_without_seeds_the_largest_region_stays_free():
    filled = room_with_cupboard().solid(0.2)
    assert filled.contains(INSIDE).all()
    assert not filled.contains(MIDDLE).any()


def test_a_seed_in_a_corner_too_narrow_for_the_ball_finds_the_room_beside_it():
    assert room_with_cupboard().solid(0.2, [[0.06, 0.06, 0.06]]).contains(INSIDE).all()


def test_a_cavity_that_opens_only_to_the_outside_of_the_grid_is_filled():
    backless = room_with_cupboard().carved([[0.0, 0.0, 0.0]], [[0.05, 2.0, 1.5]])  # one side of the room is open
    attic = hollow((1.0, 0.0, 1.45), (2.0, 2.0, 2.0)).carved([[1.0, 0.05, 1.95]], [[2.0, 1.9, 2.0]])
    filled = (backless | attic).solid(0.2, MIDDLE)
    assert filled.contains([[1.5, 1.0, 1.7]]).all()
    assert not filled.contains(MIDDLE).any()


def test_the_space_around_an_object_that_fills_its_grid_stays_free():
    block = Occupancy.from_boxes([[-0.5, -0.5, 0.0], [-0.2, -0.2, 0.0]], [[0.5, 0.5, 0.1], [0.2, 0.2, 1.0]], 0.05)
    seeds, around = [[1.0, 0.0, 0.5]], ((-1.2, -1.2, 0.4), (1.2, 1.2, 0.6))
    filled = block.solid(0.2, seeds, around)
    assert filled.keys().tolist() == block.keys().tolist()


def test_a_narrow_crevice_stays_free_near_its_mouth():
    filled = room_with_cupboard(0.1).solid(0.2, MIDDLE)
    assert not filled.contains([[2.02, 0.95, 0.5], [2.1, 0.95, 0.5]]).any()
    assert filled.contains([[2.4, 0.95, 0.5]]).all()


def test_without_free_space_near_the_seeds_nothing_is_filled_and_a_warning_says_so():
    with pytest.warns(UserWarning, match=r"fill: expected free space 0.2 m wide near the goal, found none"):
        filled = room_with_cupboard().solid(0.2, [[30.0, 0.0, 0.0]])
    assert filled.filled == 0
    with pytest.warns(UserWarning, match="nothing is filled"):
        assert Occupancy.empty().solid(0.2).count == 0


def test_an_empty_grid_is_only_as_large_as_the_space_around_the_robots() -> None:
    around = (100.0, 100.0, 0.0), (101.0, 101.0, 1.0)
    assert Occupancy.empty(0.05).solid(0.2, around=around, max_voxels=21**3).count == 0


def test_a_larger_grid_can_be_filled_and_get_boxes_when_it_is_allowed() -> None:
    box, around = hollow((0.2, 0.2, 0.2), (0.6, 0.6, 0.6)), ((-1.0, -1.0, 0.0), (1.0, 1.0, 1.0))  # 40 × 40 × 20 voxels
    with pytest.raises(ValueError, match="expected at most 31999 voxels"):
        box.solid(0.1, [[-0.5, -0.5, 0.5]], around, max_voxels=31_999)
    assert box.solid(0.1, [[-0.5, -0.5, 0.5]], around, max_voxels=32_000).count > box.count
    other = [[0.2, 0.2, 1.2]], [[0.3, 0.3, 1.4]]  # 8 × 8 × 24 voxels with it
    with pytest.raises(ValueError, match="expected at most 1535 voxels"):
        box.with_boxes(*other, max_voxels=1535)
    assert box.with_boxes(*other, max_voxels=1536).count > box.count


@pytest.mark.parametrize("opening", [-0.1, float("nan"), float("inf")])
def test_an_opening_that_is_not_a_valid_width_is_refused(opening):
    with pytest.raises(ValueError, match="fill: expected a number of metres, at least 0"):
        room_with_cupboard().solid(opening)


def test_malformed_seeds_and_corners_are_refused_by_name():
    with pytest.raises(ValueError, match=r"seeds: expected shape \[N, 3\], got \[3\]"):
        room_with_cupboard().solid(0.2, [0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="around: expected a lower corner"):
        room_with_cupboard().solid(0.2, MIDDLE, ((0, 0, 0), (1, 1, 0)))
    with pytest.raises(ValueError, match="expected at most"):
        room_with_cupboard().solid(0.2, MIDDLE, ((0, 0, 0), (1e3, 1e3, 1e3)))


@pytest.fixture(scope="module")
def worlds(shared_scenes):
    """Worlds of the kitchen for a robot at counter height, first hollow and then filled."""
    path = shared_scenes / "kitchen" / "kitchen.spz"
    common = ["scene=kitchen", f"scene.path={path}", "robot.height=0.4"]
    return [build_world(load_config([*common, f"collision.occupancy.fill={fill}"])) for fill in ("null", 0.2)]


def test_the_counters_of_a_kitchen_are_filled_and_its_middle_is_not(worlds):
    filled = worlds[1].occupancy
    rng = np.random.default_rng(0)
    counters = [((1.1, -0.8, 0.05), (1.6, 0.8, 0.75)), ((-0.9, -0.8, 0.05), (0.9, -0.4, 0.75))]
    counters.append(((-1.6, -0.8, 0.05), (-1.1, 0.8, 0.75)))
    for lower, upper in counters:
        places = rng.uniform(lower, upper, (4000, 3))
        assert worlds[0].occupancy.contains(places).mean() < 0.5
        assert filled.contains(places).mean() > 0.98
    assert filled.contains(rng.uniform((-0.7, 0.0, 0.1), (0.7, 0.8, 1.8), (4000, 3))).mean() < 0.01


def test_filling_the_kitchen_removes_no_start_that_reaches_the_goal(worlds):
    hollow_plan, filled_plan = worlds[0].plan, worlds[1].plan
    assert filled_plan.distance.tolist() == hollow_plan.distance.tolist()
    assert filled_plan.free.sum() < 0.8 * hollow_plan.free.sum()
    inside = hollow_plan.free & ~filled_plan.free
    assert (hollow_plan.distance[inside] < 0).all()


def test_filling_the_backyard_fills_the_shed_and_changes_no_distance():
    world = build_world(load_config(["collision.occupancy.fill=0.2"]))
    bare = Occupancy.from_scene(world.scene)
    before = plan(world.task.motion, FclChecker(bare, Box((0.4, 0.4, 0.1))), world.task.reached)
    assert world.occupancy.filled > 0
    assert world.plan.distance.tolist() == before.distance.tolist()
    shed = np.random.default_rng(0).uniform((-1.4, -3.4, 0.2), (0.6, -3.1, 1.6), (500, 3))
    assert world.occupancy.contains(shed).mean() > 0.98


def test_a_config_clears_and_adds_boxes():
    boxes = {"add": "[[[-0.9,-0.9,0.2],[-0.7,-0.7,0.5]]]", "clear": "[[[-0.2,-0.1,0.1],[0,1.5,0.7]]]"}
    world = build_world(load_config([f"collision.occupancy.{name}={box}" for name, box in boxes.items()]))
    garden_wall, block = [[-0.1, 0.7, 0.4]], [[-0.8, -0.8, 0.35]]
    assert world.occupancy.contains(block).all()
    assert not world.occupancy.contains(garden_wall).any()
    plain = build_world(load_config([]))
    assert not plain.occupancy.contains(block).any()
    assert plain.occupancy.contains(garden_wall).all()
