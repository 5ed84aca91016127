"""Heights of cameras count from the ground beneath them, whatever else lies higher or lower around."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from splatrl.capture import world
from splatrl.capture.base import Reconstruction
from splatrl.capture.drift import lost_scale
from splatrl.capture.ground import ERROR_DEG, MIN_INLIERS, find_ground
from splatrl.capture.world import LEVELS_ERROR, SCALE_ERROR, moved, place
from tests.capture.walks import ABOVE, CAMERAS, similarity_of, walk, without_points


def bent(rise: float, slope: float = 0.0) -> Reconstruction:
    """Return the walk on ground with a step at x = 0, or with a slope along x."""

    def raised(x: torch.Tensor) -> torch.Tensor:
        return rise * (x > 0) + slope * x

    poses, points = walk().camera_to_world.clone(), walk().points.clone()
    poses[:, 2, 3] += raised(poses[:, 0, 3])
    points[:, 2] += raised(points[:, 0])
    return replace(walk(), camera_to_world=poses, points=points)


def with_points(points: np.ndarray, by: torch.Tensor) -> Reconstruction:
    """Return the walk with further points, each seen by all of the given cameras."""
    found, more = walk(), torch.from_numpy(points)
    rows = len(found.points) + torch.arange(len(more))
    return replace(
        found,
        points=torch.cat([found.points, more]),
        colors=torch.cat([found.colors, found.colors[: len(more)]]),
        seen_point=torch.cat([found.seen_point, rows.repeat(len(by))]),
        seen_by=torch.cat([found.seen_by, by.repeat_interleave(len(rows))]),
    )


def scale_error(reconstruction: Reconstruction, said: float | None, remark: str | None) -> float:
    """Place a walk by the height of its cameras; return the error of the scale."""
    transform = similarity_of(0)
    placed = place(moved(reconstruction, transform), marker=None, camera_height=ABOVE)
    assert placed.scale_error == said and (placed.remarks == () if remark is None else remark in str(placed.remarks))
    whole = placed.world_from_capture.numpy() @ transform
    assert abs(whole[2, 3]) < 0.05, "the floor is where people stood"
    return abs(float(np.cbrt(np.linalg.det(whole[:3, :3]))) - 1.0)


def test_the_camera_s_height_counts_from_the_step_on_which_it_is() -> None:
    assert scale_error(bent(0.6), LEVELS_ERROR, "rises by 0.") < 0.05


@pytest.mark.parametrize("depth", [1.5, 6.0])
def test_a_street_below_a_terrace_is_not_its_floor(depth: float) -> None:
    generator = np.random.default_rng(0)
    street = generator.uniform([4.5, -4.0, -0.02], [10.0, 4.0, 0.02], (2000, 3)) - [0.0, 0.0, depth]
    terrace = with_points(street, torch.arange(10, 15))
    assert scale_error(terrace, SCALE_ERROR["camera_height"], f"{depth:.1f} m down") < 0.03
    assert lost_scale(place(terrace, marker=None, camera_height=ABOVE)) is None


def test_a_table_beside_the_path_is_not_the_ground() -> None:
    top = np.random.default_rng(0).uniform([1.0, -1.0, 0.78], [2.0, 1.0, 0.8], (2000, 3))
    assert scale_error(with_points(top, torch.arange(12)), SCALE_ERROR["camera_height"], None) < 0.03


def test_the_scale_has_no_known_error_where_much_lies_below_the_floor_near_the_path(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ground = find_ground(walk().camera_to_world.numpy(), walk().points.numpy())
    monkeypatch.setattr(world, "find_ground", lambda *_: ground)
    count = int((walk().points[:, 2].abs() < 0.1).sum())
    for share, much in ((0.1, False), (0.4, True)):
        pit = np.random.default_rng(0).uniform([-2.0, -2.0, -1.5], [2.0, 2.0, -0.2], (int(share * count), 3))
        placed = place(with_points(pit, torch.arange(CAMERAS)), marker=None, camera_height=ABOVE)
        assert (placed.scale_error is None) == much == ("Much lies below" in str(placed.remarks))


def test_a_floor_of_few_points_states_no_error_of_the_scale(monkeypatch: pytest.MonkeyPatch) -> None:
    ground = find_ground(walk().camera_to_world.numpy(), walk().points.numpy())
    for count, said in ((MIN_INLIERS, SCALE_ERROR["camera_height"]), (MIN_INLIERS - 1, None)):
        few = replace(ground, up_from="walls", error_deg=ERROR_DEG["walls"], inliers=count)
        monkeypatch.setattr(world, "find_ground", lambda *_, few=few: few)
        assert place(walk(), marker=None, camera_height=ABOVE).scale_error == said


def test_the_scale_has_no_known_error_where_the_ground_beneath_the_camera_is_not_seen() -> None:
    points = walk().points
    away = without_points(walk(), (points[:, 2] > 0.2) | (points[:, :2].norm(dim=1) < 0.6))
    assert scale_error(away, None, None) < 0.05


def test_the_possible_error_of_up_on_sloping_ground_is_at_least_the_slope() -> None:
    placed = place(bent(0.0, 0.12), marker=None, camera_height=ABOVE)
    third = placed.world_from_capture[2, :3]
    off = math.degrees(math.acos(third[2] / third.norm()))
    assert 5.0 < off < placed.up_error_deg + 0.5 and "slope by" in str(placed.remarks)


def test_the_possible_error_of_the_scale_grows_where_cameras_were_higher_above_ground_that_is_not_seen() -> None:
    found = bent(0.6)
    bare = (found.points[:, 0] > 0.0) & (found.points[:, 2] < 0.8)
    placed = place(without_points(found, ~bare), marker=None, camera_height=ABOVE)
    off = abs(float(np.cbrt(np.linalg.det(placed.world_from_capture[:3, :3].numpy()))) - 1.0)
    assert placed.remarks == () and placed.scale_error is not None and 0.15 < off < placed.scale_error + 0.01
