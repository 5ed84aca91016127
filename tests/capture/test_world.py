"""A walk in an arbitrary frame is placed upright, to scale and with its floor at z = 0."""

import math
import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from splatrl.capture import world
from splatrl.capture.base import CaptureError, Photos
from splatrl.capture.check import Quality
from splatrl.capture.folder import problems
from splatrl.capture.ground import MIN_INLIERS, SURE, Ground, find_ground, leaning, upside_down
from splatrl.capture.held import cameras_up, on_its_side
from splatrl.capture.marker import MarkerScale
from splatrl.capture.scale import Click, Distance, clicked_point
from splatrl.capture.suggestions import NOTHING
from splatrl.capture.upright_check import why_not_upright
from splatrl.capture.world import SCALE_ERROR, Placed, mean_height, place
from splatrl.evaluation.phone_walk import camera_poses
from tests.capture.walks import ABOVE, CAMERAS, K, strewn, walk, without_points


@pytest.fixture(scope="module", autouse=True)
def ground_once() -> Iterator[None]:
    """Cache the ground, so that it is found only once for the same poses and points."""
    known: dict[tuple[object, ...], Ground] = {}

    def remembered(*arrays: Any) -> Ground:
        key = tuple(None if array is None else (array.shape, array.tobytes()) for array in arrays)
        if key not in known:
            known[key] = find_ground(*arrays)
        return known[key]

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(world, "find_ground", remembered)
        yield


def up_error_deg(placed: Placed, transform: np.ndarray) -> float:
    """Return the angle between the world's z axis and the true one, degrees."""
    whole = placed.world_from_capture.numpy() @ transform
    return math.degrees(math.acos(min(1.0, whole[2, 2] / float(np.linalg.norm(whole[2, :3])))))


def scale_error(placed: Placed, transform: np.ndarray) -> float:
    whole = placed.world_from_capture.numpy() @ transform
    return float(abs(np.cbrt(np.linalg.det(whole[:3, :3])) - 1.0))


def pixels(image: int, points: torch.Tensor) -> torch.Tensor:
    """Return where a camera of the walk sees points [P, 3] of the true world: [P, 2] pixels."""
    pose = walk().camera_to_world[image]
    local = (points - pose[:3, 3]) @ pose[:3, :3] @ K.T
    return local[:, :2] / local[:, 2:]


def two_points(image: int) -> torch.Tensor:
    """Return two points of the lawn, far apart, that an image shows: [2, 3]."""
    seen = walk().points[walk().seen_point[walk().seen_by == image]]
    seen = seen[(seen[:, :2].abs().amax(1) < 2.0) & (seen[:, 2].abs() < 0.05)]
    far = (seen - seen[0]).norm(dim=1).argmax()
    return torch.stack([seen[0], seen[far]])


@pytest.mark.parametrize("seed", range(5))
def test_up_floor_and_scale_are_found_whatever_the_frame_of_the_walk(seed: int) -> None:
    lying, transform = strewn(seed)
    placed = place(lying, marker=None, camera_height=ABOVE)
    assert (placed.scale_from, placed.up_from, placed.metric) == ("camera_height", "floor", True)
    assert up_error_deg(placed, transform) < 0.5
    assert scale_error(placed, transform) < 0.02
    whole = placed.world_from_capture.numpy() @ transform
    assert abs(whole[2, 3]) < 0.03 and placed.camera_height == pytest.approx(ABOVE)
    cameras = placed.reconstruction.camera_to_world
    axes = cameras[:, :3, :3]
    torch.testing.assert_close(axes @ axes.mT, torch.eye(3).double().expand_as(axes), atol=1e-6, rtol=0)
    middle = 0.5 * (cameras[:, :2, 3].amin(0) + cameras[:, :2, 3].amax(0))
    torch.testing.assert_close(middle, torch.zeros(2).double(), atol=1e-9, rtol=0)
    yaw = math.degrees(math.atan2(whole[1, 0], whole[0, 0])) % 90.0
    assert min(yaw, 90.0 - yaw) < 2.0, "x runs along a fence of the yard"


def told_by_gps(noise: float, latitude: float = 46.8, longitude: float = 180.0) -> torch.Tensor:
    """Return latitudes and longitudes of the walk's cameras, x to the north, with ``noise`` metres of noise: [N, 2]."""
    places = walk().camera_to_world[:, :2, 3] + noise * torch.randn(CAMERAS, 2, generator=torch.manual_seed(0)).double()
    north, east = places[:, 0] / 111_195, -places[:, 1] / 111_195 / math.cos(math.radians(latitude))
    return torch.stack([latitude + north, (longitude + east + 180.0) % 360.0 - 180.0], 1)


@pytest.mark.parametrize("seed", range(3))
def test_gps_gives_the_scale_where_nothing_else_does(seed: int) -> None:
    lying, transform = strewn(seed)
    gps = told_by_gps(0.1)
    gps[3:9] = torch.nan
    placed = place(replace(lying, gps=gps), marker=None)
    assert placed.scale_from == "gps" and scale_error(placed, transform) < 0.03
    assert placed.scale_error is not None and 0.03 < placed.scale_error < 0.1
    assert place(replace(lying, gps=gps), marker=None, camera_height=ABOVE).scale_from == "camera_height"


@pytest.mark.parametrize("case", ["noise", "few", "one place", "mirrored"])
def test_gps_that_does_not_fit_the_cameras_gives_no_scale(case: str) -> None:
    gps = told_by_gps(1.0 if case == "noise" else 0.0)
    if case == "few":
        gps[4:] = torch.nan
    if case == "one place":
        gps[:] = gps[0].clone()
    if case == "mirrored":
        gps[:, 0] = 93.6 - gps[:, 0]
    assert place(replace(strewn(0)[0], gps=gps), marker=None).scale_from == "unknown"


@pytest.mark.parametrize(("blades", "off"), [(0.0, 0.003), (0.055, 0.012)])
def test_camera_height_is_measured_from_the_ground_below_the_blades_of_grass(blades: float, off: float) -> None:
    rng, poses = np.random.default_rng(0), walk().camera_to_world.numpy().copy()
    poses[:, 2, 3] = 0.6
    lawn = np.concatenate([rng.uniform(-3, 3, (2000, 2)), blades * rng.random((2000, 1))], 1)
    ground = find_ground(poses, lawn + rng.normal(0, 0.001, lawn.shape))
    assert abs(ground.height - ground.below) < off


@pytest.mark.parametrize("first", [8, 14, 20, 26])
def test_the_height_of_a_camera_that_moves_up_and_down_gives_the_scale_despite_missing_poses(first: int) -> None:
    seconds, poses = torch.arange(CAMERAS).double() / 4, walk().camera_to_world.clone()
    poses[:, 2, 3] += 0.5 * torch.sin(2 * seconds)
    poses[5, 2, 3] = 80.0  # an outlier
    kept = torch.ones(CAMERAS, dtype=torch.bool)
    kept[first : first + 5] = False
    partly = replace(walk(), camera_to_world=poses[kept], seconds=seconds[kept], missing=5 / CAMERAS)
    true = float((walk().camera_to_world[:, 2, 3] + 0.5 * torch.sin(2 * seconds)).mean())
    placed = place(partly, marker=None, camera_height=true)
    assert scale_error(placed, np.eye(4)) < 0.04  # the median over the posed images alone is off by up to 0.06
    assert placed.camera_height == pytest.approx(true)


@pytest.mark.parametrize("lost", [0, 9])
def test_a_pause_of_the_recorder_hardly_counts_for_the_mean_height(lost: int) -> None:
    take = torch.arange(0, 10, 0.125).double()
    heights = 1.5 + 0.15 * np.sin(2 * take.numpy())
    heights[-1] = 1.36  # lowered, to stop the recorder
    seconds, both = torch.cat([take, 600 + take]), np.concatenate([heights, heights[::-1]])
    kept = (torch.arange(len(both)) < 20) | (torch.arange(len(both)) >= 20 + lost)
    assert mean_height(both[kept], seconds[kept], lost) == pytest.approx(both.mean(), rel=0.01)


def test_placing_the_same_reconstruction_twice_gives_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(world, "find_ground", find_ground)
    first, again = (place(strewn(1)[0], marker=None) for _ in range(2))
    assert torch.equal(first.world_from_capture, again.world_from_capture)
    assert torch.equal(first.reconstruction.points, again.reconstruction.points)


def test_walls_determine_up_where_the_floor_is_a_narrow_strip() -> None:
    points = walk().points
    thinned = torch.arange(len(points)) % 4 == 0
    strip = (points[:, 2] > 0.4) & thinned | (points[:, 2] < 0.1) & (points[:, 0].abs() < 0.15)
    assert find_ground(walk().camera_to_world.numpy(), points.numpy()).up_from == "floor"
    ground = find_ground(walk().camera_to_world.numpy(), points[strip].numpy())
    assert ground.up_from == "walls" and ground.up[2] > math.cos(math.radians(1.0))
    assert abs(ground.height) < 0.05


def test_reflections_below_the_floor_do_not_lower_the_floor() -> None:
    points = walk().points
    mirrored = points[(points[:, 2] > 0.1) & (points[:, 2] < 0.6)][::12] * torch.tensor([1.0, 1.0, -1.0])
    ground = find_ground(walk().camera_to_world.numpy(), torch.cat([points, mirrored]).numpy())
    assert abs(ground.height) < 0.05 and ground.up[2] > math.cos(math.radians(1.0))


def test_images_that_were_turned_on_their_side_are_placed_like_upright_ones() -> None:
    upright = walk()
    lies = torch.arange(len(upright.paths)) % 5 < 3
    poses = upright.camera_to_world.clone()
    poses[lies, :3, 0], poses[lies, :3, 1] = -upright.camera_to_world[lies, :3, 1], upright.camera_to_world[lies, :3, 0]
    cloud = torch.from_numpy(np.random.default_rng(0).normal(size=(3000, 3)))  # nothing that would determine up
    few = {"points": cloud, "colors": upright.colors[:3000], "seen_point": torch.zeros(0), "seen_by": torch.zeros(0)}
    given = replace(upright, camera_to_world=poses, turned=lies, **few)
    placed, expected = (place(found, marker=None) for found in (given, replace(upright, **few)))
    torch.testing.assert_close(placed.world_from_capture, expected.world_from_capture)
    assert placed.up_from == "cameras" and not torch.allclose(
        place(replace(given, turned=None), marker=None).world_from_capture, expected.world_from_capture, atol=0.1
    )


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_film_on_its_side_is_told_from_an_upright_one(side: float) -> None:
    upright = walk().camera_to_world.numpy()
    lying = upright.copy()
    lying[:, :3, 0], lying[:, :3, 1] = side * upright[:, :3, 1], -side * upright[:, :3, 0]
    assert on_its_side(lying) and not on_its_side(upright)
    assert not on_its_side(lying[:1].repeat(9, 0)), "a camera that never turns leaves it undecided"


@pytest.mark.parametrize(
    ("posed", "files", "side", "over"),
    [
        (False, (), "ffmpeg -display_rotation 90 ", "ffmpeg -display_rotation 180 "),
        (False, ("a.jpg",), "Rotate the photos by a quarter turn", "Rotate the photos by half a turn"),
        (True, ("a.jpg",), "exiftool -n -Orientation=6 ", "exiftool -n -Orientation=3 "),
        (True, (), "a version of the app that records", "a version of the app that records"),
    ],
)
def test_the_advice_on_images_that_are_not_upright_depends_on_their_source(
    posed: bool, files: tuple[str, ...], side: str, over: str
) -> None:
    lying, turned = (walk().camera_to_world.clone() for _ in range(2))
    photos = Photos([], 320, 180, torch.zeros(0), camera_to_world=lying if posed else None, files=files)
    assert why_not_upright(walk(), photos) is None
    lying[:, :3, 0], lying[:, :3, 1] = walk().camera_to_world[:, :3, 1], -walk().camera_to_world[:, :3, 0]
    turned[:, :3, :2] *= -1.0
    for poses, what, advice in ((lying, "lie on their side", side), (turned, "seem to be upside down", over)):
        said = why_not_upright(replace(walk(), camera_to_world=poses), photos)
        assert said is not None and what in said and advice in said


def one_way(pitch_deg: float, seed: int) -> np.ndarray:
    """Return poses [40, 4, 4] of a camera that walks along the yard's far fence and looks at it, pitched up or down."""
    rng, yaw = np.random.default_rng(seed), 0.5 * math.pi
    turned = np.radians(rng.normal(0.0, 1.0, (40, 3))) + np.array([yaw, math.radians(pitch_deg), 0.0])
    eyes = np.stack([np.linspace(-2.0, 2.0, 40), np.full(40, -1.5), np.full(40, ABOVE)], 1)
    return camera_poses(torch.from_numpy(np.concatenate([eyes, turned], 1))).numpy()


@pytest.mark.parametrize("pitch_deg", [-10.0, 0.0, 15.0, 30.0])
def test_the_floor_determines_up_for_a_camera_that_looks_one_way_at_any_pitch(pitch_deg: float) -> None:
    ground = find_ground(one_way(pitch_deg, 0), walk().points.numpy())
    assert ground.up[2] > math.cos(math.radians(0.5)) and abs(ground.height) < 0.05
    assert (ground.up_from, ground.error_deg) == ("floor", 1.5)


def test_a_floor_that_few_points_show_leaves_up_and_the_camera_s_height_less_sure() -> None:
    points, around, ahead = walk().points.numpy(), walk().camera_to_world.numpy(), one_way(15.0, 0)
    lawn = np.flatnonzero((np.abs(points[:, 2]) < 0.06) & (np.abs(points[:, :2]).max(1) < 2.3))
    few = np.concatenate([points[points[:, 2] > 0.3], np.random.default_rng(0).permutation(points[lawn])[:150]])
    for poses in (around, ahead):
        broad, ground = find_ground(poses, points), find_ground(poses, few)
        assert (ground.up_from, broad.error_deg, broad.inliers >= SURE) == ("floor", 1.5, True)
        assert leaning(broad, poses[:, :3, 3], points) == 0.0
        assert 2.0 <= ground.error_deg < 5.0
    share = (SURE - ground.inliers) / (SURE - MIN_INLIERS)  # the surer the closer to 300 points: no error leaps there
    assert ground.error_deg == ground.unsure_deg == pytest.approx(5.0 * share)
    to_the_side = leaning(ground, ahead[:, :3, 3] + [0.0, -1.5, 0.0], few) - leaning(ground, ahead[:, :3, 3], few)
    assert to_the_side == pytest.approx(math.tan(math.radians(5.0 * share)) * 1.5 / ABOVE, rel=0.1)


def test_a_floor_that_many_points_show_tells_the_camera_s_height_also_where_it_slopes() -> None:
    points, poses = walk().points.numpy(), walk().camera_to_world.numpy().copy()
    slope = Rotation.from_euler("x", 6.0, degrees=True).as_matrix()
    poses[:, :3, :3] = slope @ poses[:, :3, :3]
    ground = find_ground(poses, points)
    assert ground.up_from == "floor" and ground.inliers >= SURE and ground.error_deg > 4.0
    assert leaning(ground, poses[:, :3, 3] + [0.0, -1.5, 0.0], points) == 0.0


def test_walls_determine_up_for_a_camera_that_looks_one_way_and_sees_no_floor() -> None:
    points = walk().points.numpy()
    fences = (points[:, 2] > 0.3) & (np.abs(points[:, :2]).max(1) > 2.3)
    ground = find_ground(one_way(20.0, 1), points[fences])
    assert ground.up[2] > math.cos(math.radians(1.0)) and ground.up_from == "walls"


def test_up_that_is_known_only_from_cameras_that_look_one_way_is_reported_as_uncertain() -> None:
    ground = find_ground(one_way(20.0, 2), np.random.default_rng(0).normal(size=(3000, 3)))
    assert ground.up_from == "cameras" and ground.error_deg > 35.0
    around = find_ground(walk().camera_to_world.numpy(), np.random.default_rng(0).normal(size=(3000, 3)))
    np.testing.assert_array_equal(around.up, cameras_up(walk().camera_to_world.numpy()).up)
    assert around.up_from == "cameras" and around.error_deg < 10.0


@pytest.mark.parametrize("seed", [None, 3])
def test_an_upside_down_film_is_told_from_an_upright_one(seed: int | None) -> None:
    upright = walk() if seed is None else strewn(seed)[0]
    poses, points = upright.camera_to_world.numpy(), upright.points.numpy()
    turned = poses.copy()
    turned[:, :3, :2] *= -1.0
    assert upside_down(turned, points) and not upside_down(poses, points)


def test_level_cameras_below_all_points_and_cameras_above_looking_up_are_not_upside_down() -> None:
    level, looking = (walk().camera_to_world.numpy().copy() for _ in range(2))
    level[:, :3, :3] = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]
    overhead = walk().points.numpy() * [1.0, 1.0, -1.0] + [0.0, 0.0, 2.0 * ABOVE]
    assert not upside_down(level, overhead)
    looking[:, :3, :2] *= -1.0
    assert not upside_down(looking, overhead)


def test_a_camera_that_films_trees_and_walls_above_it_is_not_taken_for_upside_down() -> None:
    yaw = np.linspace(0.0, math.tau, 40)
    around = np.stack([np.cos(yaw), np.sin(yaw), np.full(40, ABOVE), yaw, np.full(40, -0.35), np.zeros(40)], 1)
    poses, points = camera_poses(torch.from_numpy(around)).numpy(), walk().points.numpy()
    crowns = np.random.default_rng(0).uniform([-3.0, -3.0, 1.5], [3.0, 3.0, 5.0], (9000, 3))
    assert not upside_down(poses, crowns) and not upside_down(poses, np.concatenate([crowns, points]))


def test_cameras_that_all_look_one_way_have_the_up_direction_of_their_images() -> None:
    poses = walk().camera_to_world.numpy()[:1].repeat(5, 0)
    own = -poses[0, :3, 1]
    assert cameras_up(poses).up @ own > math.cos(math.radians(5.0))


@pytest.mark.parametrize("roll_deg", [-12.0, 6.0])
def test_a_camera_that_is_mounted_askew_and_looks_around_has_the_up_direction_of_its_place(roll_deg: float) -> None:
    yaw, rng = np.linspace(0.0, 5.5, 60), np.random.default_rng(0)
    turned = np.stack([yaw, np.full(60, 0.1), np.full(60, math.radians(roll_deg))], 1)
    turned += np.radians(rng.normal(0.0, 1.5, turned.shape))
    walked = np.concatenate([rng.normal(size=(60, 3)), turned], 1)
    held = cameras_up(camera_poses(torch.from_numpy(walked)).numpy())
    assert held.up[2] > math.cos(math.radians(1.5)) and held.lean < math.radians(7.0)


def test_recorded_gravity_and_metric_scale_take_precedence() -> None:
    lying, transform = strewn(2)
    scale = np.cbrt(np.linalg.det(transform[:3, :3]))
    up = torch.from_numpy(transform[:3, 2] / scale)
    placed = place(lying, up=up, metric=True, marker=None, camera_height=9.0)
    assert (placed.up_from, placed.scale_from) == ("recorded", "recorded")
    assert up_error_deg(placed, transform) < 1e-4
    assert np.cbrt(np.linalg.det(placed.world_from_capture[:3, :3].numpy())) == pytest.approx(1.0)


@pytest.mark.parametrize("image", [3, 17, 30])
def test_two_clicks_in_one_image_give_the_scale(image: int) -> None:
    points = two_points(image)
    (x0, y0), (x1, y1) = pixels(image, points).tolist()
    lying, transform = strewn(image % 5)
    named, metres = f"{image:03}.png", float((points[0] - points[1]).norm())
    distance = Distance.between(Click(image, x0, y0), Click(named, x1, y1), metres)
    placed = place(lying, marker=None, distance=distance, camera_height=9.0)
    assert placed.scale_from == "distance" and scale_error(placed, transform) < 0.05


@pytest.mark.parametrize(("first", "second"), [(3, 21), (30, 11)])
def test_two_points_that_no_image_shows_together_give_the_scale(first: int, second: int) -> None:
    seen = [set(walk().seen_point[walk().seen_by == image].tolist()) for image in (first, second)]
    ends = []
    for image, own, other in ((first, *seen), (second, *seen[::-1])):
        rows = torch.tensor(sorted(own - other))
        at, around = (pixels(image, walk().points[some]) for some in (rows, torch.tensor(sorted(own))))
        nearest = torch.cdist(at, around).topk(12, largest=False).indices
        flat = walk().points[torch.tensor(sorted(own))][nearest][..., 2].abs().amax(1) < 0.06  # only lawn around it
        away = flat * (walk().points[rows] - ends[0][1]).norm(dim=1) if ends else flat
        chosen = int(away.double().argmax())
        ends.append((Click(image, *at[chosen].tolist()), walk().points[rows[chosen]]))
    lying, transform = strewn(first % 5)
    metres = float((ends[0][1] - ends[1][1]).norm())
    placed = place(lying, marker=None, distance=Distance.between(ends[0][0], ends[1][0], metres))
    assert metres > 1.0 and placed.scale_from == "distance" and scale_error(placed, transform) < 0.05


def test_clicks_in_two_images_are_triangulated_where_no_point_is_near() -> None:
    bare = without_points(walk(), (walk().points - torch.tensor([0.0, 0.0, 0.5])).norm(dim=1) > 1.0)
    target = torch.tensor([[0.1, 0.2, 0.5]]).double()
    clicks = [Click(image, *pixels(image, target)[0].tolist()) for image in (2, 12)]
    np.testing.assert_allclose(clicked_point(bare, clicks), target[0], atol=0.1)
    poses = bare.camera_to_world.clone()
    poses[12] = poses[2]
    beside = [clicks[0], replace(clicks[0], image=12)]
    with pytest.raises(CaptureError, match="different directions, got parallel rays; click it in another image"):
        clicked_point(replace(bare, camera_to_world=poses), beside)


def test_without_any_source_of_scale_the_world_is_not_metric() -> None:
    placed = place(strewn(0)[0], marker=None)
    assert (placed.scale_from, placed.scale_error, placed.metric) == ("unknown", None, False)
    assert placed.camera_height == pytest.approx(1.5)


def test_scale_and_up_have_no_known_error_without_a_floor_or_where_the_camera_leaps() -> None:
    assert place(walk(), marker=None, camera_height=ABOVE).scale_error == SCALE_ERROR["camera_height"]
    seconds = torch.arange(CAMERAS).double()
    cloud = np.random.default_rng(0).normal(size=(3000, 3))
    without_floor = replace(walk(), points=torch.from_numpy(cloud))
    placed = place(without_floor, marker=None, camera_height=ABOVE)
    assert (placed.up_from, placed.scale_from, placed.scale_error) == ("cameras", "camera_height", None)
    assert place(without_floor, metric=True, marker=None).scale_error == SCALE_ERROR["recorded"]
    poses = walk().camera_to_world.clone()
    poses[:, 0, 3], poses[:, 1, 3] = 0.1 * seconds, 0.1 * torch.sin(seconds)
    for leap, error in ((0.0, SCALE_ERROR["camera_height"]), (2.0, None)):
        poses[CAMERAS // 2 :, 1, 3] += leap
        film = replace(walk(), camera_to_world=poses.clone(), seconds=seconds)
        assert place(film, marker=None, camera_height=ABOVE).scale_error == error
        held = place(replace(film, points=without_floor.points), marker=None)
        assert held.up_from == "cameras" and (held.up_error_deg is None) == (error is None)


def test_a_stated_height_or_distance_that_contradicts_the_source_of_the_scale_is_a_problem(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    points = two_points(3)
    (x0, y0), (x1, y1) = pixels(3, points).tolist()
    metres = float((points[0] - points[1]).norm())
    distance = Distance.between(Click(3, x0, y0), Click(3, x1, y1), metres)
    half = replace(distance, metres=0.5 * metres)
    cases: list[tuple[float | None, dict[str, Any], str | None]] = [
        (1.0, {"camera_height": 1.15 * ABOVE, "distance": distance}, None),
        (
            2.0,
            {"camera_height": ABOVE},
            r"The scale is from the marker, .* was 2\.8\d m .* --camera-height said 1\.4 m\. ",
        ),
        (
            2.0,
            {"distance": distance},
            r"marker, by which the two clicked points are \d.* m apart; --distance said .* 100 %",
        ),
        (None, {"camera_height": ABOVE, "distance": half}, r"from --distance, .* was 0\.\d+ m above .* said 1\.4 m\."),
    ]
    for size, stated, told in cases:
        measured = None if size is None else MarkerScale(size, 0.01, 1, 9)
        monkeypatch.setattr(world, "scale_by_marker", lambda *_, measured=measured: measured)
        placed = place(walk(), **stated)
        listed = problems(placed, NOTHING, Quality(30.0, 0.9, 30.0, 0.9, 15, 1.0, 1000, 0, 0.05))
        if told is None:
            assert placed.contradicted is None and placed.scale_error == 0.01
        else:
            assert re.search(told, str(placed.contradicted)) and placed.scale_error is None
            assert placed.contradicted in listed and not any("hardly seen" in text for text in listed)
    bare = replace(walk(), points=torch.from_numpy(np.random.default_rng(0).normal(size=(3000, 3))))
    recorded = place(bare, metric=True, camera_height=9.0)
    assert recorded.up_from == "cameras" and recorded.contradicted is None, "the floor was hardly seen"
    known = place(bare, up=torch.tensor([0.0, 0.0, 1.0]), metric=True, camera_height=90.0)
    assert known.floor_points < MIN_INLIERS and known.contradicted is None, "although up is known"
    assert "Check what you stated" in str(place(walk(), metric=True, camera_height=9.0).contradicted)


def test_impossible_heights_distances_and_clicks_are_refused() -> None:
    with pytest.raises(ValueError, match=r"camera_height: expected a number of metres above 0\.0, got -1\.0"):
        place(walk(), marker=None, camera_height=-1.0)
    with pytest.raises(ValueError, match=r"distance: expected a number of metres above 0\.0, got 0\.0"):
        Distance.between(Click(0, 0, 0), Click(0, 1, 1), 0.0)
    with pytest.raises(CaptureError, match="expected an image index from 0 to 39, got 99"):
        place(walk(), marker=None, distance=Distance.between(Click(99, 0, 0), Click(99, 1, 1), 1.0))
    with pytest.raises(CaptureError, match=r"expected an image with a pose in \., such as 000\.png, got 99\.png"):
        place(walk(), marker=None, distance=Distance.between(Click("99.png", 0, 0), Click(99, 1, 1), 1.0))
    with pytest.raises(CaptureError, match=r"at least 3 points .* around \(-900, 0\) in image 3, found \d"):
        place(walk(), marker=None, distance=Distance.between(Click(3, -900, 0), Click(3, 1, 1), 1.0))
    with pytest.raises(CaptureError, match="expected at least 2 cameras and 20 points to find the floor, got 40 and 5"):
        place(without_points(walk(), torch.arange(len(walk().points)) < 5), marker=None)
