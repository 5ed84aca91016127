"""Ray casting for lidar: the ranges of every checker against ranges worked out by hand and by brute force."""

import copy
import math
import pickle

import numpy as np
import pytest
import torch
from torch import Tensor

from splatrl.bodies import Sphere
from splatrl.collision import CudaChecker, FclChecker, NativeChecker, NoChecker, Occupancy, TorchChecker
from splatrl.collision.rays import ranges_by_formula, room_around
from splatrl.geometry import rigid
from splatrl.native import _core
from tests.collision.cases import random_poses
from tests.collision.test_native import rooms
from tests.emulator import emulated

BODY = Sphere(0.1)
ALONG_X = torch.tensor([[1.0, 0.0, 0.0]])
GRAZE = 1e-7
"""Amount by which voxels are grown and shrunk to bound the range of a grazing ray, metres."""


def at(*places: tuple[float, float, float]) -> Tensor:
    return rigid(torch.eye(3).expand(len(places), 3, 3), torch.tensor(places))


def spread_beams(count: int, seed: int = 0) -> Tensor:
    """Return unit vectors along the axes, in the x-y plane and in random directions."""
    axes = torch.cat([torch.eye(3), -torch.eye(3)])
    flat = torch.randn(count // 4, 3, generator=torch.Generator().manual_seed(seed)) * torch.tensor([1.0, 1.0, 0.0])
    free = torch.randn(count, 3, generator=torch.Generator().manual_seed(seed + 1))
    return torch.nn.functional.normalize(torch.cat([axes, flat, free]), dim=1)


def bounds_by_formula(occupancy: Occupancy, poses: Tensor, beams: Tensor, reach: float) -> tuple[Tensor, Tensor]:
    """Return the ranges to slightly larger and slightly smaller voxels, between which rounding puts grazing rays."""
    keys = torch.from_numpy(occupancy.keys().T.astype(float)).unsqueeze(1)  # [3, 1, voxels]
    ways = beams.double() @ poses[:, :3, :3].double().mT
    ways = (ways / ways.norm(dim=2, keepdim=True)).reshape(-1, 3).T.unsqueeze(2)  # [3, rays, 1]
    start = poses[:, :3, 3].double().repeat_interleave(len(beams), 0)
    result = []
    for grown in (GRAZE, -GRAZE):
        low, high = keys * occupancy.resolution - grown, (keys + 1) * occupancy.resolution + grown
        nearest = torch.full((len(start),), reach, dtype=torch.float64)
        for rows in torch.arange(len(start)).split(16):
            ends = [(side - start[rows].T.unsqueeze(2)) / ways[:, rows] for side in (low, high)]
            first, last = torch.minimum(*ends), torch.maximum(*ends)
            near, far = first[0].maximum(first[1]).maximum(first[2]), last[0].minimum(last[1]).minimum(last[2])
            hit = torch.where((near <= far) & (far >= 0), near.clamp(min=0), torch.inf)
            nearest[rows] = torch.minimum(nearest[rows], hit.amin(1))
        result.append(nearest.reshape(len(poses), len(beams)))
    return result[0], result[1]


def makers() -> dict[str, type | object]:
    return {
        "native": NativeChecker,
        "torch": TorchChecker,
        "fcl": FclChecker,
        "cuda": lambda occupancy, body: CudaChecker(occupancy, body, load=emulated),
    }


@pytest.fixture(params=list(makers()))
def make(request: pytest.FixtureRequest):
    return makers()[request.param]


def scattered() -> Occupancy:
    """Make sparse random voxels in a non-cubic grid away from the origin."""
    solid = np.random.default_rng(1).random((23, 31, 17)) < 0.03
    return Occupancy(solid, (-40, 12, 3), 0.1)


def test_a_beam_ends_where_it_enters_a_voxel(make):
    wall = Occupancy.from_boxes([[1.0, -1.0, 0.0]], [[1.1, 1.0, 2.0]], 0.1)
    checker = make(wall, BODY)
    beams = torch.tensor([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]])
    ranges = checker.ranges(at((0.25, 0.05, 1.05)), beams, 10.0)
    assert ranges.shape == (1, 5) and ranges.dtype == torch.float32
    expected = [0.75, 10.0, 10.0, 1.25, 0.9375]  # the third beam passes beside the wall, at y = 1.05
    torch.testing.assert_close(ranges[0], torch.tensor(expected), atol=1e-6, rtol=0)


def test_the_range_is_zero_inside_a_voxel_and_never_exceeds_the_reach(make):
    wall = Occupancy.from_boxes([[1.0, -1.0, 0.0]], [[1.1, 1.0, 2.0]], 0.1)
    checker = make(wall, BODY)
    ranges = checker.ranges(at((1.05, 0.03, 1.03), (0.0, 0.03, 1.03), (-20.0, 0.03, 1.03)), ALONG_X, 0.9)
    assert ranges.tolist() == [[0.0], [pytest.approx(0.9)], [pytest.approx(0.9)]]
    assert float(checker.ranges(at((-20.0, 0.03, 1.03)), ALONG_X, 30.0)) == pytest.approx(21.0, abs=1e-5)


def test_in_an_empty_grid_every_range_is_the_reach(make):
    checker = make(Occupancy.empty(), BODY)
    assert (checker.ranges(at((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)), spread_beams(8), 7.5) == 7.5).all()
    assert NoChecker(Occupancy.empty(), BODY).ranges(at((0, 0, 0)), ALONG_X, 7.5).tolist() == [[7.5]]


@pytest.mark.parametrize("place", ["rooms", "scattered"])
def test_ranges_lie_within_the_bounds_of_a_brute_force_cast(place):
    occupancy = rooms() if place == "rooms" else scattered()
    lower, upper = occupancy.bounds
    poses = random_poses(30, lower - 0.4, upper + 0.4)
    poses[::2, :3, :3] = torch.eye(3)  # keeps axis-aligned beams axis-aligned
    beams = spread_beams(60)
    least, most = bounds_by_formula(occupancy, poses, beams, 3.0)
    assert ((most - least) < 1e-5).double().mean() > 0.98  # few rays graze
    for name, count in (("native", 30), ("cuda", 8)):
        found = makers()[name](occupancy, BODY).ranges(poses[:count], beams, 3.0).double()
        assert ((found >= least[:count] - 1e-6) & (found <= most[:count] + 1e-6)).all(), name
        assert 0.1 < (found < 3.0).double().mean() < 0.95


def test_the_readable_reference_agrees_except_for_grazing_rays():
    occupancy = rooms()
    poses, beams = random_poses(20, *occupancy.bounds), spread_beams(40)
    native = NativeChecker(occupancy, BODY).ranges(poses, beams, 3.0)
    assert ((native - ranges_by_formula(occupancy, poses, beams, 3.0)).abs() < 1e-5).double().mean() > 0.995


def test_a_row_has_the_same_range_alone_and_with_any_number_of_threads():
    occupancy = scattered()
    poses, beams = random_poses(700, *occupancy.bounds), spread_beams(20)
    one, two = NativeChecker(occupancy, BODY, 1), NativeChecker(occupancy, BODY, 2)
    whole = one.ranges(poses, beams, 3.0)
    assert torch.equal(whole, two.ranges(poses, beams, 3.0))
    for row in (0, 5, 699):
        assert torch.equal(whole[row : row + 1], one.ranges(poses[row : row + 1], beams, 3.0))
    assert torch.equal(whole, pickle.loads(pickle.dumps(one)).ranges(poses, beams, 3.0))
    assert torch.equal(whole, copy.deepcopy(one).ranges(poses, beams, 3.0))


@pytest.mark.parametrize("isa", _core.supported_isas())
def test_every_instruction_set_gives_the_same_bytes(isa, monkeypatch):
    occupancy = scattered()
    poses, beams = random_poses(50, *occupancy.bounds), spread_beams(30)
    expected = NativeChecker(occupancy, BODY).ranges(poses, beams, 3.0)
    monkeypatch.setenv("SPLATRL_ISA", isa)  # each new ray caster reads it
    assert _core.isa() == isa
    assert torch.equal(NativeChecker(occupancy, BODY).ranges(poses, beams, 3.0), expected)


def test_room_is_the_chebyshev_distance_to_the_nearest_solid_voxel():
    solid = np.zeros((5, 4, 3), bool)
    solid[1, 2, 0] = True
    room = room_around(Occupancy(solid, (0, 0, 0), 0.1))
    for x, y, z in np.ndindex(5, 4, 3):
        assert room[z, x, y] == max(abs(x - 1), abs(y - 2), z)


@pytest.mark.parametrize("make", [NativeChecker, TorchChecker, FclChecker])
def test_invalid_beams_reaches_and_poses_are_refused(make):
    checker = make(rooms(), BODY)
    with pytest.raises(ValueError, match=r"beams: expected unit vectors, got .* in row 1"):
        checker.ranges(at((0.0, 0.0, 0.0)), torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), 1.0)
    with pytest.raises(ValueError, match=r"beams: expected shape"):
        checker.ranges(at((0.0, 0.0, 0.0)), torch.ones(2, 2), 1.0)
    for reach in (0.0, math.inf, math.nan):
        with pytest.raises(ValueError, match="reach"):
            checker.ranges(at((0.0, 0.0, 0.0)), ALONG_X, reach)
    with pytest.raises(ValueError, match="body_to_world"):
        checker.ranges(torch.zeros(1, 4, 4), ALONG_X, 1.0)


def test_a_gpu_records_invalid_beams_and_poses_as_faults_and_refuses_wrong_shapes_at_once():
    checker = CudaChecker(rooms(), BODY, load=emulated)
    beams = torch.tensor([[1.0, 0.0, 0.0], [0.0, math.nan, 0.0], [0.0, 0.0, 0.0]])
    found = checker.ranges(at((0.0, 1.0, 0.5)), beams, 1.0)
    assert found[0, 0] > 0.0 and (found[0, 1:] == 0.0).all()
    with pytest.raises(ValueError, match="row 0"):
        checker.raise_faults()
    with pytest.raises(ValueError, match="reach"):
        checker.ranges(at((0.0, 0.0, 0.0)), ALONG_X, 0.0)
    with pytest.raises(ValueError, match="beams"):
        checker.ranges(at((0.0, 0.0, 0.0)), torch.ones(2, 2), 1.0)
    assert checker.ranges(torch.zeros(1, 4, 4), ALONG_X, 1.0) == 0.0
    with pytest.raises(ValueError, match="row 0"):
        checker.raise_faults()
