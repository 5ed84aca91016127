"""The GPU checker against the CPU checker: its kernels run in an emulation and, where there is one, on a GPU."""

import math
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from splatrl.bodies import Body, Box, Capsule, Sphere
from splatrl.collision import CudaChecker, NativeChecker, Occupancy, cuda, verify, verify_sweeps
from splatrl.collision.cuda import kernel_defines
from splatrl.device_faults import Faulty
from splatrl.geometry import axis_rotations, rigid
from tests.collision.cases import (
    BODIES,
    CUBE,
    EMPTY,
    assert_empty_answers,
    assert_nothing_hit,
    assert_only_a_way_through_hits,
    at,
    clutter,
    random_poses,
)
from tests.collision.test_native import moves_in, poses_in, rooms
from tests.emulator import emulated

SURE = 1e-7
"""Finest margin that ``verify`` resolves, metres. A GPU rounds differently because it fuses multiply and add."""
SCENES = ("clutter", "rooms", "fine")
Make = Callable[[Occupancy, Body], CudaChecker]


@pytest.fixture(scope="module")
def scenes() -> dict[str, Occupancy]:
    """Occupancies by name.

    Columns of "fine" span more than two words, and its bodies touch more columns than a warp reads at once.
    """
    fine = np.random.default_rng(3).random((40, 30, 150)) < 0.0005
    fine[:, :, 20] |= np.random.default_rng(4).random((40, 30)) < 0.7
    return {"clutter": clutter(), "rooms": rooms(), "fine": Occupancy(fine, (-11, 5, -70), 0.02)}


@pytest.fixture(params=["emulated", pytest.param("gpu", marks=pytest.mark.gpu)])
def make(request: pytest.FixtureRequest) -> Make:
    """Return a function that makes checkers, emulated or on a GPU."""
    if request.param == "gpu":
        device = request.getfixturevalue("cuda_device")
        return lambda occupancy, body: CudaChecker(occupancy, body, device=device)
    return emulated_checker


def emulated_checker(occupancy: Occupancy, body: Body) -> CudaChecker:
    """Make a checker whose kernels run on the CPU."""
    return CudaChecker(occupancy, body, load=emulated)


@dataclass
class There:
    """Gives a checker tensors on its own device, which it reads in place, and returns its answers on the CPU."""

    checker: CudaChecker

    def __getattr__(self, name: str) -> Any:
        asked = getattr(self.checker, name)
        if not callable(asked):
            return asked
        return lambda *values: asked(*(value.to(self.checker.device) for value in values)).cpu()


@dataclass
class Swept:
    """A checker that returns precomputed answers."""

    body: Body
    swept: Tensor

    def sweeps(self, start: Tensor, end: Tensor) -> Tensor:
        """Return the precomputed answers."""
        assert len(start) == len(end) == len(self.swept)
        return self.swept


def assert_same_moves(checker: CudaChecker, native: NativeChecker, start: Tensor, end: Tensor) -> Tensor:
    """Assert that moves get the same answers as on the CPU, and return which of them hit."""
    there = There(checker)
    swept = there.sweeps(start, end)
    found = verify_sweeps(Swept(checker.body, swept), native, start, end)
    assert not found.beyond(SURE), str(found)
    free, expected = there.free_fraction(start, end), native.free_fraction(start, end)
    hits = free < 1
    assert torch.equal(hits, swept)
    both = hits & (expected < 1)
    assert (free - expected)[both].abs().max() < 2e-6
    assert (hits != (expected < 1)).sum() <= len(found.disagreements) + 1
    return hits


@pytest.mark.parametrize("count", [2000, pytest.param(100_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("name", SCENES)
def test_every_pose_gets_the_same_answer_as_on_the_cpu(make, scenes, name, body, count):
    poses = poses_in(scenes[name], count)
    found = verify(There(make(scenes[name], body)), NativeChecker(scenes[name], body), poses)
    assert 0.05 * count < found.hits < 0.95 * count
    assert not found.beyond(SURE), str(found)


@pytest.mark.parametrize("body", [Sphere(0.5), Capsule(0.5, 0.5), Box((1.0, 1.0, 1.0))])
def test_poses_that_are_barely_orthonormal_get_the_same_answer_as_on_the_cpu(make, body):
    wall = Occupancy.from_boxes([(2.0, 0.0, 0.0)], [(3.0, 3.0, 3.0)])
    turned = torch.tensor([[1.0, 1.0, 1.0], [-2.0, 1.0, 1.0], [0.0, -1.0, 1.0]], dtype=torch.float64)
    turned = torch.nn.functional.normalize(turned, dim=1) @ (torch.eye(3, dtype=torch.float64) + 0.00045)
    gaps = torch.linspace(-1e-3, 1e-3, 41, dtype=torch.float64)[:, None]
    reach = 0.5 + (0.25 * turned[0, 2] if isinstance(body, Capsule) else 0.0)
    places = torch.tensor([2.0 - reach, 1.51, 1.51], dtype=torch.float64) - gaps * torch.eye(3, dtype=torch.float64)[0]
    poses = rigid(turned.expand(41, 3, 3), places).float()
    hits = There(make(wall, body)).collides(poses)
    assert torch.equal(hits, NativeChecker(wall, body).collides(poses))


@pytest.mark.parametrize("count", [400, pytest.param(50_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("turning", [False, True])
@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("name", SCENES)
def test_every_move_gets_the_same_answer_as_on_the_cpu(make, scenes, name, body, turning, count):
    occupancy = scenes[name]
    start, end = moves_in(occupancy, count, turning)
    hits = assert_same_moves(make(occupancy, body), NativeChecker(occupancy, body), start, end)
    assert 0.1 * count < hits.sum() < 0.97 * count


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("name", ["rooms", "fine"])
def test_long_moves_and_turns_on_the_spot_get_the_same_answers_as_on_the_cpu(make, scenes, name, body):
    occupancy = scenes[name]
    start, other = poses_in(occupancy, 60), poses_in(occupancy, 60, seed=1)
    here, there, turned = start[:, :3, 3], other[:, :3, 3], other[:, :3, :3]
    for end in (rigid(start[:, :3, :3], there), rigid(turned, here), rigid(turned, there)):
        assert_same_moves(make(occupancy, body), NativeChecker(occupancy, body), start, end)


@pytest.mark.parametrize("body", [Box((0.5, 0.25, 0.125)), Sphere(0.25), Capsule(0.125, 0.5)])
def test_parallel_edges_and_exact_touches_get_the_same_answers_as_on_the_cpu(make, body):
    """Rotations are multiples of 45° about the axes; positions and moves lie on a lattice."""
    occupancy = Occupancy(np.random.default_rng(0).random((3, 4, 2)) < 0.2, (0, 0, 0), 0.5)
    generator = torch.Generator().manual_seed(0)
    rotation = torch.eye(3).expand(800, 3, 3)
    for axis in range(3):
        eighths = torch.randint(8, (800,), generator=generator)
        rotation = rotation @ axis_rotations(axis, eighths * math.pi / 4)
    places = 0.25 * torch.randint(-1, 8, (800, 3), generator=generator)
    ways = 0.25 * torch.randint(-6, 7, (800, 3), generator=generator)
    start, end = rigid(rotation, places), rigid(rotation, places + ways)
    checker, native = make(occupancy, body), NativeChecker(occupancy, body)
    found = verify(There(checker), native, start)
    assert found.hits > 100
    assert not found.beyond(SURE), str(found)
    assert_same_moves(checker, native, start, end)


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("name", SCENES)
def test_clearance_is_the_same_as_on_the_cpu(make, scenes, name, body):
    points = poses_in(scenes[name], 1000)[:, :3, 3]
    found, expected = (
        There(make(scenes[name], body)).clearance(points),
        NativeChecker(scenes[name], body).clearance(points),
    )
    assert (expected == 0).any()
    assert torch.allclose(found, expected, rtol=1e-6, atol=1e-7)
    assert torch.equal(found == 0, expected == 0)


@pytest.mark.parametrize("most_blocks", [1, 3, 2**16])
def test_an_answer_does_not_depend_on_the_rest_of_the_batch(make, scenes, monkeypatch, most_blocks):
    monkeypatch.setattr(cuda, "_MOST_BLOCKS", most_blocks)
    there = There(make(scenes["rooms"], BODIES[0]))
    start, end = moves_in(scenes["rooms"], 2500, turning=False)

    def answers(start: Tensor, end: Tensor) -> list[Tensor]:
        moves, poses = [there.sweeps(start, end), there.free_fraction(start, end)], there.collides(start)
        return [*moves, poses, there.clearance(start[:, :3, 3])]

    whole, order = answers(start, end), torch.randperm(2500, generator=torch.Generator().manual_seed(1))
    assert 0 < whole[0].sum() < 2500
    assert torch.equal(whole[0], NativeChecker(scenes["rooms"], BODIES[0]).sweeps(start, end))
    for count in (1, 31, 33, 2500):
        rows = order[:count]
        for some, all_ in zip(answers(start[rows], end[rows]), whole, strict=True):
            assert torch.equal(some, all_[rows])


def test_the_order_of_threads_does_not_change_the_answers(scenes):
    start, end = moves_in(scenes["fine"], 200, turning=True)
    checker = emulated_checker(scenes["fine"], BODIES[0])
    fraction, hits = checker.free_fraction(start, end), checker.collides(start)
    for seed in (1, 2, 3):
        checker._kernels.seed = seed
        assert torch.equal(checker.free_fraction(start, end), fraction)
        assert torch.equal(checker.collides(start), hits)


@pytest.mark.parametrize("body", BODIES)
def test_nothing_is_hit_in_an_empty_grid_or_outside_the_grid(make, body):
    for empty in EMPTY:
        assert_nothing_hit(There(make(empty, body)))
    assert_only_a_way_through_hits(There(make(CUBE, body)))


def test_empty_batches_give_empty_answers(make):
    assert_empty_answers(There(make(CUBE, BODIES[0])))


SPOILT = {
    "NaN rotation": lambda pose: pose[0, 1].fill_(math.nan),
    "infinite position": lambda pose: pose[2, 3].fill_(math.inf),
    "stretched axis": lambda pose: pose[1, 1].fill_(1.01),
    "reflection": lambda pose: pose[2, 2].mul_(-1.0),
    "wrong last row": lambda pose: pose[3, 0].fill_(0.1),
    "scale in the last row": lambda pose: pose[3, 3].fill_(2.0),
}


@pytest.mark.parametrize("how", SPOILT)
def test_an_invalid_pose_counts_as_a_hit_and_its_row_is_reported(make, how):
    checker = make(CUBE, BODIES[0])
    assert isinstance(checker, Faulty)
    good = at(*[(3.0, 0.0, 0.0)] * 70).to(checker.device)
    bad = good.clone()
    for row in (66, 41):
        SPOILT[how](bad[row])
    told = "row 41: expected finite numbers and, for a pose, an orthonormal rotation"
    for ask in (lambda: checker.collides(bad), lambda: checker.sweeps(bad, good), lambda: checker.sweeps(good, bad)):
        assert ask().nonzero().flatten().tolist() == [41, 66]
        checker.sweeps(good, good)  # a valid batch does not clear the fault
        with pytest.raises(ValueError, match=told):
            checker.raise_faults()
        checker.raise_faults()
    fraction = checker.free_fraction(good, bad)
    assert fraction[[41, 66]].tolist() == [0.0, 0.0]
    assert fraction.sum() == 68
    with pytest.raises(ValueError, match=told):
        checker.raise_faults()


def test_an_invalid_point_has_zero_clearance_and_its_row_is_reported(make):
    checker = make(CUBE, BODIES[0])
    points = torch.full((5, 3), 2.0)
    points[3, 2], points[4, 0] = math.nan, -math.inf
    assert (checker.clearance(points.to(checker.device)) == 0).tolist() == [False, False, False, True, True]
    with pytest.raises(ValueError, match="row 3: expected finite numbers"):
        checker.raise_faults()
    checker.raise_faults()


def test_rotations_are_refused_where_the_cpu_refuses_them(make):
    """Each decides with its own arithmetic whether a pose is rigid."""
    checker, native = make(CUBE, BODIES[1]), NativeChecker(CUBE, BODIES[1])
    generator = torch.Generator().manual_seed(0)
    poses = random_poses(400, (1, 1, 1), (2, 2, 2))
    poses[:, :3, :3] += 4e-4 * torch.randn(400, 3, 3, generator=generator)
    refused = []
    for pose in poses.split(1):
        try:
            native.collides(pose)
            refused.append(False)
        except ValueError:
            refused.append(True)
    expected = torch.tensor(refused)
    assert 50 < expected.sum() < 350
    assert torch.equal(There(checker).collides(poses), expected)


def test_wrong_shapes_and_bodies_are_refused_at_once(make):
    checker = make(CUBE, BODIES[0])
    poses = at(*[(0.0, 0.0, 0.0)] * 3)
    with pytest.raises(ValueError, match=r"body_to_world: expected shape \[B, 4, 4\], got \[4, 4\]"):
        checker.collides(torch.eye(4))
    with pytest.raises(ValueError, match=r"end: expected shape \[B, 4, 4\], got \[3, 3, 4\]"):
        checker.sweeps(poses, poses[:, :3])
    with pytest.raises(ValueError, match="end: expected 3 poses, as many as in start, got 2"):
        checker.free_fraction(poses, poses[:2])
    with pytest.raises(ValueError, match=r"points: expected shape \[B, 3\], got \[3, 4\]"):
        checker.clearance(torch.zeros(3, 4))
    with pytest.raises(ValueError, match="body: expected a Box, a Sphere or a Capsule, got 'box'"):
        kernel_defines("box")


def test_strided_double_and_unaligned_poses_are_read_correctly(make, scenes):
    checker = make(scenes["clutter"], BODIES[0])
    poses = poses_in(scenes["clutter"], 300).to(checker.device)
    expected = checker.collides(poses)
    assert 0 < expected.sum() < 300
    shifted = torch.empty(300 * 16 + 1, device=checker.device)[1:].view(300, 4, 4).copy_(poses)
    assert shifted.data_ptr() % 16 == 4
    for same in (poses.double(), poses.mT.contiguous().mT, shifted):
        assert torch.equal(checker.collides(same), expected)
    assert torch.equal(checker.collides(poses[::3]), expected[::3])
    assert torch.equal(checker.clearance(poses[:, :3, 3]), checker.clearance(poses[:, :3, 3].contiguous()))


def test_tensors_on_another_device_are_copied_and_invalid_ones_are_refused_at_once(make, scenes, monkeypatch):
    checker, native = make(scenes["rooms"], BODIES[0]), NativeChecker(scenes["rooms"], BODIES[0])
    if checker.device.type == "cpu":  # here no tensor is on another device, so pretend
        monkeypatch.setattr(checker, "_faults_for", lambda *values: checker._faults_elsewhere)
    start, end = moves_in(scenes["rooms"], 100, turning=False)
    assert torch.equal(checker.sweeps(start, end), native.sweeps(start, end))
    assert checker.clearance(start[:, :3, 3]).device.type == "cpu"
    bad = end.clone()
    bad[7, 0, 0] = math.nan
    with pytest.raises(ValueError, match=r"end: expected finite numbers, got .* in row 7"):
        checker.sweeps(start, bad)
    with pytest.raises(ValueError, match=r"points: expected finite coordinates, got .* in row 0"):
        checker.clearance(torch.full((1, 3), math.nan))
    checker.raise_faults()


@pytest.mark.gpu
@pytest.mark.parametrize("body", BODIES)
def test_queries_never_synchronise_and_can_be_captured_in_a_cuda_graph(cuda_device, scenes, body):
    checker = CudaChecker(scenes["rooms"], body, cuda_device)
    start, end = (poses.to(cuda_device) for poses in moves_in(scenes["rooms"], 500, turning=True))
    expected = checker.free_fraction(start, end), checker.sweeps(start, end), checker.collides(start)
    try:
        torch.cuda.set_sync_debug_mode("error")
        checker.sweeps(start, end), checker.collides(start), checker.clearance(start[:, :3, 3])
    finally:
        torch.cuda.set_sync_debug_mode("default")
    graph = torch.cuda.CUDAGraph()
    given = start.flip(0).clone(), end.flip(0).clone()
    with torch.cuda.graph(graph):
        answers = checker.free_fraction(*given), checker.sweeps(*given), checker.collides(given[0])
    for to, values in zip(given, (start, end), strict=True):
        to.copy_(values)
    graph.replay()
    assert all(torch.equal(*pair) for pair in zip(answers, expected, strict=True))


@pytest.mark.gpu
def test_a_pickled_checker_gives_the_same_answers(cuda_device, scenes):
    checker = CudaChecker(scenes["clutter"], BODIES[2], cuda_device)
    poses = poses_in(scenes["clutter"], 300).to(cuda_device)
    twin = pickle.loads(pickle.dumps(checker))
    assert (twin.body, twin.device) == (checker.body, checker.device)
    assert torch.equal(twin.collides(poses), checker.collides(poses))
