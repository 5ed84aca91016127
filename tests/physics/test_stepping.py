"""A step is a function of the state and the controls alone."""

import copy
import pickle
from pathlib import Path

import mujoco
import pytest
import torch

from splatrl.physics import Physics, Terrain, Variation, bank, compose, read_mjcf
from splatrl.physics.robots import mjcf_path

BOXES = torch.tensor([[0.6, 0.1, 0.1, 0.1, 0.2, 0.1]], dtype=torch.float64)


def model() -> mujoco.MjModel:
    """Compose the model of a robot on wheels in front of a ball and a box."""
    terrain = Terrain(torch.tensor([0.0, 0.0, 1.0, 0.0], dtype=torch.float64), BOXES)
    return compose(read_mjcf(mjcf_path("wheels")), terrain, {"ball": read_mjcf(mjcf_path("ball"))}).model


def scattered(physics: Physics, count: int) -> torch.Tensor:
    """Return states in which the ball lies at different distances ahead."""
    state = physics.state_of().repeat(count, 1)
    state[:, physics.layout.positions][:, 9] = torch.linspace(0.28, 0.4, count)
    return state


def run(physics: Physics, state: torch.Tensor, steps: int = 8) -> torch.Tensor:
    """Return the states after driving ahead."""
    for _ in range(steps):
        state, _, sound = physics.step(state, torch.tensor([[0.5, 0.3]]).expand(len(state), 2))
        assert sound.all()
    return state


def test_an_empty_batch_steps_to_an_empty_batch() -> None:
    physics = Physics(model(), 3, 1)
    after, sensed, sound = physics.step(physics.state_of().repeat(4, 1)[:0], torch.zeros(0, 2))
    assert after.shape == (0, physics.size) and sound.shape == (0,) and sound.dtype == torch.bool
    assert sensed.shape == (0, 3, physics.model.nsensordata) and sensed.dtype == torch.float64


def test_controls_that_are_not_finite_are_refused() -> None:
    physics = Physics(model(), 3, 1)
    with pytest.raises(ValueError, match=r"ctrl: expected finite numbers, got \[0\.0, nan\] in row 1"):
        physics.step(physics.state_of().repeat(2, 1), torch.tensor([[0.0, 0.0], [0.0, torch.nan]]))


def test_a_row_has_the_same_bytes_alone_in_any_order_with_any_threads_and_in_parts() -> None:
    physics = Physics(model(), 10, 1)
    start = scattered(physics, 7)
    together = run(physics, start)
    assert together.unique(dim=0).shape[0] == 7, "the rows differ"
    order = torch.tensor([3, 0, 6, 1, 5, 2, 4])
    assert torch.equal(run(physics, start[order]), together[order])
    assert torch.equal(torch.cat([run(physics, row[None]) for row in start]), together)
    assert torch.equal(run(Physics(model(), 10, 2), start), together)
    assert torch.equal(run(physics, run(physics, start, 3), 5), together)


def test_twice_as_many_steps_of_half_the_substeps_give_nearly_the_same_states() -> None:
    whole, half = Physics(model(), 10, 1), Physics(model(), 5, 1)
    start = scattered(whole, 3)
    torch.testing.assert_close(run(half, start, 4), run(whole, start, 2), atol=1e-4, rtol=0)


def test_it_can_be_copied_and_pickled() -> None:
    physics = Physics(model(), 10, 1)
    start = scattered(physics, 2)
    for other in (copy.deepcopy(physics), pickle.loads(pickle.dumps(physics))):
        assert torch.equal(run(other, start, 2), run(physics, start, 2))


def test_each_row_is_stepped_by_its_own_model() -> None:
    variation = Variation(3, friction=(0.5, 2.0), mass=(0.5, 2.0), motor=(0.5, 2.0), seed=1)
    physics = Physics(bank(model(), variation), 10, 1)
    start = scattered(physics, 1).repeat(4, 1)
    start[:, 0] = torch.tensor([0.0, 1.0, 2.0, 0.0])
    after = run(physics, start)
    assert torch.equal(after[:, physics.layout.model], start[:, physics.layout.model])
    assert torch.equal(after[0], after[3])
    assert after[:, physics.layout.mujoco].unique(dim=0).shape[0] == 3
    assert torch.equal(after[0], run(Physics(model(), 10, 1), start[:1])[0]), "the first is as the files say"
    again = Physics(bank(model(), variation), 10, 1)
    assert torch.equal(run(again, start), after), "the same seed draws the same models"


@pytest.mark.parametrize("threads", [1, 2])
def test_an_unstable_row_keeps_its_state_and_is_reported(
    threads: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    physics = Physics(model(), 10, threads)
    start = scattered(physics, 3)
    start[1, physics.layout.velocity][0] = 1e12  # metres per second
    after, sensed, sound = physics.step(start, torch.zeros(3, 2))
    assert sound.tolist() == [True, False, True]
    assert torch.equal(after[1], start[1]) and sensed.isfinite().all()
    alone = physics.step(start[:1], torch.zeros(1, 2))
    assert torch.equal(alone.state[0], after[0])
    assert not list(tmp_path.iterdir()), "MuJoCo leaves no log"


def test_models_of_different_sizes_are_refused() -> None:
    other = compose(read_mjcf(mjcf_path("wheels")), Terrain(torch.tensor([0.0, 0, 1, 0]).double(), BOXES)).model
    with pytest.raises(ValueError, match="models: expected the same sizes"):
        Physics([model(), other], 1)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"models": 0}, "models: expected a whole number from 1"),
        ({"friction": (2.0, 1.0)}, "friction: expected two factors"),
        ({"mass": (0.0, 1.0)}, "mass: expected two factors"),
    ],
)
def test_a_variation_out_of_range_is_refused(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Variation(**settings)  # type: ignore[arg-type]
