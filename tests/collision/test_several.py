"""Checkers of several scenes answer each row as the checker of its own scene does."""

import pickle
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from splatrl.bodies import Body, Box, Capsule, Sphere
from splatrl.collision import NativeChecker, Occupancy, TorchChecker
from splatrl.collision.base import Checker
from splatrl.collision.nothing import NoChecker
from splatrl.collision.several import SeveralCheckers
from splatrl.geometry import axis_rotations, rigid
from splatrl.native import _core

BODY = Box((0.3, 0.2, 0.1))
KINDS = [NativeChecker, TorchChecker, NoChecker]


def occupancies() -> list[Occupancy]:
    """Make three grids of different sizes, resolutions and positions."""
    generator = np.random.default_rng(0)
    shapes = [((12, 10, 8), 0.1, (-6, -5, -4)), ((20, 9, 7), 0.07, (-9, -4, -3)), ((5, 5, 5), 0.2, (-2, -3, -2))]
    return [Occupancy(generator.random(size) < 0.06, corner, edge) for size, edge, corner in shapes]


def poses(count: int, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    turn = axis_rotations(2, 6.3 * torch.rand(count, generator=generator))
    return rigid(turn, 0.8 * torch.rand(count, 3, generator=generator) - 0.4)


@pytest.mark.parametrize("kind", KINDS)
def test_each_row_gets_the_answers_of_its_own_scene(kind: Callable[[Occupancy, Box], Checker]) -> None:
    checkers = [kind(occupancy, BODY) for occupancy in occupancies()]
    count = 300
    start, end, scene = poses(count, 0), poses(count, 1), torch.arange(count) % 3
    several = SeveralCheckers(checkers).at(scene)
    queries = [
        (several.collides(start), lambda one: one.collides(start)),
        (several.free_fraction(start, end), lambda one: one.free_fraction(start, end)),
        (several.sweeps(start, end), lambda one: one.sweeps(start, end)),
        (several.clearance(start[:, :3, 3]), lambda one: one.clearance(start[:, :3, 3])),
    ]
    for answer, query in queries:
        alone = torch.stack([query(checker) for checker in checkers])
        assert torch.equal(answer, alone[scene, torch.arange(count)])
        if kind is not NoChecker:
            assert not torch.equal(answer, alone[0])


def test_native_answers_do_not_depend_on_the_order_or_number_of_rows() -> None:
    checkers = [NativeChecker(occupancy, BODY, threads=2) for occupancy in occupancies()]
    count = 10_000
    start, scene = poses(count, 2), torch.randint(3, (count,), generator=torch.Generator().manual_seed(0))
    several = SeveralCheckers(checkers)
    answers, order = several.at(scene).collides(start), torch.randperm(count)
    assert torch.equal(several.at(scene[order]).collides(start[order]), answers[order])
    assert torch.equal(several.at(scene[:7]).collides(start[:7]), answers[:7])
    assert torch.equal(pickle.loads(pickle.dumps(several)).at(scene).collides(start), answers)


@pytest.mark.parametrize("isa", _core.supported_isas())
@pytest.mark.parametrize("body", [BODY, Sphere(0.15), Capsule(0.1, 0.3)])
def test_native_rows_get_the_answers_of_their_own_scene_when_one_grid_is_empty(
    body: Body, isa: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SPLATRL_ISA", isa)
    checkers = [NativeChecker(occupancy, body) for occupancy in (*occupancies(), Occupancy.empty())]
    count = 77
    start, end = poses(count, 3), poses(count, 4)
    scene = torch.randint(4, (count,), generator=torch.Generator().manual_seed(1))
    several = SeveralCheckers(checkers).at(scene)
    for row in range(count):
        one, ends = checkers[int(scene[row])], (start[row : row + 1], end[row : row + 1])
        assert several.collides(start)[row] == one.collides(ends[0])[0]
        assert several.sweeps(start, end)[row] == one.sweeps(*ends)[0]
        assert several.free_fraction(start, end)[row] == one.free_fraction(*ends)[0]
    assert not several.sweeps(start, end)[scene == 3].any() and several.sweeps(start, end).any()


@pytest.mark.parametrize("scene", [3, -1])
def test_a_scene_index_out_of_range_is_refused(scene: int) -> None:
    several = SeveralCheckers([NativeChecker(occupancy, BODY) for occupancy in occupancies()])
    rows = torch.tensor([0, scene])
    for query in ("collides", "clearance"):
        values = poses(2, 0) if query == "collides" else torch.zeros(2, 3)
        with pytest.raises(ValueError, match="valid scene indices"):
            getattr(several.at(rows), query)(values)
    with pytest.raises(ValueError, match="valid scene indices"):
        several.at(rows).free_fraction(poses(2, 0), poses(2, 1))


def test_a_wrong_number_of_scene_indices_is_refused() -> None:
    several = SeveralCheckers([NativeChecker(occupancy, BODY) for occupancy in occupancies()])
    rows = several.at(torch.tensor([0, 1]))
    for query in (rows.collides, lambda here: rows.ranges(here, torch.eye(3), 1.0)):
        with pytest.raises(ValueError, match="scene: expected 3 scene indices, one per row, got 2"):
            query(poses(3, 0))


def test_rays_of_no_rows_and_of_scenes_that_do_not_exist() -> None:
    several = SeveralCheckers([NativeChecker(occupancy, BODY) for occupancy in occupancies()])
    none = torch.zeros(0, dtype=torch.int64)
    assert several.at(none).ranges(poses(0, 0), torch.eye(3), 1.0).shape == (0, 3)
    with pytest.raises(ValueError, match=r"scene: expected indices from 0 to 2, got \[0, 7\]"):
        several.at(torch.tensor([0, 7])).ranges(poses(2, 0), torch.eye(3), 1.0)


def test_checkers_for_different_bodies_are_refused() -> None:
    first, second, _ = occupancies()
    with pytest.raises(ValueError, match="expected at least one, all for one body"):
        SeveralCheckers([NativeChecker(first, BODY), NativeChecker(second, Sphere(0.1))])
