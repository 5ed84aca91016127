"""An env under transforms is restored whole, also by TorchRL's own collector, and pickled by its configuration."""

import copy
import pickle
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torchrl.collectors import Collector
from torchrl.envs import (
    ActionDiscretizer,
    Compose,
    EnvBase,
    ExcludeTransform,
    FrameSkipTransform,
    ObservationNorm,
    RenameTransform,
    RewardScaling,
    RewardSum,
    SelectTransform,
    StepCounter,
    Transform,
    TransformedEnv,
)

from splatrl.building import make_env, worlds
from splatrl.envs.gymnasium_vector_env import GymnasiumVectorEnv
from splatrl.envs.nesting import layers
from splatrl.envs.stateful_env import StatefulEnv
from splatrl.envs.transforms import Latency
from splatrl.envs.transforms.frame_stack import FrameStack
from tests.envs.contract import assert_same, seeded_rollout
from tests.envs.transforms.views import make_transform, seeing_env
from tests.tiny import tiny_env, tiny_overrides


class FirstAction(torch.nn.Module):
    """A policy that always takes action 0."""

    def forward(self, step_count: torch.Tensor) -> torch.Tensor:
        return torch.zeros_like(step_count[..., 0])


SHAKES = ["transforms/pose_noise=uniform", "memory=stack"]


def shaky(folder: Path) -> StatefulEnv:
    env = make_env([*tiny_overrides(folder), *SHAKES], batch_size=[3])
    assert isinstance(env, StatefulEnv)
    return env


def test_a_restored_env_continues_like_the_saved_one(tmp_path: Path) -> None:
    env, other = shaky(tmp_path), shaky(tmp_path)
    torch.manual_seed(0)
    env.rollout(7, break_when_any_done=False)
    other.load_state_dict(env.state_dict())
    assert {"base_env.curriculum.progress", "base_env._extra_state"} <= env.state_dict().keys()
    rollouts = []
    for one in (env, other):
        torch.manual_seed(1)
        rollouts.append(one.rollout(9, break_when_any_done=False)["next", "pixels"])
    assert torch.equal(*rollouts)
    assert not torch.equal(rollouts[0], shaky(tmp_path).rollout(9, break_when_any_done=False)["next", "pixels"])


def test_a_state_that_lacks_keys_or_has_others_is_refused_unless_loading_is_not_strict(tmp_path: Path) -> None:
    env = shaky(tmp_path)
    with pytest.raises(RuntimeError, match=r'Missing key.*"base_env\._extra_state"'):
        env.load_state_dict({})
    with pytest.raises(RuntimeError, match=r'Unexpected key.*"base_env\.other"'):
        env.load_state_dict(env.state_dict() | {"base_env.other": torch.zeros(1)})
    before = env.state_dict()["base_env._extra_state"].clone()
    env.load_state_dict({"base_env._extra_state": before, "base_env.other": torch.zeros(1)}, strict=False)
    assert torch.equal(env.state_dict()["base_env._extra_state"], before)


@pytest.mark.parametrize("shakes", [False, True])
def test_a_collector_restores_the_env_and_its_transforms(shakes: bool, tmp_path: Path) -> None:
    overrides = [*tiny_overrides(tmp_path), "curriculum.window=1", "curriculum.threshold=0.001"]
    envs = [make_env([*overrides, *(SHAKES if shakes else [])], [3], seed) for seed in (0, 1)]
    policy = TensorDictModule(FirstAction(), in_keys=["step_count"], out_keys=["action"])
    collectors = [Collector(env, policy, frames_per_batch=60, total_frames=240) for env in envs]
    base = layers(envs[0])[0]
    base.curriculum.progress[0] = 2
    next(iter(collectors[0]))
    collectors[1].load_state_dict(collectors[0].state_dict())
    assert layers(envs[1])[0].curriculum.level >= 2
    starts = [env.reset() for env in envs]
    assert_same(*starts)
    assert not torch.equal(starts[0]["state"], make_env(overrides, [3]).reset()["state"])


@pytest.mark.parametrize("name", ["PoseNoise", "Appearance", "Latency", "FrameStack"])
def test_robots_that_wait_stay_as_they_are(name: str) -> None:
    others = {"Latency": partial(Latency, (1, 2), (1, 2)), "FrameStack": partial(FrameStack, 3)}
    env = StatefulEnv(seeing_env(), others[name]() if name in others else make_transform(name))
    td = env.reset()
    for action in ([0, 2, 4], [4, 4, 1]):
        td = env.step_mdp(env.step(td.set("action", torch.tensor(action))))
    before, mask = td.clone(), torch.tensor([[True], [False], [True]])
    after = env.step_mdp(env.step(td.set("action", torch.tensor([4, 4, 4])).set("_step", mask)))
    for key, value in before.exclude("action", "_step").items():
        assert torch.equal(after[key][1], value[1]), key
    if name == "FrameStack":  # the view before the pause is the one before the next
        later = env.step(after.exclude("_step").set("action", torch.tensor([4, 4, 4])))["next"]
        assert torch.equal(later["pixels"][1, ..., :6], before["pixels"][1, ..., 3:])


@pytest.mark.parametrize("kind", ["bare", "plain", "shaky", "wrapped"])
def test_pickled_and_copied_envs_continue_like_the_original(kind: str, tmp_path: Path) -> None:
    makers: dict[str, Callable[[], EnvBase]] = {
        "bare": lambda: tiny_env((3,), first=1, window=1, threshold=0.01),
        "plain": lambda: make_env([*tiny_overrides(tmp_path), "curriculum.window=1"], [3]),
        "shaky": lambda: shaky(tmp_path),
        "wrapped": lambda: TransformedEnv(shaky(tmp_path), Compose(RewardScaling(0.0, 2.0))),
    }
    env = makers[kind]()
    torch.manual_seed(0)
    env.rollout(24, break_when_any_done=False)  # episodes have 20 steps at most
    envs = [env, pickle.loads(pickle.dumps(env)), copy.deepcopy(env)]
    runs = []
    for one in envs:
        torch.manual_seed(1)
        runs.append((one.rollout(24, break_when_any_done=False), seeded_rollout(one, 5, 7)))
    for other, (went, again) in zip(envs[1:], runs[1:], strict=True):
        assert type(other) is type(env) and layers(other)[0] is not layers(env)[0]
        assert_same(went, runs[0][0])
        assert torch.equal(layers(other)[0].curriculum.progress, layers(env)[0].curriculum.progress)
        assert_same(again, runs[0][1])


def test_a_pickle_holds_paths_and_no_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    overrides = [one for one in tiny_overrides(tmp_path) if not one.startswith("scene.path")]
    pickled = pickle.dumps(make_env([*overrides, "scene.path=tiny.ply", *SHAKES], [3]))
    monkeypatch.chdir("/")
    assert b"tiny.ply" in pickled and b"Gaussians" not in pickled
    read: list[Any] = []
    make = worlds.check_config
    monkeypatch.setattr(worlds, "check_config", lambda cfg: (read.append(cfg), make(cfg)))
    pickle.loads(pickled)
    assert len(read) == 1


def test_a_compose_can_be_added_like_the_transforms_in_it(tmp_path: Path) -> None:
    def added() -> Compose:
        return Compose(StepCounter(5, step_count_key="actions"), Compose(RewardSum()))

    makers: list[Callable[[], EnvBase]] = [
        lambda: tiny_env((3,)).append_transform(added()),
        lambda: StatefulEnv(tiny_env((3,)), added()),
        lambda: StatefulEnv(tiny_env((3,)), RewardScaling(0.0, 1.0)).insert_transform(0, added()),
        lambda: StatefulEnv(tiny_env((3,)), RewardScaling(0.0, 1.0)).insert_transform(-1, added()),
    ]
    expected = StatefulEnv(tiny_env((3,)), *added()[:1], RewardSum())
    for make in makers:
        env = make()
        assert [type(each) for each in env.transform][:2] == [StepCounter, RewardSum]
        assert_same(*(seeded_rollout(one, 6, 0) for one in (env, expected)))


def test_torchrls_frame_skip_is_refused_wherever_it_can_be_detected(tmp_path: Path) -> None:
    theirs = FrameSkipTransform(3)
    refused = pytest.raises(ValueError, match=r"FrameSkipTransform: expected splatrl\.envs\.transforms\.FrameSkip")
    with refused:
        shaky(tmp_path).append_transform(theirs)
    with refused:
        shaky(tmp_path).insert_transform(0, Compose(theirs))
    with refused:
        StatefulEnv(tiny_env((2,)), theirs)
    with refused:
        tiny_env((2,)).append_transform(theirs)
    with refused:
        GymnasiumVectorEnv(TransformedEnv(tiny_env((2,)), theirs))
    node = ["allow_targets=[torchrl]", "+transforms.theirs._target_=torchrl.envs.FrameSkipTransform"]
    with refused:
        make_env([*tiny_overrides(tmp_path), *node, "transforms.order=[theirs]"])


@pytest.mark.parametrize(
    "theirs, dropped",
    [
        (SelectTransform("state", "level", "goals"), "episode_return, recurrent_state, step_count"),
        (ExcludeTransform("step_count"), "step_count"),
        (RenameTransform(["state"], ["place"]), "state"),
        (
            Compose(RewardSum(), SelectTransform("state", "level", "goals", "step_count")),
            "episode_return, episode_reward",
        ),
    ],
)
def test_a_transform_that_drops_what_the_next_step_reads_is_refused(
    theirs: Transform, dropped: str, tmp_path: Path
) -> None:
    refused = pytest.raises(ValueError, match=rf"Transform: expected .*, got one that drops {dropped}")
    gru = make_env([*tiny_overrides(tmp_path), "memory=gru"], batch_size=[2])
    before = list(gru.transform)
    with refused:
        gru.append_transform(theirs.clone())
    with refused:
        gru.insert_transform(len(gru.transform), theirs.clone())
    with refused:
        StatefulEnv(gru, theirs.clone())
    with refused:
        GymnasiumVectorEnv(TransformedEnv(TransformedEnv(gru, theirs.clone()), RewardSum()))
    assert list(gru.transform) == before


def test_transforms_that_leave_what_the_next_step_reads_are_accepted() -> None:
    torch.manual_seed(0)  # actions with which no episode ends
    env = tiny_env((2,))
    env = env.append_transform(RenameTransform(["state"], ["place"], ["state"], ["place"]))
    env = env.append_transform(SelectTransform("pixels", *env.state_spec.keys()))
    env = env.append_transform(ExcludeTransform("pixels"))
    after = env.rollout(3, break_when_any_done=False)
    assert torch.equal(after["place"][:, 1:], after["next", "place"][:, :-1])
    assert not {"outcome", "pixels"} & {*after["next"].keys()}


@pytest.mark.parametrize("together", [False, True])
def test_an_observation_norm_takes_its_statistics_from_the_env_that_it_is_added_to(together: bool) -> None:
    env, transforms = tiny_env((2,)), [ObservationNorm(in_keys=["free_fraction"]), RewardSum()]
    for transform in [Compose(*transforms)] if together else transforms:
        env = env.append_transform(transform)
    with pytest.raises(ValueError, match="FrameSkipTransform: expected"):
        env.append_transform(FrameSkipTransform(2))
    env.transform[0].init_stats(8, reduce_dim=(0, 1), cat_dim=1)
    with pytest.raises(ValueError, match="SelectTransform: expected"):
        env.append_transform(SelectTransform("pixels"))
    assert {"episode_reward", "free_fraction"} <= {*env.rollout(2).keys()}


class Watch(Transform):
    """Keeps what a transform finds in a reset."""

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        self.found = tensordict_reset.clone()
        return tensordict_reset


@pytest.mark.parametrize("around", [StatefulEnv, TransformedEnv])
def test_in_a_partial_reset_transforms_find_other_robots_as_they_were_last(around: type[TransformedEnv]) -> None:
    watch = Watch()
    env = around(tiny_env((3,)), watch)
    last = env.step(env.reset().set("action", torch.tensor([4, 4, 4])))["next"].clone()
    ended = torch.tensor([[True], [False], [True]])
    last["done"], last["terminated"] = ended, ended
    fresh = env.maybe_reset(last.exclude("reward"))
    rest = ~ended.flatten()
    for key in ("pixels", "state", "step_count"):
        assert torch.equal(watch.found[key][rest], last[key][rest])
        assert torch.equal(watch.found[key][~rest], fresh[key][~rest])
    assert not watch.found["done"].any()


def test_action_transforms_work_around_it(tmp_path: Path) -> None:
    env = make_env(tiny_overrides(tmp_path, "drive"), batch_size=[3])
    around = TransformedEnv(env, ActionDiscretizer(3, out_action_key="choice"))
    rollout = around.rollout(4, break_when_any_done=False)
    assert rollout["choice"].dtype == torch.int64 and env.action_spec.is_in(rollout["action"][:, 0])


@pytest.mark.parametrize("size", [[2, 4], [], [0], [-1], 4])
def test_an_invalid_batch_size_is_refused(size: list[int], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"batch_size: expected a list with one whole number of at least 1, got"):
        make_env(tiny_overrides(tmp_path), batch_size=size)
