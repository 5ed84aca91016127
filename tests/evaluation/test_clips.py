from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.data import Categorical
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import step_mdp

from splatrl.evaluation.clip_files import read_clips, write_clip
from splatrl.evaluation.clips import Clip, ClipResult, match, table, total
from splatrl.evaluation.policy_camera import Eye
from splatrl.training import actor_critic, memory_transforms
from tests.tiny import tiny_env

NAMES = ("forward", "back", "left", "right")
HEIGHT, WIDTH = 12, 16
EYE = Eye(HEIGHT, WIDTH)
PROBABILITIES = torch.tensor([0.1, 0.2, 0.3, 0.4])


class Recorder(nn.Module):
    """Returns the same logits for every image, and records the images."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[Tensor] = []

    def forward(self, pixels: Tensor) -> Tensor:
        self.seen.append(pixels)
        return PROBABILITIES.log().expand(len(pixels), 4) + 5


def recorder() -> tuple[Recorder, TensorDictModule]:
    module = Recorder()
    return module, TensorDictModule(module, in_keys=["pixels"], out_keys=["logits"])


def clips(folder: Path, labels: Sequence[Sequence[Sequence[int]]]) -> list[Clip]:
    """Write and read clips of random frames, given the allowed actions of each frame of each clip."""
    generator = torch.Generator().manual_seed(3)
    for number, frames in enumerate(labels):
        allowed = torch.tensor([[action in frame for action in range(4)] for frame in frames])
        images = torch.randint(0, 256, (len(frames), HEIGHT, WIDTH, 3), generator=generator, dtype=torch.uint8)
        write_clip(folder / f"clip-{number}", images, allowed, NAMES)
    return read_clips(folder, NAMES)


def test_matches_and_probability_are_counted_over_labelled_frames_only(tmp_path: Path) -> None:
    policy = recorder()[1]
    found = match(policy, NAMES, clips(tmp_path, [[[3], [], [0, 3], [2]], [[0, 1]]]), EYE)
    assert [(one.name, one.frames, one.matches) for one in found] == [("clip-0", 3, 2), ("clip-1", 1, 0)]
    assert [one.mass for one in found] == pytest.approx([(0.4 + 0.5 + 0.3) / 3, 0.3])
    assert found[0].rate == pytest.approx(2 / 3)
    every = total(found)
    assert (every.frames, every.matches, every.rate) == (4, 2, 0.5)
    assert every.mass == pytest.approx((0.4 + 0.5 + 0.3 + 0.3) / 4)


def test_the_policy_sees_each_frame_once_in_order_and_progress_is_reported(tmp_path: Path) -> None:
    module, policy = recorder()
    shown: list[int] = []
    some = clips(tmp_path, [[[3], [], [1]]])
    match(policy, NAMES, some, EYE, progress=shown.append)
    written = [torch.from_numpy(np.array(image)) for image in some[0].images()]
    assert torch.equal(torch.cat(module.seen), torch.stack(written))
    assert shown == [1, 1, 1]


def test_stacked_frames_end_with_the_newest_and_are_padded_with_the_first(tmp_path: Path) -> None:
    module, policy = recorder()
    some = clips(tmp_path, [[[3]] * 4, [[3]] * 2])
    match(policy, NAMES, some, replace(EYE, views=3))
    one, two = ([torch.from_numpy(np.array(image)) for image in clip.images()] for clip in some)
    expected = [(one, order) for order in ((0, 0, 0), (0, 0, 1), (0, 1, 2), (1, 2, 3))]
    expected += [(two, order) for order in ((0, 0, 0), (0, 0, 1))]
    for pixels, (frames, order) in zip(module.seen, expected, strict=True):
        assert torch.equal(pixels[0], torch.cat([frames[number] for number in order], -1))


@pytest.fixture
def remembering() -> tuple[TensorDictModuleBase, TensorDictBase]:
    """A recurrent policy, and its inputs at the start of an episode."""
    torch.manual_seed(1)
    policy = actor_critic((HEIGHT, WIDTH, 3), Categorical(4), pool=1, features=16, memory=8).get_policy_operator()
    env = TransformedEnv(tiny_env([1]), Compose(*memory_transforms(8)))
    return policy, env.reset().select("recurrent_state", "is_init")


def test_a_recurrent_state_is_carried_through_a_clip_and_reset_for_the_next(
    tmp_path: Path, remembering: tuple[TensorDictModuleBase, TensorDictBase], monkeypatch: pytest.MonkeyPatch
) -> None:
    policy, start = remembering
    some = clips(tmp_path, [[[3]] * 4, [[3]] * 3])
    logits: list[Tensor] = []
    policy.register_forward_hook(lambda module, given, out: logits.append(out["logits"].clone()))
    before = start.clone()
    match(policy, NAMES, some, EYE, start)
    found, logits = logits, []
    assert all(torch.equal(start[key], before[key]) for key in ("recurrent_state", "is_init"))
    policy._forward_hooks.clear()
    with torch.no_grad():
        for clip in some:
            td = start.clone()
            for number, image in enumerate(clip.images()):
                td["pixels"] = torch.from_numpy(np.array(image)).unsqueeze(0)
                td["is_init"] = torch.full((1, 1), number == 0)
                td = policy(td)
                logits.append(td["logits"])
                td = step_mdp(td.set(("next", "is_init"), td["is_init"]), exclude_action=True)
    assert torch.allclose(torch.cat(found), torch.cat(logits), atol=1e-6)
    alone = policy(start.clone().set("pixels", torch.from_numpy(np.array(list(some[0].images())[1])).unsqueeze(0)))
    assert not torch.allclose(found[1], alone["logits"], atol=1e-4)  # without the earlier frames


def test_a_policy_whose_inputs_are_not_all_given_is_refused(
    tmp_path: Path, remembering: tuple[TensorDictModuleBase, TensorDictBase]
) -> None:
    with pytest.raises(ValueError, match=r"start: expected .*recurrent_state.*, which the policy reads"):
        match(remembering[0], NAMES, clips(tmp_path, [[[3]]]), EYE)


def test_scoring_is_repeatable_tracks_no_gradients_and_leaves_the_global_generator_alone(tmp_path: Path) -> None:
    policy = actor_critic((HEIGHT, WIDTH, 3), Categorical(4), pool=1).get_policy_operator()
    tracked: list[bool] = []
    policy.register_forward_hook(lambda module, given, out: tracked.append(out["logits"].requires_grad))
    some = clips(tmp_path, [[[3]] * 3])
    state = torch.get_rng_state()
    first = match(policy, NAMES, some, EYE)
    assert torch.equal(torch.get_rng_state(), state)
    assert match(policy, NAMES, some, EYE) == first
    assert tracked == [False] * 6


def test_the_table_compares_runs_side_by_side() -> None:
    with_noise = [ClipResult("a", 4, 3, 0.5), ClipResult("b", 2, 0, 0.25)]
    without = [ClipResult("a", 4, 1, 0.25), ClipResult("b", 2, 2, 1.0)]
    assert table({"with": with_noise, "without": without}).splitlines() == [
        "| clip | frames | with | without |",
        "| --- | ---: | ---: | ---: |",
        "| a | 4 | 0.750 (0.500) | 0.250 (0.250) |",
        "| b | 2 | 0.000 (0.250) | 1.000 (1.000) |",
        "| total | 6 | 0.500 (0.417) | 0.500 (0.500) |",
    ]


def test_a_policy_must_have_as_many_actions_as_there_are_names(tmp_path: Path) -> None:
    def three(pixels: Tensor) -> Tensor:
        return torch.zeros(len(pixels), 3)

    policy = TensorDictModule(three, in_keys=["pixels"], out_keys=["logits"])
    with pytest.raises(ValueError, match=r"expected 4 actions \(forward, back, left, right\), got a policy with 3"):
        match(policy, NAMES, clips(tmp_path, [[[3]]]), EYE, TensorDict({}, [1]))
