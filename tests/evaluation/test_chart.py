"""The map in a video shows the robot, its trail and the goal at the right positions."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from splatrl.bodies import Box, Capsule, Sphere
from splatrl.envs.tasks import Mark, Outcome
from splatrl.evaluation.chart import COLORS, Chart
from splatrl.evaluation.figure_style import BLUE, GOAL, MARKS, MISSED
from splatrl.evaluation.recording import Recording
from splatrl.evaluation.topdown import MapView, TopDown

GROUND = TopDown(torch.full((60, 100, 3), 255, dtype=torch.uint8), (-1.0, 4.0, 2.0, 5.0))  # 5 m × 3 m
PLACE = Mark("goal pose", torch.tensor([3.0, 4.0, 1.2], dtype=torch.float64))
BODY = Box((0.3, 0.2, 0.1))
SCALE = 80.0  # pixels per metre in a map 400 pixels wide


def recording(outcome: Outcome = Outcome.COLLISION, marks: Sequence[list[Mark]] = ()) -> Recording:
    planar = torch.tensor([[0.0, 2.5, 0.0], [1.0, 2.5, 0.0], [2.0, 2.5, 0.0], [2.0, 3.5, 1.57]])
    return Recording(
        planar=planar,
        body_to_world=torch.eye(4).repeat(4, 1, 1),
        pixels=torch.zeros(4, 6, 8, 3, dtype=torch.uint8),
        action=torch.tensor([0, 0, 2]),
        episode_return=torch.zeros(4),
        outcome=outcome,
        marks=marks,
    )


def chart(solid: torch.Tensor | None = None, *marks: Mark) -> Chart:
    return Chart(MapView(GROUND, solid, marks or [PLACE]), BODY, (400, 384))


def found(image: Image.Image, color: str) -> np.ndarray:
    """World x and y of the pixels with this colour: [N, 2]."""
    wanted = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)])
    rows, columns = (np.abs(np.asarray(image).astype(int) - wanted).max(-1) < 20).nonzero()
    return np.stack([-1.0 + (columns + 0.5) / SCALE, 5.0 - (rows + 0.5) / SCALE], -1)


def test_a_map_fits_its_box_without_being_stretched() -> None:
    assert chart().size == (400, 240)
    assert Chart(MapView(GROUND), BODY, (1000, 120)).size == (200, 120)


def test_the_robot_is_drawn_at_its_pose() -> None:
    image = chart().draw(recording(), 3)
    assert image.size == (400, 240)
    here = found(image, MISSED)
    assert np.abs(here.min(0) + here.max(0) - (4.0, 7.0)).max() < 0.1
    assert np.ptp(here, 0) == pytest.approx([0.2, 0.3], abs=0.1)  # turned by 90°
    assert (np.abs(here - (2.0, 3.5)).max(1) < 0.3).all()


def test_the_trail_runs_from_the_start_to_the_current_step_and_no_further() -> None:
    for step, farthest in ((1, 1.0), (2, 2.0)):
        trail = found(chart().draw(recording(), step), BLUE)
        assert trail[:, 0].min() < 0.2 and trail[:, 0].max() == pytest.approx(farthest + 0.2, abs=0.15)
        assert np.abs(trail[:, 1] - 2.5).max() < 0.25


@pytest.mark.parametrize("outcome", [Outcome.GOAL, Outcome.COLLISION, Outcome.TIMEOUT])
def test_the_robot_has_the_colour_of_the_outcome_in_the_last_frame_only(outcome: Outcome) -> None:
    assert len(found(chart().draw(recording(outcome), 3), COLORS[outcome])) > 50
    assert len(found(chart().draw(recording(outcome), 2), COLORS[outcome])) == 0


def test_the_goal_is_marked_at_its_position_in_every_frame() -> None:
    for step in (0, 3):
        goal = found(chart().draw(recording(), step), GOAL)
        assert len(goal) > 50 and np.linalg.norm(goal - (3.0, 4.0), axis=1).max() < 0.4
        assert goal[:, 1].mean() > 4.05  # the arrow points up


def test_a_moving_mark_is_drawn_at_its_position_at_each_step() -> None:
    places = [(0.5, 4.5), (0.5, 4.5), (3.5, 2.5), (3.5, 4.5)]
    marks = [[Mark("apple", torch.tensor([*place, math.nan], dtype=torch.float64))] for place in places]
    one = Chart(MapView(GROUND), BODY, (400, 384))
    for step, place in enumerate(places):
        apple = found(one.draw(recording(marks=marks), step), GOAL)
        assert np.abs(apple - place).max() < 0.1  # a dot without an arrow
    assert len(found(one.draw(recording(), 0), GOAL)) == 0


def test_marks_with_different_names_differ_in_colour_and_shape_and_have_a_legend() -> None:
    places = torch.tensor([[0.5, 4.5, math.nan], [1.5, 4.5, math.nan]], dtype=torch.float64)
    marks = [[Mark(name, place) for name, place in zip(("mark", "ball"), places, strict=True)]] * 4
    image = Chart(MapView(GROUND), BODY, (400, 384)).draw(recording(marks=marks), 0)
    sizes = []
    for (color, _), place in zip(MARKS, places[:, :2].numpy(), strict=False):
        shown = found(image, color)
        here = np.abs(shown - place).max(1) < 0.2
        assert here.sum() > 30
        sizes.append(np.ptp(shown[here], 0).mean() ** 2 / here.sum())
        assert (shown[~here].mean(0) > (2.5, 2.0)).all() and shown[~here][:, 1].max() < 2.7  # legend, lower right
    assert sizes[1] > 1.2 * sizes[0]  # a diamond fills less of its square than a disc
    alone = Chart(MapView(GROUND), BODY, (400, 384)).draw(recording(marks=[marks[0][:1]] * 4), 0)
    assert np.abs(found(alone, GOAL) - places[0, :2].numpy()).max() < 0.2  # one name needs no legend


def test_the_dots_of_a_long_trail_do_not_merge() -> None:
    steps = torch.linspace(0.0, 3.0, 301)
    planar = torch.stack([steps, torch.full_like(steps, 2.5), torch.zeros_like(steps)], 1)
    one = replace(recording(), planar=planar, action=torch.zeros(300))
    image = np.asarray(Chart(MapView(GROUND), BODY, (400, 384)).draw(one, 300))
    trail = image[round(2.5 * SCALE), round(1.2 * SCALE) : round(3.7 * SCALE)]  # through the dots, from x = 0.2 to 2.7
    outlines = (trail[:, 0] > 8).nonzero()[0]
    assert 26 <= (np.diff(outlines) > 4).sum() <= 28  # the insides of dots, one every 0.09 m


def test_solid_areas_are_drawn_dark() -> None:
    solid = torch.zeros(60, 100, dtype=torch.bool)
    solid[10:20, 20:40] = True  # x 0 to 1, y 4 to 4.5
    bright = np.asarray(chart(solid).draw(recording(), 0))[..., 0]
    assert bright[44:76, 84:156].max() < 130 and bright[:36].min() > 240


def test_drawing_a_frame_does_not_affect_the_next_one() -> None:
    one = chart()
    before = one.draw(recording(), 1).tobytes()
    one.draw(recording(), 3)
    assert one.draw(recording(), 1).tobytes() == before


@pytest.mark.parametrize(("body", "half"), [(Sphere(0.25), 0.25), (Capsule(0.15, 0.5), 0.15), (BODY, 0.15)])
def test_the_drawn_body_has_the_extent_of_the_body_seen_from_above(body: Box | Sphere | Capsule, half: float) -> None:
    assert Chart(MapView(GROUND), body, (400, 384)).body.max() == pytest.approx(half)
