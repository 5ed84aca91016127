"""The layers that are drawn over the splats."""

from pathlib import Path

import numpy as np
import pytest

from splatrl.collision import Occupancy
from splatrl.collision.point_clouds import write_points
from splatrl.envs.world import World
from splatrl.viewer.layers import box_lines, free_places, path_lines, surface


def test_a_voxel_has_six_faces_that_face_outwards() -> None:
    vertices, triangles = surface(Occupancy.from_keys([[2, -1, 5]], 0.1))
    assert vertices.shape == (24, 3) and triangles.shape == (12, 3)
    middle = np.array([0.25, -0.05, 0.55])
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    assert ((normals * ((a + b + c) / 3 - middle)).sum(1) > 0).all()
    assert 0.5 * np.linalg.norm(normals, axis=1).sum() == pytest.approx(6 * 0.01, rel=1e-4)
    assert vertices.min(0) == pytest.approx([0.2, -0.1, 0.5], abs=1e-6)


def test_faces_between_solid_voxels_are_left_out() -> None:
    assert len(surface(Occupancy.from_keys([[0, 0, 0], [0, 1, 0]], 0.1))[1]) == 2 * 10


def test_a_large_surface_is_shown_more_coarsely() -> None:
    occupancy = Occupancy.from_boxes([[-1.0, -1.0, 0.0]], [[1.0, 1.0, 0.5]], 0.05)
    fine, _ = surface(occupancy)
    coarse, triangles = surface(occupancy, most=1000)
    assert len(triangles) <= 2000 < len(fine) / 2
    assert coarse.min(0) == pytest.approx([-1.0, -1.0, 0.0], abs=1e-6) and coarse.max(0)[2] == pytest.approx(0.6)


def test_an_empty_grid_has_no_surface() -> None:
    vertices, triangles = surface(Occupancy.empty())
    assert len(vertices) == len(triangles) == 0


def test_free_places_are_those_of_the_free_states(world: World) -> None:
    leads, others = free_places(world.plan)
    free = world.task.motion.planar(world.plan.states[world.plan.free])[:, :2].numpy()
    assert len(leads) + len(others) == len(np.unique(free.round(4), axis=0))
    assert (leads[:, 2] == world.robot.height).all()
    start = world.task.motion.planar(world.plan.starts)[:, :2].numpy()
    assert {tuple(place) for place in start.round(3)} <= {tuple(place) for place in leads[:, :2].astype(float).round(3)}


def test_a_box_has_twelve_edges() -> None:
    lines = box_lines(((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)))
    lengths = np.abs(lines[:, 0] - lines[:, 1])
    assert sorted(lengths.sum(1).tolist()) == [1.0] * 4 + [2.0] * 4 + [3.0] * 4
    assert ((lengths > 0).sum(1) == 1).all()
    assert len(np.unique(lines.reshape(-1, 6), axis=0)) == 12


def test_a_path_is_drawn_only_if_the_folder_has_one(tmp_path: Path) -> None:
    assert path_lines(tmp_path, "path.ply") is None
    walk = np.array([[0, 0, 1], [1, 0, 1], [1, 2, 1]], np.float32)
    write_points(tmp_path / "path.ply", walk)
    assert np.array_equal(path_lines(tmp_path, "path.ply"), np.stack([walk[:-1], walk[1:]], 1))
