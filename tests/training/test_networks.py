"""The network of actor and critic."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Categorical
from torchrl.envs.utils import ExplorationType, set_exploration_type

from splatrl.training import actor_critic
from splatrl.training.networks import PoolPixels

HEIGHT, WIDTH, ACTIONS, FEATURES = 14, 20, 5, 24
SPEC = Categorical(ACTIONS)


def images(*batch: int, seed: int = 0) -> TensorDict:
    generator = torch.Generator().manual_seed(seed)
    pixels = torch.randint(0, 256, (*batch, HEIGHT, WIDTH, 3), generator=generator, dtype=torch.uint8)
    return TensorDict({"pixels": pixels}, batch)


@pytest.fixture
def model() -> torch.nn.Module:
    torch.manual_seed(0)
    return actor_critic((HEIGHT, WIDTH, 3), SPEC, pool=1, channels=(4, 7), features=FEATURES)


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
def test_it_writes_action_and_value_for_any_batch(model: torch.nn.Module, batch: tuple[int, ...]) -> None:
    td = model(images(*batch))
    shapes = {key: value.shape for key, value in td.items()}
    assert shapes == {
        "pixels": (*batch, HEIGHT, WIDTH, 3),
        "image": (*batch, HEIGHT, WIDTH, 3),
        "hidden": (*batch, FEATURES),
        "logits": (*batch, ACTIONS),
        "action": batch,
        "action_log_prob": batch,
        "state_value": (*batch, 1),
    }
    assert td["action"].dtype == torch.int64 and set(td["action"].unique().tolist()) <= set(range(ACTIONS))
    chosen = td["logits"].log_softmax(-1).gather(-1, td["action"].unsqueeze(-1)).squeeze(-1)
    torch.testing.assert_close(td["action_log_prob"], chosen)


def test_an_image_gives_the_same_outputs_alone_and_in_a_batch(model: torch.nn.Module) -> None:
    together = model(images(2, 3))
    for i, j in ((0, 0), (1, 2)):
        alone = model(images(2, 3)[i, j])
        for key in ("hidden", "logits", "state_value"):
            torch.testing.assert_close(alone[key], together[key][i, j], atol=1e-5, rtol=1e-5)


def test_different_images_give_different_features(model: torch.nn.Module) -> None:
    views = model(images(2))
    assert not torch.allclose(views["hidden"][0], views["hidden"][1], atol=1e-3)


def test_the_first_policy_is_nearly_uniform(model: torch.nn.Module) -> None:
    logits = model(images(50))["logits"]
    assert logits.std() > 0 and (logits.softmax(-1) - 1 / ACTIONS).abs().max() < 0.02


def test_actions_are_sampled_unless_the_mode_is_asked_for(model: torch.nn.Module) -> None:
    same = images(1).expand(400)
    assert len(model(same.clone())["action"].unique()) == ACTIONS
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        td = model(same.clone())
    assert (td["action"] == td["logits"].argmax(-1)).all()


def test_the_heads_read_what_the_trunk_wrote(model: torch.nn.Module) -> None:
    whole = model(images(4))
    value = model.get_value_operator()(images(4))
    head = model.get_value_head()(whole.select("hidden"))
    assert torch.equal(value["state_value"], whole["state_value"])
    assert torch.equal(value["state_value"], head["state_value"])
    logits = model.get_policy_head()(whole.select("hidden"))["logits"]
    assert torch.equal(logits, whole["logits"])


def test_pooling_takes_the_mean_of_each_cell() -> None:
    pixels = torch.zeros(2, 4, 6, 3, dtype=torch.uint8)
    pixels[1, 2:, 4:, 0] = torch.tensor([[255, 0], [0, 255]])
    pixels[0, 0, 0, 2] = 255
    expected = torch.full((2, 2, 3, 3), -0.5)
    expected[1, 1, 2, 0], expected[0, 0, 0, 2] = 0.0, -0.25
    torch.testing.assert_close(PoolPixels(2)(pixels), expected)


@pytest.mark.parametrize("shape", [(3, 13, 20, 3), (2, 2, 9, 8, 6), (0, 8, 8, 3), (12, 15, 1)])
@pytest.mark.parametrize("pool", [1, 2, 3, 5])
@pytest.mark.parametrize("most", [255, 1])
def test_the_core_pools_images_as_pytorch_does(shape: tuple[int, ...], pool: int, most: int) -> None:
    pixels = torch.randint(0, 256, shape, dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    pixels = pixels if most == 255 else pixels / 255
    means = torch.nn.functional.avg_pool2d(pixels.reshape(-1, *shape[-3:]).permute(0, 3, 1, 2).double(), pool)
    expected = (means.permute(0, 2, 3, 1) / most - 0.5).float().reshape(*shape[:-3], *means.shape[2:], shape[-1])
    torch.testing.assert_close(PoolPixels(pool)(pixels), expected, rtol=0, atol=1e-7)
    sides = PoolPixels(pool)(pixels.transpose(-2, -3).contiguous().transpose(-2, -3))
    assert torch.equal(sides, PoolPixels(pool)(pixels))
    if most == 1:
        differentiable = PoolPixels(pool)(pixels.requires_grad_())
        assert differentiable.requires_grad
        torch.testing.assert_close(differentiable, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("height", "width", "pool"), [(16, 15, 2), (7, 20, 1)])
def test_an_image_that_is_too_small_is_refused(height: int, width: int, pool: int) -> None:
    with pytest.raises(ValueError, match=rf"expected at least 8 × 8 pixels after pooling, got {height // pool} × "):
        actor_critic((height, width, 3), SPEC, pool)


@pytest.mark.parametrize("pool", [1, 2, 3])
def test_the_smallest_allowed_image_is_accepted(pool: int) -> None:
    pixels = torch.zeros(2, 8 * pool, 9 * pool, 3, dtype=torch.uint8)
    td = actor_critic((8 * pool, 9 * pool, 3), SPEC, pool)(TensorDict({"pixels": pixels}, [2]))
    assert td["hidden"].shape == (2, 128)


def test_every_stacked_frame_affects_the_features() -> None:
    torch.manual_seed(0)
    model = actor_critic((HEIGHT, WIDTH, 12), SPEC, pool=1, channels=(4, 7), features=FEATURES)
    pixels = torch.randint(0, 256, (1, HEIGHT, WIDTH, 12), dtype=torch.uint8)
    first = model(TensorDict({"pixels": pixels}, [1]))
    for frame in range(4):
        changed = pixels.clone()
        changed[..., 3 * frame : 3 * frame + 3] = 255 - changed[..., 3 * frame : 3 * frame + 3]
        assert not torch.allclose(model(TensorDict({"pixels": changed}, [1]))["hidden"], first["hidden"], atol=1e-3)
