"""Pose noise: offsets of the camera from its nominal pose on the robot."""

import math

import pytest
import torch
from hydra.utils import instantiate
from torch import Tensor
from torchrl.envs import TransformedEnv

from splatrl.configuration import load_config
from splatrl.envs.transforms import PoseNoise
from splatrl.geometry import invert_rigid
from tests.envs.contract import base_env, seeded_rollout
from tests.envs.transforms.views import renderer, seeing_env


def noisy(count: int = 3, **settings: object) -> TransformedEnv:
    return TransformedEnv(seeing_env((count,)), PoseNoise(**settings))


def offsets(steps: int, **settings: object) -> Tensor:
    """Draw the offsets of many robots over many steps, without rendering: [steps, 2000, 6]."""
    noise = noisy(1, **settings).transform
    series = [noise._draw(torch.Size([2000]))]
    for _ in range(steps - 1):
        series.append(noise._drift(series[-1]) if noise.memory else noise._draw(torch.Size([2000])))
    return torch.stack(series)


def test_metres_and_degrees_are_converted_and_ordered_correctly() -> None:
    sizes = PoseNoise(height=0.03, roll_deg=1.0, pitch_deg=2.0, x=0.01, y=0.02, yaw_deg=3.0).sizes
    expected = torch.tensor([0.01, 0.02, 0.03, math.radians(2), math.radians(1), math.radians(3)])
    torch.testing.assert_close(sizes, expected)
    torch.testing.assert_close(PoseNoise().sizes, torch.tensor([0, 0, 0.02, math.radians(5), math.radians(5), 0]))


@pytest.mark.parametrize("smooth", [0.0, 4.0])
def test_uniform_noise_is_uniform_at_every_step(smooth: float) -> None:
    series = offsets(30, x=0.1, smooth=smooth)
    for values, size in ((series[[0, 15, 29], :, 0], 0.1), (series[[0, 15, 29], :, 3], math.radians(5))):
        assert values.abs().max() <= size
        for step in values:
            ranked = (step / size).sort().values
            assert (ranked - torch.linspace(-1, 1, len(ranked))).abs().max() < 0.1  # Kolmogorov–Smirnov, p < 1e-4
    assert not series[..., 1].any() and not series[..., 5].any()  # of size 0


@pytest.mark.parametrize("smooth", [0.0, 4.0])
def test_normal_noise_has_its_standard_deviation_at_every_step(smooth: float) -> None:
    series = offsets(30, height=0.05, distribution="normal", smooth=smooth)[[0, 15, 29], :, 2]
    torch.testing.assert_close(series.std(1), torch.full((3,), 0.05), rtol=0.08, atol=0)
    assert (series.mean(1).abs() < 0.005).all()
    assert (series.abs() > 0.1).float().mean().item() == pytest.approx(0.0455, abs=0.012)


def test_smooth_noise_is_correlated_over_time_and_other_noise_is_not() -> None:
    def correlation(series: Tensor, lag: int) -> float:
        return torch.corrcoef(torch.stack([series[:-lag].flatten(), series[lag:].flatten()]))[0, 1].item()

    unsteady = offsets(40, distribution="normal", smooth=5.0)[..., 3]
    for lag in (1, 5, 10):
        assert correlation(unsteady, lag) == pytest.approx(math.exp(-lag / 5), abs=0.03)
    assert abs(correlation(offsets(40)[..., 3], 1)) < 0.02
    assert correlation(offsets(40, smooth=5.0)[..., 3], 1) > 0.75


def test_the_camera_moves_by_the_reported_offset_and_the_robot_does_not() -> None:
    env = noisy(x=0.05, yaw_deg=4.0)
    batch = seeded_rollout(env, 6, 0)
    robot, motion = base_env(env).robot, base_env(env).task.motion
    for data in (batch, batch["next"]):
        for step in range(6):
            td = data[:, step]
            assert td["camera_offset"][:, [0, 2, 3, 4, 5]].all()
            poses = motion.body_to_world(td["state"])
            clean = robot.cameras(poses).camera_to_world
            cameras = robot.cameras(poses, td["camera_offset"])
            moved = cameras.camera_to_world
            torch.testing.assert_close(moved[:, :3, 3] - clean[:, :3, 3], td["camera_offset"][:, :3], atol=1e-6, rtol=0)
            turn = (invert_rigid(clean) @ moved)[:, :3, :3]
            angles = torch.stack([turn[:, 2, 1], turn[:, 1, 0], turn[:, 0, 2]], 1)  # right, forward, down: x, z, y
            torch.testing.assert_close(angles, td["camera_offset"][:, 3:], atol=0.01, rtol=0)
            assert torch.equal(renderer().pixels(cameras), td["pixels"])


def test_noise_of_size_zero_changes_no_byte() -> None:
    none = {"height": 0.0, "roll_deg": 0.0, "pitch_deg": 0.0}
    batch = seeded_rollout(noisy(**none, smooth=3.0), 5, 0)
    clean = seeing_env((3,)).reset(batch[:, 4].select("state"), set_state=True)
    assert torch.equal(batch["pixels"][:, 4], clean["pixels"])
    assert not batch["next", "camera_offset"].any()


def test_every_step_and_every_reset_row_draws_a_new_offset() -> None:
    batch = seeded_rollout(noisy(6), 12, 0)
    before, after = batch["camera_offset"], batch["next", "camera_offset"]
    assert (before[..., 2] != after[..., 2]).all()
    ended = batch["next", "done"][:, :-1, 0]
    assert ended.any()
    begins, ends = before[:, 1:][ended], after[:, :-1][ended]
    assert (begins[:, 2] != ends[:, 2]).all()


def test_smooth_noise_continues_from_the_offset_in_the_tensordict() -> None:
    env = noisy(smooth=4.0)
    td = env.rand_action(env.reset())
    td["camera_offset"] = torch.tensor([0.0, 0.0, 0.015, 0.08, -0.08, 0.0]).expand(3, 6).clone()
    after = env.step(td)["next", "camera_offset"]
    expected = 0.7788 * torch.tensor([0.6745, 1.3, -1.3])  # exp(−1/4) times the normal quantiles of 3/4, 0.96, 0.04
    share = after[:, 2:5] / torch.tensor([0.02, math.radians(5), math.radians(5)])
    normal = math.sqrt(2) * share.erfinv()
    assert ((normal - expected).abs() < 4 * math.sqrt(1 - 0.7788**2)).all()
    again = noisy(smooth=4.0)
    again.transform.memory = 1.0  # no forgetting: what comes out is what went in
    kept = again.step(again.rand_action(again.reset()).set("camera_offset", td["camera_offset"]))["next"]
    torch.testing.assert_close(kept["camera_offset"], td["camera_offset"], atol=1e-6, rtol=1e-4)


def test_smooth_noise_stays_finite_from_an_offset_at_its_limit() -> None:
    noise = noisy(smooth=2.0).transform
    for share in (1.0, -1.0, 1.5):
        assert noise._drift((share * noise.sizes).expand(4, 6)).isfinite().all()


def test_a_given_offset_does_not_change_the_start_that_a_reset_draws() -> None:
    free, given = noisy(), noisy()
    state = free.reset()["state"]
    td = free.reset().select("camera_offset")
    assert torch.equal(given.reset(td, set_state=False)["state"], state)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"height": -0.1}, "pose_noise.height"),
        ({"roll_deg": math.inf}, "pose_noise.roll_deg"),
        ({"smooth": math.nan}, "pose_noise.smooth"),
        ({"distribution": "gauss"}, "uniform or normal, got 'gauss'"),
    ],
)
def test_invalid_settings_are_refused_by_name(settings: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PoseNoise(**settings)


def test_the_configs_build_the_transform() -> None:
    assert load_config(["transforms/pose_noise=none"]).transforms.pose_noise == {}
    uniform = instantiate(load_config(["transforms/pose_noise=uniform"]).transforms.pose_noise)
    assert torch.equal(uniform.sizes, PoseNoise().sizes) and uniform.memory == 0
    unsteady = instantiate(load_config(["transforms/pose_noise=unsteady"]).transforms.pose_noise)
    assert torch.equal(unsteady.sizes, PoseNoise().sizes) and unsteady.memory > 0
