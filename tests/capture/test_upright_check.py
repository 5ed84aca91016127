"""Where a camera looks straight down, sweeps up and down or is upside down, up is right or its error unknown."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import ArrayLike

from splatrl.capture.base import Photos, Reconstruction
from splatrl.capture.check import Quality
from splatrl.capture.folder import problems
from splatrl.capture.ground import held_by
from splatrl.capture.held import share_along
from splatrl.capture.suggestions import NOTHING
from splatrl.capture.upright_check import why_not_upright
from splatrl.capture.world import SCALE_ERROR, Placed, moved, place
from splatrl.evaluation.phone_walk import camera_poses
from tests.capture.walks import ABOVE, CAMERAS, similarity_of, walk, without_points

T = np.linspace(0.0, 1.0, CAMERAS)


def filmed(x: ArrayLike, y: ArrayLike, z: ArrayLike, yaw: ArrayLike, pitch_deg: ArrayLike) -> Reconstruction:
    """Return the yard filmed by other cameras, positions in metres, heading in radians, hands that tremble by 1.5°."""
    columns = (x, y, z, yaw, -np.radians(pitch_deg), 0.0)
    path = np.stack([np.broadcast_to(np.asarray(column, float), CAMERAS) for column in columns], 1)
    path[:, 3:5] += np.random.default_rng(0).normal(0.0, math.radians(1.5), (CAMERAS, 2))
    return replace(walk(), camera_to_world=camera_poses(torch.from_numpy(path)).double())


def survey(heading: ArrayLike = 0.0) -> Reconstruction:
    """Return a drone's survey: lanes along the yard, 2.5 m above it, looking straight down."""
    return filmed(1.2 * T - 0.6, 2.0 * np.cos(5 * math.pi * T), 2.5, heading, -90.0)


def sweeping() -> Reconstruction:
    """Return a walk straight ahead, with the camera swept up and down by 35°."""
    return filmed(3.0 * T - 1.5, 0.02 * np.sin(40 * T), ABOVE, 0.0, 35.0 * np.sin(25.0 * T) - 20.0)


def rolled(found: Reconstruction, degrees: float) -> Reconstruction:
    """Return a reconstruction whose images are rotated about their viewing directions."""
    turn = torch.eye(4).double()
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    turn[:2, :2] = torch.tensor([[cos, -sin], [sin, cos]])
    return replace(found, camera_to_world=found.camera_to_world @ turn)


def off_deg(placed: Placed) -> float:
    """Return the angle between up and the truth, degrees."""
    up = placed.world_from_capture[2, :3]
    return math.degrees(math.acos(float((up[2] / up.norm()).clamp(-1.0, 1.0))))


def refused(found: Reconstruction) -> str | None:
    return why_not_upright(found, Photos([], 320, 180, torch.zeros(0)))


def test_the_share_of_a_path_along_a_direction_counts_its_whole_extent() -> None:
    centers = np.array([[3.0, 4.0, 7.0], [-3.0, -4.0, 7.0]])
    assert share_along(centers, np.array([0.0, 1.0, 0.0])) == pytest.approx(0.8)
    assert share_along(centers, np.array([0.0, 0.0, 1.0])) == 0.0 == share_along(centers[:1], np.array([0.0, 1.0, 0.0]))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("heading", [0.0, math.pi * (np.floor(5 * T) % 2), 6.0 * T], ids=["one way", "ahead", "round"])
def test_up_is_behind_cameras_that_look_straight_down_however_they_are_turned(seed: int, heading: ArrayLike) -> None:
    transform = similarity_of(seed)
    found = moved(survey(heading), transform)
    up = transform[:3, 2] / np.linalg.norm(transform[:3, 2])
    assert held_by(found.camera_to_world.numpy(), found.points.numpy()).up @ up > math.cos(math.radians(3.0))
    whole = place(found, marker=None, camera_height=2.5).world_from_capture.numpy() @ transform
    assert whole[2, 2] / np.linalg.norm(whole[2, :3]) > math.cos(math.radians(1.5))


@pytest.mark.parametrize("pitch_deg", [-45.0, -60.0])
def test_up_is_across_the_path_of_a_steady_camera_that_looks_steeply_down_ahead_but_uncertain(pitch_deg: float) -> None:
    placed = place(filmed(3.0 * T - 1.5, 0.02 * np.sin(40 * T), ABOVE, 0.0, pitch_deg), marker=None)
    assert off_deg(placed) < 1.5 and placed.up_error_deg is None


def test_a_survey_that_may_be_a_rise_along_a_wall_has_no_known_errors_unless_gps_shows_that_it_is_level() -> None:
    placed = place(survey(), marker=None, camera_height=2.5)
    assert (placed.up_error_deg, placed.scale_error) == (None, None)
    assert "steeply down, as is assumed, or ahead as it rose" in str(placed.doubt)
    told = torch.tensor([46.0, 7.0]).double() + survey().camera_to_world[:, [1, 0], 3] / torch.tensor(
        [111_195.0, 111_195.0 * math.cos(math.radians(46.0))]
    )
    by_gps = place(replace(survey(), gps=told), marker=None)
    assert by_gps.scale_from == "gps" and by_gps.doubt is None and by_gps.up_error_deg == 1.5
    round_ = place(survey(6.0 * T), marker=None, camera_height=2.5)
    assert round_.doubt is None and (round_.up_error_deg, round_.scale_error) == (1.5, SCALE_ERROR["camera_height"])


def test_a_camera_that_rises_turning_round_is_not_placed_with_a_stated_error() -> None:
    placed = place(filmed(0.1 * np.sin(9 * T), -1.0, 0.5 + 2.5 * T, 6.0 * T, -10.0), marker=None)
    assert placed.up_error_deg is None and "Up may be wrong by a quarter turn" in str(placed.doubt)


@pytest.mark.parametrize("pitch_deg", [-5.0, -15.0])
@pytest.mark.parametrize(
    "found",
    [(2.4 * T - 1.2, 1.2 + 0.3 * np.sin(12 * T)), (1.2 * np.sin(9 * math.pi * T), 1.0 + 0.8 * T), (0.0, 0.5 + 2.5 * T)],
    ids=["raised and lowered along a shelf", "rows along a wall", "rise along a wall"],
)
def test_a_level_camera_that_moves_up_and_down_before_a_wall_is_upright(
    found: tuple[ArrayLike, ArrayLike], pitch_deg: float
) -> None:
    along, height = found
    film = filmed(along, -1.5, height, 0.5 * math.pi, pitch_deg)
    assert refused(film) is None and off_deg(place(film, marker=None)) < 1.5


def test_a_walk_ahead_with_a_camera_swept_up_and_down_is_not_refused_but_its_error_is_unknown() -> None:
    assert refused(sweeping()) is None and "lie on their side" in str(refused(rolled(walk(), 90.0)))
    placed = place(sweeping(), marker=None, camera_height=ABOVE)
    assert off_deg(placed) < 1.5 and (placed.up_error_deg, placed.scale_error) == (None, None)
    assert "the camera swept up and down, or the film lies on its side" in str(placed.doubt)
    swung = rolled(filmed(3.0 * T - 1.5, 0.02 * T, ABOVE, 0.7 * np.sin(25.0 * T), -10.0), 90.0)
    assert place(swung, marker=None).up_error_deg is None, "it has the same axes, and lies on its side"


@pytest.mark.parametrize("pitch_deg", [-8.0, -20.0])
def test_a_film_that_seems_upside_down_but_shows_too_little_floor_to_be_refused_has_unknown_errors(
    pitch_deg: float,
) -> None:
    around = filmed(1.6 * np.cos(6.0 * T), 1.6 * np.sin(6.0 * T), ABOVE, 6.0 * T + math.pi, pitch_deg)
    lawn = around.points[:, 2] < 0.1
    bare = without_points(around, ~lawn | (torch.arange(len(lawn)) % 10 == 0))
    over = rolled(bare, 180.0)
    assert refused(over) is None
    placed = place(over, marker=None, camera_height=ABOVE)
    assert off_deg(placed) > 170.0 and (placed.up_error_deg, placed.scale_error) == (None, None)
    assert "wrong by half a turn" in str(placed.doubt) and "-display_rotation 180" in str(placed.doubt)
    listed = problems(placed, NOTHING, Quality(30.0, 0.9, 30.0, 0.9, 15, 1.0, 1000, 0, 0.05))
    assert placed.doubt in listed and not any("hardly seen" in text for text in listed)
    assert place(bare, marker=None, camera_height=ABOVE).doubt is None
    recorded = place(over, up=torch.tensor([0.0, 0.0, 1.0]), marker=None, camera_height=ABOVE)
    assert recorded.doubt is None and recorded.up_error_deg == 1.0
