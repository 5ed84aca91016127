"""The apple task."""

import math
from typing import Any

import pytest
import torch
from hydra.utils import instantiate
from torch import Tensor

from splatrl.configuration import load_config
from splatrl.envs.drawing import SceneDrawing, Sprite, SpriteDrawing, View
from splatrl.envs.tasks import Apple, Outcome, Step
from splatrl.motions import Move
from tests.envs.rooms import PLACE, coarse_apple
from tests.tiny import tiny_renderer, tiny_robot

X, Y, _ = PLACE
NEAR = (X - 0.25, Y, 0.0)
RED, GREY, BLACK = (200, 0, 0), (230, 230, 230), (0, 0, 0)


def image(*colors: tuple[int, int, int]) -> Tensor:
    """Make an image of two rows of five pixels, first the given colours and then black: [1, 2, 5, 3] uint8."""
    rows = [*colors, *[BLACK] * (10 - len(colors))]
    return torch.tensor(rows, dtype=torch.uint8).reshape(1, 2, 5, 3)


def sees(task: Apple, pixels: Tensor, state: tuple[float, float, float] = NEAR) -> bool:
    return bool(task.seen(torch.tensor([state]), torch.tensor([PLACE]), pixels))


@pytest.mark.parametrize(("away", "near"), [(0.0, True), (0.25, True), (0.275, True), (0.2752, False), (0.5, False)])
def test_an_apple_is_found_within_the_reach_and_no_farther(away: float, near: bool) -> None:
    for angle in (0.0, 1.0, 4.0):
        state = (X + away * math.cos(angle), Y + away * math.sin(angle), 2.0)
        assert sees(coarse_apple(reach=1.1), image(*[RED] * 10), state) is near


def test_the_distance_to_the_target_is_measured_along_the_ground() -> None:
    task, states = coarse_apple(), torch.tensor([NEAR, NEAR, NEAR])
    targets = torch.tensor([[X, Y, 9.0], [-X, Y, 0.5], [X - 0.25, Y - 0.25, 0.5]])
    assert task.seen(states, targets, image(*[RED] * 10).expand(3, 2, 5, 3)).tolist() == [True, False, True]


def test_an_apple_is_found_only_if_it_is_both_near_and_red() -> None:
    task = coarse_apple()
    assert not sees(task, image(*[GREY] * 10)) and not sees(task, image(*[RED] * 10), (0.0, 0.0, 0.0))
    assert sees(task, image(*[RED] * 10))


@pytest.mark.parametrize(
    ("color", "red"),
    [
        ((102, 0, 0), True),
        ((101, 0, 0), False),
        ((160, 100, 100), True),  # exactly 1.6 times
        ((160, 101, 0), False),
        ((160, 0, 101), False),
        ((159, 100, 0), False),
        ((255, 159, 159), True),
        ((255, 160, 0), False),
        ((0, 200, 0), False),
        (GREY, False),
    ],
)
def test_a_pixel_is_clearly_red_by_its_brightness_and_its_purity(color: tuple[int, int, int], red: bool) -> None:
    assert sees(coarse_apple(red_share=1.0), image(*[color] * 10)) is red


def test_red_of_exactly_1_6_times_green_and_blue_is_enough_at_every_brightness() -> None:
    colors = [(8 * k, 5 * k, 5 * k) for k in range(13, 32)]
    for color in colors:
        assert sees(coarse_apple(red_share=1.0), image(*[color] * 10)), color


@pytest.mark.parametrize(("count", "enough"), [(0, False), (2, False), (3, True), (10, True)])
def test_a_minimum_share_of_red_pixels_is_enough(count: int, enough: bool) -> None:
    assert sees(coarse_apple(red_share=0.3), image(*[RED] * count)) is enough


def test_each_image_is_judged_by_itself() -> None:
    pixels = torch.cat([image(*[RED] * 10), image(*[GREY] * 10), image(*[RED] * 3)])
    task = coarse_apple()
    assert task.seen(torch.tensor([NEAR] * 3), torch.tensor([PLACE] * 3), pixels).tolist() == [True, False, True]


def test_a_bright_grey_image_is_not_an_apple_though_the_published_criterion_accepts_it() -> None:
    bright = image(*[GREY] * 10)
    assert not sees(coarse_apple(), bright) and sees(coarse_apple(mean_red=0.55), bright)


def test_mean_red_replaces_the_share_of_red_pixels() -> None:
    task = coarse_apple(mean_red=0.55)  # 140.25 of 255
    assert sees(task, image(*[(141, 0, 0)] * 10)) and not sees(task, image(*[(140, 0, 0)] * 10))
    assert sees(coarse_apple(), image(*[RED] * 5)) and not sees(task, image(*[RED] * 5))


def test_sprite_share_replaces_the_share_of_red_pixels() -> None:
    task, shares = coarse_apple(sprite_share=0.3), torch.tensor([[0.29], [0.3], [1.0]])
    states, targets = torch.tensor([NEAR, NEAR, (0.0, 0.0, 0.0)]), torch.tensor([PLACE] * 3)
    for color in (RED, GREY):
        pixels = image(*[color] * 10).expand(3, 2, 5, 3)
        assert task.seen(states, targets, pixels, {"sprite_share": shares}).tolist() == [False, True, False]


def blue(size: float = 1.0, alpha: int = 255) -> SpriteDrawing:
    picture = torch.tensor([0, 0, 200, alpha], dtype=torch.uint8).expand(8, 8, 4)
    return SpriteDrawing(tiny_renderer(), Sprite.of(picture), size, PLACE)


def half_red(size: float) -> SpriteDrawing:
    picture = torch.tensor([[0, 0, 200, 255], [200, 0, 0, 255]], dtype=torch.uint8).repeat(8, 4, 1)
    return SpriteDrawing(tiny_renderer(), Sprite.of(picture), size, PLACE)


def test_a_picture_without_red_is_refused_unless_the_sprite_counts_whatever_its_colour() -> None:
    message = r"drawing\.sprite: expected a picture with red in it, got one without; task\.sprite_share=0\.3 finds"
    with pytest.raises(ValueError, match=message):
        coarse_apple().check_picture(blue(), tiny_robot())
    coarse_apple(sprite_share=0.3).check_picture(blue(), tiny_robot())
    coarse_apple(mean_red=0.3).check_picture(blue(), tiny_robot())
    with pytest.raises(ValueError, match=r"drawing\.sprite: .* something opaque in it, got one without$"):
        coarse_apple(sprite_share=0.3).check_picture(blue(alpha=0), tiny_robot())
    with pytest.raises(ValueError, match=r"task\.sprite_share: expected a sprite, .* got none"):
        coarse_apple(sprite_share=0.3).check_picture(SceneDrawing(tiny_renderer()), tiny_robot())


def test_a_picture_that_is_nowhere_opaque_enough_is_refused_however_large_it_is() -> None:
    for size in (1.0, 100.0):
        coarse_apple(sprite_share=0.3).check_picture(blue(size, alpha=77), tiny_robot())
        with pytest.raises(ValueError, match=r"drawing\.sprite: .* at least 30% opaque .* one of at most 29%$"):
            coarse_apple(sprite_share=0.3).check_picture(blue(size, alpha=75), tiny_robot())


def test_a_sprite_must_be_so_large_that_what_counts_of_it_can_fill_the_required_fraction() -> None:
    robot = tiny_robot()
    across = 0.25 * math.tan(math.radians(robot.fov_deg) / 2)  # seen from half a step away, metres
    whole = math.sqrt(0.3 * across * across * robot.image_height / robot.image_width)
    for task, drawing, needed in (
        (coarse_apple(sprite_share=0.3), blue, whole),
        (coarse_apple(), half_red, whole * math.sqrt(2)),
    ):
        task.check_picture(drawing(1.01 * needed), robot)
        with pytest.raises(ValueError, match=r"drawing\.size: expected at least"):
            task.check_picture(drawing(0.99 * needed), robot)


@pytest.mark.parametrize(
    ("state", "there"),
    [
        ((X - 0.25, Y, 0.0), True),
        ((X, Y - 0.25, 90.0), True),
        ((X + 0.25, Y, 180.0), True),
        ((X - 0.25, Y, 20.0), True),
        ((X - 0.25, Y, 340.0), True),
        ((X - 0.25, Y, 21.0), False),
        ((X - 0.25, Y, 339.0), False),
        ((X - 0.25, Y, 180.0), False),
        ((X - 0.5, Y, 0.0), False),
    ],
)
def test_for_planning_an_apple_is_reached_where_it_is_near_and_faced(
    state: tuple[float, float, float], there: bool
) -> None:
    x, y, yaw_deg = state
    assert coarse_apple().reached(torch.tensor([[x, y, math.radians(yaw_deg)]])).tolist() == [there]


def nowhere() -> Tensor:
    raise AssertionError("an apple that does not move draws no place")


def test_a_step_to_the_apple_without_red_in_view_is_not_a_goal() -> None:
    task = coarse_apple()
    state = torch.tensor([NEAR] * 4)
    free, inside = torch.tensor([1.0, 0.5, 1.0, 0.5]), torch.tensor([True, True, False, False])
    move = Move(state, task.motion.body_to_world(state), free, inside)
    views = View(image().expand(4, -1, -1, -1), {})
    step = Step(state, torch.zeros(4, dtype=torch.int64), move, task.begin(state, nowhere), lambda: views)
    verdict = task.judge(step, nowhere)
    expected = [Outcome.RUNNING, Outcome.COLLISION, Outcome.OUT_OF_BOUNDS, Outcome.COLLISION]
    assert task.reached(state).all() and verdict.outcome.flatten().tolist() == expected
    assert verdict.reward.flatten().tolist() == pytest.approx([-0.2, -10.0, -10.0, -10.0])
    assert verdict.terminated.flatten().tolist() == [False, True, True, True]


def test_the_apple_has_one_place_and_the_goal_no_heading() -> None:
    task = coarse_apple()
    assert torch.equal(task.begin(torch.zeros(3, 3), nowhere)["target"], torch.tensor([PLACE] * 3))
    for memory in (None, {"target": torch.tensor(PLACE)}):
        (mark,) = task.marks(memory)
        assert mark.name == "object" and mark.planar[:2].tolist() == [X, Y] and mark.planar[2].isnan()


def test_the_config_is_the_published_one_with_collision_switched_off() -> None:
    cfg = load_config(["task=apple"])
    task = instantiate(cfg.task)
    assert task.reach == pytest.approx(0.11) and task.mean_red is None and task.max_steps == 200
    assert task.place.tolist() == pytest.approx(list(cfg.landmarks.object))
    assert cfg.collision.cpu._target_.endswith("NoChecker") and cfg.robot.body.size == [0.01] * 3
    assert cfg.drawing._target_.endswith("SpriteDrawing") and not cfg.transforms.pose_noise
    solid = load_config(["task=apple", "collision=auto"])
    assert solid.collision.cpu._target_.endswith("NativeChecker")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"place": None}, r"task\.place: expected x, y and z in metres, got None"),
        ({"place": (0.0, 1.0)}, r"task\.place: expected x, y and z in metres, got \(0\.0, 1\.0\)"),
        ({"place": "abc"}, r"task\.place: expected x, y and z in metres, got abc"),
        ({"place": (0.0, 1.0, math.nan)}, r"task\.place"),
        ({"red_share": 0.0}, r"task\.red_share: expected a fraction in \(0, 1\], got 0\.0"),
        ({"red_share": 1.5}, r"task\.red_share"),
        ({"sprite_share": 0.0}, r"task\.sprite_share: expected a fraction in \(0, 1\], got 0\.0"),
        (
            {"sprite_share": 0.3, "mean_red": 0.5},
            r"task\.sprite_share: expected null beside task\.mean_red=0\.5, got 0\.3",
        ),
        ({"mean_red": 55.0}, r"task\.mean_red: expected a fraction in \(0, 1\], got 55\.0"),
        ({"max_steps": 0}, r"task\.max_steps"),
    ],
)
def test_invalid_settings_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Apple(**{"motion": coarse_apple().motion, "place": PLACE, **change})
