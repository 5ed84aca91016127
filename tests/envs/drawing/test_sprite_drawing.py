"""The transform around the overlay."""

import pytest
import torch
from hydra.utils import instantiate
from tensordict import TensorDict
from torchrl.envs import EnvBase, TransformedEnv

from splatrl.configuration import load_config
from splatrl.envs.transforms import SpriteDrawing, overlay
from tests.envs.contract import seeded_rollout
from tests.envs.transforms.views import PLACE, plain_sprite, seeing_env, transformed
from tests.tiny import tiny_env, tiny_robot

K = tiny_robot().K


def test_an_episode_shows_the_overlay_of_what_the_env_sees() -> None:
    batch = seeded_rollout(transformed((6,), 0, ("SpriteDrawing",)), 12, 0).flatten()
    clean = seeing_env((len(batch),)).reset(batch.select("state"), set_state=True)
    view = clean["pixels"], clean["depth"], clean["camera_to_world"]
    pixels, share = overlay(*view, K, torch.tensor(PLACE), plain_sprite(), 0.3)
    assert torch.equal(batch["pixels"], pixels) and torch.equal(batch["sprite_share"], share)
    assert (share > 0).any() and (share == 0).any()


def test_the_block_in_the_middle_hides_the_sprite_behind_it() -> None:
    env = transformed((2,), 0, ("SpriteDrawing",))
    state = torch.tensor([[0, 3, 0], [3, 3, 0]])  # from x = -1 through the block, and from x = 0.5 beyond it, to +x
    share = env.reset(TensorDict({"state": state}, [2]), set_state=True)["sprite_share"].flatten()
    assert share[0] == 0 and share[1] > 0.1


def test_the_target_of_the_env_is_where_it_is_drawn() -> None:
    td = seeing_env((2,)).reset()
    places = td["camera_to_world"][:, :3, 3] + 0.3 * td["camera_to_world"][:, :3, 2]  # ahead of each camera
    ahead = td.clone().set("target", places)
    after = SpriteDrawing(K, plain_sprite(), size=0.1)(ahead)
    assert (after["sprite_share"] > 0.01).all() and (after["pixels"] != td["pixels"]).any()
    elsewhere = SpriteDrawing(K, plain_sprite(), size=0.1, position=[0.0, 0.0, -50.0])(ahead.clone())
    assert (elsewhere["sprite_share"] < 0.01).all()


@pytest.mark.parametrize(
    ("make", "position", "message"),
    [(tiny_env, PLACE, "shows depth.*depth=True"), (seeing_env, None, "shows target.*sprite.position")],
)
def test_an_env_that_does_not_show_what_it_needs_is_refused(make: type[EnvBase], position: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TransformedEnv(make((3,)), SpriteDrawing(K, plain_sprite(), position=position)).observation_spec  # noqa: B018


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"size": 0.0}, "sprite.size"),
        ({"near": float("nan")}, "sprite.near"),
        ({"position": [1.0, 2.0]}, "sprite.position"),
        ({"position": [1.0, 2.0, float("inf")]}, "sprite.position"),
        ({"sprite": "pear"}, "apple or the path"),
        ({"K": torch.eye(4)}, "sprite.K"),
    ],
)
def test_wrong_settings_are_refused_by_name(settings: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SpriteDrawing(**{"K": K, "sprite": plain_sprite(), **settings})


def test_the_configs_build_it() -> None:
    assert load_config(["transforms/sprite=none"]).transforms.sprite == {}
    made = instantiate(load_config(["transforms/sprite=apple"]).transforms.sprite)(K)
    assert made.size == 0.16 and torch.equal(made.K, K) and made.in_keys[-1] == "target"
