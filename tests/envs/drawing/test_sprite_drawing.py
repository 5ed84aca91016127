"""``SpriteDrawing``, which draws a sprite into the scene."""

import pytest
import torch
from hydra.utils import instantiate
from tensordict import TensorDict

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.configuration import load_config
from splatrl.envs.drawing import DepthDrawing, SceneDrawing, Shot, SpriteDrawing, overlay
from splatrl.envs.drawing.base import solid_depth
from splatrl.envs.transforms.weather import CLEAR, Weather
from splatrl.renderers.base import to_pixels
from tests.envs.contract import EnvContract, seeded_rollout
from tests.envs.transforms.views import PLACE, plain_drawing, plain_sprite, renderer, seeing_env
from tests.tiny import CountingRenderer, tiny_motion, tiny_robot


def cameras(*states: list[int]) -> Cameras:
    return tiny_robot().cameras(tiny_motion().body_to_world(torch.tensor(states)))


class TestContract(EnvContract):
    steps = 16

    def make(self, batch_size: tuple[int], seed: int = 0) -> object:
        return seeing_env(batch_size, seed, sprite=True)

    def test_some_views_show_the_sprite_and_some_do_not(self) -> None:
        share = seeded_rollout(self.make((3,)), self.steps, 0)["sprite_share"]
        assert (share > 0.01).any() and (share == 0).any()


def test_an_episode_shows_the_sprite_over_the_rendered_scene() -> None:
    batch = seeded_rollout(seeing_env((6,), sprite=True), 12, 0).flatten()
    seen = tiny_robot().cameras(tiny_motion().body_to_world(batch["state"]))
    rgb, depth, alpha = renderer().render(seen)
    view = to_pixels(rgb), solid_depth(depth, alpha), seen.camera_to_world, tiny_robot().K
    pixels, share, _ = overlay(*view, torch.tensor(PLACE), plain_sprite(), 0.3)
    assert torch.equal(batch["pixels"], pixels) and torch.equal(batch["sprite_share"], share)
    assert (share > 0).any() and (share == 0).any()


def test_the_block_in_the_middle_hides_the_sprite_behind_it() -> None:
    # looking along +x, from x = -1 through the block and from x = 0.5 beyond it
    share = plain_drawing().draw(Shot(cameras([0, 3, 0], [3, 3, 0]))).shown["sprite_share"].flatten()
    assert share[0] == 0 and share[1] > 0.1


def test_the_sprite_has_its_own_depth_before_a_wall_and_before_nothing_and_fades_little_in_thin_fog() -> None:
    eyes = torch.tensor([[-1.0, 0.0, 0.5], [0.5, 0.0, 0.5], [5.0, 0.0, 0.5]])  # behind the block, beyond it, outside
    poses = look_at(eyes, eyes + torch.tensor([1.0, 0.0, 0.0]))
    target = torch.tensor([[1.2, 0.0, 0.5], [1.2, 0.0, 0.5], [6.0, 0.0, 0.5]])
    shot = Shot(Cameras(poses, intrinsics(1.5, 17, 11), 17, 11), {"target": target})
    bare = DepthDrawing(SceneDrawing(renderer()), 11, 17).draw(shot).shown["view_depth"]
    pixels, shown, _ = DepthDrawing(SpriteDrawing(renderer(), plain_sprite(), size=0.2), 11, 17).draw(shot)
    depth = shown["view_depth"]
    assert torch.equal(depth[0], bare[0]) and bare[1, 5, 8] > 0.9 and bare[2, 5, 8] == torch.inf
    torch.testing.assert_close(depth[1:, 5, 8], torch.tensor([0.7, 1.0]))
    assert torch.equal(depth[:, :, 0], bare[:, :, 0])
    weather = torch.tensor([CLEAR] * 3)
    weather[:, 0] = 0.001  # fog
    foggy = Weather()(TensorDict({"pixels": pixels.clone(), "view_depth": depth, "weather": weather}, [3]))["pixels"]
    torch.testing.assert_close(foggy[2, 5, 8], pixels[2, 5, 8], atol=1, rtol=0)


def test_the_sprite_is_drawn_at_the_target_of_the_task() -> None:
    seen = cameras([0, 3, 2], [3, 3, 6])
    ahead = seen.camera_to_world[:, :3, 3] + 0.3 * seen.camera_to_world[:, :3, 2]
    drawing = SpriteDrawing(renderer(), plain_sprite(), size=0.1)
    view = drawing.draw(Shot(seen, {"target": ahead}))
    assert (view.shown["sprite_share"] > 0.01).all()
    assert (view.pixels != SceneDrawing(renderer()).draw(Shot(seen)).pixels).any()
    swapped = drawing.draw(Shot(seen, {"target": ahead.flip(0)}))
    assert not torch.equal(swapped.pixels, view.pixels)


def test_a_position_in_the_settings_overrides_the_target() -> None:
    seen = cameras([3, 3, 0])
    elsewhere = SpriteDrawing(renderer(), plain_sprite(), size=0.1, position=[0.0, 0.0, -50.0])
    ahead = seen.camera_to_world[:, :3, 3] + 0.3 * seen.camera_to_world[:, :3, 2]
    assert (elsewhere.draw(Shot(seen, {"target": ahead})).shown["sprite_share"] < 0.01).all()


def test_rows_that_are_not_requested_are_not_rendered_and_stay_black() -> None:
    drawing = plain_drawing()
    drawing.renderer = counting = CountingRenderer(renderer())
    seen, only = cameras([3, 3, 0], [3, 3, 0]), torch.tensor([False, True])
    some, every = drawing.draw(Shot(seen, only=only)), plain_drawing().draw(Shot(seen))
    assert counting.rendered == 1
    assert not some.pixels[0].any() and some.shown["sprite_share"][0] == 0
    assert torch.equal(some.pixels[1], every.pixels[1])


def test_a_task_without_a_target_needs_a_position_in_the_settings() -> None:
    env = seeing_env((2,))
    env.drawing = SpriteDrawing(renderer(), plain_sprite())
    with pytest.raises(ValueError, match=r"drawing\.position: expected x, y and z in metres for a task without"):
        env.reset(TensorDict({"state": torch.tensor([[0, 3, 0], [3, 3, 0]])}, [2]), set_state=True)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"size": 0.0}, r"drawing\.size"),
        ({"near": float("nan")}, r"drawing\.near"),
        ({"position": [1.0, 2.0]}, r"drawing\.position"),
        ({"position": [1.0, 2.0, float("inf")]}, r"drawing\.position"),
        ({"sprite": "pear"}, "apple or the path"),
    ],
)
def test_invalid_settings_are_refused_by_name(settings: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SpriteDrawing(**{"renderer": renderer(), "sprite": plain_sprite(), **settings})


def test_the_configs_build_the_drawing() -> None:
    assert isinstance(instantiate(load_config(["transforms/sprite=none"]).drawing)(renderer()), SceneDrawing)
    made = instantiate(load_config(["transforms/sprite=apple", "drawing.size=0.2"]).drawing)(renderer())
    assert isinstance(made, SpriteDrawing) and made.size == 0.2 and made.position is None
