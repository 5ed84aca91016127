"""Each transform works everywhere that TorchRL tests its own transforms."""

from collections.abc import Callable
from functools import partial

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import Compose, EnvBase, ParallelEnv, SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs

from tests.envs.contract import assert_same, seeded_rollout
from tests.envs.transforms.views import NAMES, make_transform, seeing_env, transformed

WRITTEN = {"PoseNoise": "camera_offset", "Appearance": "appearance"}
every = pytest.mark.parametrize("name", NAMES)


def images(count: int = 5) -> TensorDictBase:
    """Return input for a transform without an env."""
    return TensorDict(seeing_env((count,)).reset().select("pixels"), [count])


@every
def test_a_transform_works_in_a_single_env(name: str) -> None:
    env = TransformedEnv(seeing_env(), make_transform(name))
    check_env_specs(env, break_when_any_done="both", seed=0)
    batch = env.rollout(5)
    assert {WRITTEN[name], ("next", WRITTEN[name])} <= set(batch.keys(True))


@every
def test_a_transform_works_around_each_env_of_a_serial_env(name: str) -> None:
    env = SerialEnv(2, [partial(transformed, (3,), seed, (name,)) for seed in (0, 1)])
    check_env_specs(env, break_when_any_done="both", seed=0)
    batch = env.rollout(12, break_when_any_done=False)
    assert batch["next", "done"].any() and WRITTEN[name] in set(batch.keys())


@every
@pytest.mark.parametrize("kind", [SerialEnv, partial(ParallelEnv, mp_start_method="fork")])
def test_around_the_envs_of_workers_an_error_says_where_it_belongs(name: str, kind: Callable[..., EnvBase]) -> None:
    workers = kind(2, seeing_env)
    with pytest.raises(ValueError, match=f"put {name} around the env of each worker"):
        TransformedEnv(workers, make_transform(name)).reset()
    workers.close(raise_if_closed=False)


def test_transforms_work_around_each_env_of_a_parallel_env() -> None:
    """All transforms are tested at once, since starting workers is slow."""
    make = [partial(transformed, (3,), seed) for seed in (0, 1)]
    parallel, serial = ParallelEnv(2, make, mp_start_method="fork"), SerialEnv(2, make)
    try:
        assert_same(seeded_rollout(parallel, 12, 0), seeded_rollout(serial, 12, 0))
    finally:
        parallel.close()


@every
def test_a_transform_works_on_data_without_an_env(name: str) -> None:
    data = images()
    before = data.clone()
    after = make_transform(name)(data)
    changed = not torch.equal(after["pixels"], before["pixels"])
    assert changed == (name != "PoseNoise")  # a camera cannot be moved once its image has been rendered


@every
def test_a_transform_works_in_a_compose(name: str) -> None:
    env = TransformedEnv(seeing_env(), Compose(Compose(make_transform(name))))
    check_env_specs(env, break_when_any_done="both", seed=0)
    assert_same(seeded_rollout(env, 5, 0), seeded_rollout(transformed((3,), 0, (name,), sprite=False), 5, 0))


@every
def test_a_transform_works_in_a_model(name: str) -> None:
    data = images()
    mean = TensorDictModule(lambda pixels: pixels.float().mean((1, 2)), ["pixels"], ["color"])
    for model in (nn.Sequential(make_transform(name), mean), TensorDictSequential(make_transform(name), mean)):
        out = model(data.clone())
        assert torch.equal(out["color"], out["pixels"].float().mean((1, 2)))


@every
def test_a_transform_works_in_a_replay_buffer(name: str) -> None:
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(10), transform=make_transform(name), batch_size=4)
    data = images()
    offset = torch.rand(len(data), 6)
    buffer.extend(data.clone().set("camera_offset", offset))
    stored = buffer.storage[:]
    assert torch.equal(stored["pixels"], data["pixels"]) and torch.equal(stored["camera_offset"], offset)
    assert buffer.sample()["pixels"].shape == (4, *data["pixels"].shape[1:])


@every
def test_the_inverse_of_a_transform_leaves_recorded_data_unchanged(name: str) -> None:
    data = images().set("camera_offset", torch.rand(5, 6))
    assert_same(make_transform(name).inv(data.clone()), data)


@every
@pytest.mark.parametrize("seed", range(3))
def test_a_masked_reset_gives_new_values_only_to_the_masked_rows(name: str, seed: int) -> None:
    env = transformed((6,), 0, (name,), sprite=False)
    td = env.rollout(3)[:, -1]["next"].exclude("reward")
    mask = torch.rand(6, 1, generator=torch.Generator().manual_seed(seed)) < 0.5
    mask[0], mask[1] = True, False
    before = td.clone()
    after = env.reset(td.set("_reset", mask), select_reset_only=True)  # as maybe_reset does
    key = WRITTEN[name]
    rows = mask.squeeze(1)
    assert torch.equal(after["pixels"][~rows], before["pixels"][~rows])
    assert (after[key][rows] != before[key][rows]).any(1).all()


@every
def test_the_seed_of_the_env_also_seeds_the_transform(name: str) -> None:
    runs = [seeded_rollout(transformed((3,), seed, (name,), sprite=False), 12, 7) for seed in (0, 1)]
    assert_same(*runs)
    key = WRITTEN[name]
    other = seeded_rollout(transformed((3,), 0, (name,), sprite=False), 12, 8)
    assert not torch.equal(other[key], runs[0][key])
