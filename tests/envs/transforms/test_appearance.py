"""Appearance: how images look with another camera and under another light."""

import pytest
import torch
from hydra.utils import instantiate
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import TransformedEnv

from splatrl.configuration import load_config
from splatrl.envs.transforms import Appearance, appearance
from splatrl.envs.transforms.appearance import NEUTRAL
from splatrl.native import _core
from tests.envs.contract import seeded_rollout
from tests.envs.transforms.views import seeing_env

OFF = {"brightness": 0.0, "contrast": 0.0, "white_balance": 0.0, "blur": 0.0, "noise": 0.0}
NAMES = ("brightness", "contrast", "red", "green", "blue", "blur", "noise")


def seen(images: Tensor, **look: float) -> Tensor:
    """Return images under a given appearance."""
    row = torch.tensor([look.get(name, neutral) for name, neutral in zip(NAMES, NEUTRAL, strict=True)])
    td = TensorDict({"pixels": images, "appearance": row.expand(*images.shape[:-3], 7)}, images.shape[:-3])
    return Appearance(blur=2.0)(td)["pixels"]


def pictures(count: int = 2, height: int = 10, width: int = 14) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.randint(0, 256, (count, height, width, 3), dtype=torch.uint8, generator=generator)


def test_ranges_of_zero_change_no_byte() -> None:
    env, clean = TransformedEnv(seeing_env(), Appearance(**OFF)), seeing_env()
    left, right = seeded_rollout(env, 10, 0), seeded_rollout(clean, 10, 0)
    assert torch.equal(left["appearance"], torch.tensor(NEUTRAL).expand(3, 10, 7))
    for data in (left, left["next"]):
        seen_before = clean.reset(data[:, 5].select("state"), set_state=True)["pixels"]
        assert torch.equal(data["pixels"][:, 5], seen_before)
    assert set(right.keys()) == set(left.keys()) - {"appearance"}


def test_a_neutral_appearance_changes_no_byte_even_where_others_vary() -> None:
    images = pictures()
    assert torch.equal(seen(images), images)


def test_brightness_adds_a_fraction_of_white() -> None:
    images = torch.tensor([0, 100, 250], dtype=torch.uint8).view(1, 1, 1, 3)
    assert seen(images, brightness=0.1).flatten().tolist() == [26, 126, 255]
    assert seen(images, brightness=-0.1).flatten().tolist() == [0, 75, 225]


def test_contrast_stretches_about_the_middle() -> None:
    images = torch.tensor([1, 101, 201], dtype=torch.uint8).view(1, 1, 1, 3)
    assert seen(images, contrast=1.2).flatten().tolist() == [0, 96, 216]  # 127.5 + 1.2 · (v − 127.5)
    assert seen(images, contrast=0.8).flatten().tolist() == [26, 106, 186]


def test_white_balance_multiplies_each_colour() -> None:
    images = torch.full((1, 2, 3, 3), 100, dtype=torch.uint8)
    changed = seen(images, red=1.1, green=1.0, blue=0.9)
    assert (changed == torch.tensor([110, 100, 90])).all()


def test_a_blur_spreads_a_point_as_a_gaussian_does() -> None:
    images = torch.zeros(1, 15, 17, 3, dtype=torch.uint8)
    images[0, 7, 8, 1] = 255
    spread = seen(images, blur=1.0)[0, ..., 1].float()
    steps = torch.arange(-7, 8)
    kernel = torch.exp(-0.5 * steps.float() ** 2)
    expected = 255 * kernel.view(-1, 1) * torch.exp(-0.5 * torch.arange(-8, 9).float() ** 2) / kernel.sum() ** 2
    torch.testing.assert_close(spread, expected, atol=0.6, rtol=0)
    assert not seen(images, blur=1.0)[0, ..., [0, 2]].any()


def test_a_blur_leaves_a_uniform_image_unchanged_up_to_its_border() -> None:
    images = torch.full((1, 4, 3, 3), 77, dtype=torch.uint8)  # smaller than the blur kernel
    assert torch.equal(seen(images, blur=2.0), images)


def test_sensor_noise_has_its_standard_deviation_and_is_independent_per_image_and_channel() -> None:
    images = torch.full((2, 64, 64, 3), 128, dtype=torch.uint8)
    change = seen(images, noise=0.04).float() - 128
    assert change.std().item() == pytest.approx(0.04 * 255, rel=0.03) and abs(change.mean().item()) < 0.3
    assert not torch.equal(change[0], change[1])
    assert abs(torch.corrcoef(torch.stack([change[..., 0].flatten(), change[..., 1].flatten()]))[0, 1].item()) < 0.05


def test_each_image_has_its_own_appearance() -> None:
    images = pictures(1).expand(2, -1, -1, -1).clone()
    looks = torch.tensor([[0.1, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0], [0.0, 1.2, 0.9, 1.0, 1.1, 1.0, 0.0]])
    both = Appearance()(TensorDict({"pixels": images, "appearance": looks}, [2]))["pixels"]
    for row in range(2):
        alone = Appearance()(TensorDict({"pixels": images[row], "appearance": looks[row]}, []))["pixels"]
        assert torch.equal(both[row], alone)


@pytest.mark.parametrize(("height", "width"), [(10, 14), (1, 1), (3, 40)])
@pytest.mark.parametrize("ranges", [{"blur": 3.0}, {"blur": 0.0}, {"noise": 0.0, "contrast": 1.0}, {"blur": 0.3}])
def test_the_core_changes_images_as_pytorch_does(
    ranges: dict[str, float], height: int, width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    images, made = pictures(20, height, width), Appearance(**ranges)
    looks = made._draw(torch.Size([20]))
    looks[0], looks[1, 5] = torch.tensor(NEUTRAL), 0.0

    def change() -> Tensor:
        torch.manual_seed(0)
        return Appearance(**ranges)._changed(images, looks, None)

    by_core = change()
    monkeypatch.setattr(appearance, "in_core", lambda images: False)
    apart = (by_core.int() - change().int()).abs()
    assert apart.max() <= 1 and (apart > 0).double().mean() < 1e-3
    assert torch.equal(by_core[0], images[0]) and (by_core != images).any()


def test_the_core_refuses_sizes_that_do_not_match() -> None:
    images, weights, color, grain = pictures(), torch.ones(2, 1), torch.ones(2, 3), torch.zeros(2)
    for sizes in ((weights[:1], color, grain), (weights, torch.ones(2, 4), grain), (weights, color, torch.zeros(3))):
        with pytest.raises(ValueError, match="appearance: expected every argument to have one row per image"):
            _core.change_appearance(images, sizes[0], sizes[1], color, sizes[2], None, images.clone(), 1)
    with pytest.raises(ValueError, match="appearance: expected every argument to have one row per image"):
        noise = torch.zeros(2, 10, 14)
        _core.change_appearance(images, weights, color, color, grain, noise, images.clone(), 1)


def test_drawn_appearances_fill_their_ranges() -> None:
    drawn = Appearance(0.1, 0.2, 0.3, 0.4, 0.05)._draw(torch.Size([5000]))
    lower = torch.tensor([-0.1, 0.8, 0.7, 0.7, 0.7, 0.0, 0.0])
    upper = torch.tensor([0.1, 1.2, 1.3, 1.3, 1.3, 0.4, 0.05])
    assert (drawn >= lower).all() and (drawn <= upper).all()
    span = upper - lower
    assert (drawn.amin(0) < lower + 0.01 * span).all() and (drawn.amax(0) > upper - 0.01 * span).all()
    torch.testing.assert_close(drawn.mean(0), (lower + upper) / 2, atol=0.01, rtol=0)


def test_an_episode_keeps_its_appearance_and_the_next_has_another() -> None:
    batch = seeded_rollout(TransformedEnv(seeing_env((6,)), Appearance()), 12, 0)
    assert torch.equal(batch["next", "appearance"], batch["appearance"])
    ended = batch["next", "done"][:, :-1, 0]
    before, after = batch["appearance"][:, :-1], batch["appearance"][:, 1:]
    assert torch.equal(before[~ended], after[~ended]) and ended.any()
    assert (before[ended] != after[ended]).all()


def test_a_given_appearance_is_kept_by_a_reset() -> None:
    env = TransformedEnv(seeing_env(), Appearance(noise=0.0))
    first = env.reset().clone()
    env.rollout(3)
    again = env.reset(first.select("state", "appearance"), set_state=True)
    assert torch.equal(again["pixels"], first["pixels"]) and torch.equal(again["appearance"], first["appearance"])
    other = env.reset(first.select("state"), set_state=True)
    assert not torch.equal(other["appearance"], first["appearance"])


def test_a_robot_that_is_reset_after_its_episode_gets_another_appearance_though_it_hands_over_the_last() -> None:
    env = TransformedEnv(seeing_env(), Appearance())
    first = env.reset().clone()
    mask = torch.tensor([[True], [False], [True]])
    again = env.reset(first.clone().set("_reset", mask), set_state=False)
    changed = (again["appearance"] != first["appearance"]).any(1)
    assert torch.equal(changed, mask.flatten())
    kept = env.reset(first.clone().set("_reset", mask), set_state=True)
    assert torch.equal(kept["appearance"], first["appearance"])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"brightness": -0.1}, "appearance.brightness"),
        ({"contrast": 1.5}, "appearance.contrast"),
        ({"brightness": "a"}, "appearance.brightness"),
        ({"white_balance": float("nan")}, "appearance.white_balance"),
        ({"blur": 100.0}, "appearance.blur"),
        ({"noise": float("inf")}, "appearance.noise"),
    ],
)
def test_invalid_settings_are_refused_by_name(settings: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Appearance(**settings)


def test_the_configs_build_the_transform() -> None:
    assert load_config(["transforms/appearance=none"]).transforms.appearance == {}
    made = instantiate(load_config(["transforms/appearance=varied"]).transforms.appearance)
    assert torch.equal(made.ranges, Appearance().ranges)
