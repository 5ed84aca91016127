"""Modules of several scenes: what belongs to a scene is selected by row, and everything else must agree."""

import pytest
import torch

from splatrl.envs.tasks import Apple, Grid
from splatrl.motions import ForwardMotion, LatticeMotion
from splatrl.per_scene import rows_of, stacked


def grid(x: float = 0.0, height: float = 0.4, step: float = 0.5, columns: int = 4, max_steps: int = 20) -> Grid:
    motion = LatticeMotion(height, step, 45.0, (x, -1.0), (x + columns * step, 1.0))
    return Grid(motion, (x + 1.0, 0.0, 90.0), max_steps=max_steps)


def test_rows_have_bounds_heights_and_goals_of_their_scenes() -> None:
    tasks = [grid(), grid(5.0, 0.7, columns=6)]
    scene, state = torch.tensor([1, 0, 1, 1]), torch.tensor([[6, 2, 0], [4, 1, 3], [2, 2, 2], [0, 0, 7]])
    rows = rows_of(stacked(tasks), scene)
    for row, number in enumerate(scene.tolist()):
        alone, one = tasks[number], state[row : row + 1]
        assert torch.equal(rows.reached(state)[row], alone.reached(one)[0])
        for method in ("body_to_world", "planar", "inside"):
            assert torch.equal(getattr(rows.motion, method)(state)[row], getattr(alone.motion, method)(one)[0])
    assert rows.reached(state).tolist() == [False, False, True, False]
    outside = torch.tensor([[5, 0, 0]]).expand(4, 3)
    assert rows.motion.inside(outside).tolist() == [True, False, True, True]


def test_the_state_spec_covers_the_states_of_all_scenes() -> None:
    assert stacked([grid(), grid(columns=6)]).motion.state_spec.high.tolist() == [6, 4, 7]
    motions = [ForwardMotion(0.4, lower=(x, 0.0), upper=(x + 1, 2.0)) for x in (0.0, 5.0)]
    spec = stacked(motions).state_spec
    assert spec.low[0] < 0 and spec.high[0] > 6


def test_stacking_leaves_the_given_modules_unchanged() -> None:
    task = grid()
    both = stacked([task, grid(5.0)])
    assert task.goal.shape == (3,) and both.goal.shape == (2, 3)
    assert task.motion.origin.shape == (2,) and both.motion.origin.shape == (2, 2)


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (
            grid(step=0.25),
            "task.motion.step: expected the same in all scenes, got 0.5 and 0.25; type task.motion.step=",
        ),
        (grid(max_steps=30), "task.max_steps: expected the same in all scenes, got 20 and 30"),
        (Apple(ForwardMotion(0.4), (0, 0, 0)), "task: expected the same class in all scenes, got Grid, Apple"),
    ],
)
def test_what_does_not_belong_to_a_scene_must_be_the_same_in_all_scenes(other: Grid, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        stacked([grid(), other])
