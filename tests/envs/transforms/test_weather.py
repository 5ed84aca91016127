"""Weather and light, kind by kind, and in an env."""

import math
from pathlib import Path

import pytest
import torch
from hydra.utils import instantiate
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import EnvBase, TransformedEnv

from splatrl.building import make_env
from splatrl.configuration import load_config
from splatrl.curriculum import Curriculum
from splatrl.envs import SplatEnv
from splatrl.envs.drawing import DepthDrawing, SceneDrawing
from splatrl.envs.drawing.depth_drawing import VIEW_DEPTH
from splatrl.envs.transforms import Weather, weather_images
from splatrl.envs.transforms.weather import CLEAR, FIELDS
from splatrl.envs.transforms.weather_images import SKY
from splatrl.envs.transforms.weather_patterns import RAIN, SNOW, lens, pattern
from splatrl.native import _core
from tests.envs.contract import seeded_rollout
from tests.envs.transforms.test_contract import TransformedContract
from tests.envs.transforms.views import plain_drawing, renderer, seeing_env
from tests.tiny import BlockChecker, tiny_overrides, tiny_plan, tiny_robot, tiny_task

HEIGHT, WIDTH = 24, 32


def weathers(*kinds: dict[str, float]) -> Tensor:
    """Return weathers that are clear except for the given fields: [B, 11]."""
    return torch.tensor([[kind.get(name, clear) for name, clear in zip(FIELDS, CLEAR, strict=True)] for kind in kinds])


def seen(images: Tensor, depth: Tensor | None = None, seed: int = 0, **kind: float) -> Tensor:
    """Return images in the given weather."""
    td = TensorDict({"pixels": images, "weather": weathers(kind).expand(len(images), -1)}, [len(images)])
    if depth is not None:
        td.set(VIEW_DEPTH, depth)
    return Weather(seed=seed)(td)["pixels"]


def pictures(count: int = 2) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.randint(0, 256, (count, HEIGHT, WIDTH, 3), dtype=torch.uint8, generator=generator)


def grey(value: int = 100, count: int = 1) -> Tensor:
    return torch.full((count, HEIGHT, WIDTH, 3), value, dtype=torch.uint8)


def weather_env(
    batch_size: tuple[int, ...] = (3,), seed: int = 0, first: int | None = None, **strength: float
) -> EnvBase:
    """Make an env of robots in the tiny room, in weather."""
    robot = tiny_robot()
    drawing = DepthDrawing(SceneDrawing(renderer()), robot.image_height, robot.image_width)
    curriculum = Curriculum(tiny_plan(), first)
    env = SplatEnv(drawing, BlockChecker(), robot, tiny_task(max_steps=8), curriculum, batch_size, seed)
    return TransformedEnv(env, Weather(**strength))


class TestWeatherContract(TransformedContract):
    """An observation depends on ``weather`` and on where the rain falls in a step."""

    def make(self, batch_size: tuple[int], seed: int = 0) -> EnvBase:
        return weather_env(batch_size, seed)

    def test_an_episode_can_begin_at_a_given_state(self) -> None:
        env = weather_env((3,), rain=0.0, snow=0.0)
        given = env.reset().select("state", "pixels", "weather").clone()
        env.rollout(4, break_when_any_done=False)
        again = env.reset(given.select("state", "weather"), set_state=True)
        for key in ("state", "pixels", "weather"):
            assert torch.equal(again[key], given[key]), key

    def test_a_robot_does_not_depend_on_the_others(self) -> None:
        """The random draws of a robot do depend on the others, so they are given."""
        batch, alone = (weather_env((count,), rain=0.0, snow=0.0) for count in (5, 1))
        together = batch.reset()
        for row in range(5):
            start = alone.reset(together[row : row + 1].select("state", "weather"), set_state=True)
            assert torch.equal(start["pixels"], together["pixels"][row : row + 1])


def test_clear_weather_changes_no_byte_and_removes_the_depth() -> None:
    images = pictures()
    td = TensorDict(
        {"pixels": images, "weather": weathers({}, {}), VIEW_DEPTH: torch.full((2, HEIGHT, WIDTH), 3.0)}, [2]
    )
    changed = Weather()(td)
    assert torch.equal(changed["pixels"], images) and VIEW_DEPTH not in changed.keys()  # noqa: SIM118


def test_an_env_with_all_weather_switched_off_changes_no_byte() -> None:
    env, clean = weather_env(fog=0.0, dusk=0.0, sun=0.0, rain=0.0, snow=0.0, wet=0.0), seeing_env()
    left = seeded_rollout(env, 6, 0)
    assert (left["weather"][..., :8] == torch.tensor(CLEAR[:8])).all()
    assert torch.equal(left["pixels"][:, 3], clean.reset(left[:, 3].select("state"), set_state=True)["pixels"])


def test_fog_follows_koschmieders_law_and_hides_what_is_infinitely_far() -> None:
    depth = torch.full((1, HEIGHT, WIDTH), 2.0)
    depth[0, :5] = math.inf
    foggy = seen(grey(100), depth, fog=0.3)
    left = math.exp(-0.6)
    for channel, sky in enumerate(SKY):
        assert foggy[0, 10, 10, channel].item() == math.floor(100 * left + 255 * sky * (1 - left) + 0.5)
        assert foggy[0, 0, 0, channel].item() == math.floor(255 * sky + 0.5)


def test_without_depth_there_is_no_fog() -> None:
    images = pictures()
    assert torch.equal(seen(images, fog=0.3), images)


def test_dusk_is_dark_and_blue_and_the_sun_changes_colours() -> None:
    dark = seen(grey(200), dusk=0.8)[0, 0, 0].tolist()
    assert dark[0] < dark[1] < dark[2] < 120
    assert seen(grey(100), red=1.2, blue=0.8)[0, 3, 3].tolist() == [120, 100, 80]


@pytest.mark.parametrize("kind", ["rain", "snow"])
def test_rain_and_snow_brighten_some_pixels_vary_every_time_and_are_hidden_by_near_surfaces(kind: str) -> None:
    far, near = torch.full((1, HEIGHT, WIDTH), 9.0), torch.full((1, HEIGHT, WIDTH), 0.3)
    lone = grey(20)
    without = seen(lone, near, **{kind: 1.0})
    assert (without == without[0, 0, 0]).all()  # only mist and gloom
    some = seen(lone, far, **{kind: 1.0}).float()
    assert 0.03 < (some.amax(-1) > some.amin() + 8).float().mean() < 0.7
    assert not torch.equal(some, seen(lone, far, seed=1, **{kind: 1.0}).float())
    light = seen(lone, far, **{kind: 0.4}).float()
    assert (light > light.amin() + 8).sum() < (some > some.amin() + 8).sum()


def test_rain_is_long_and_leans_with_the_wind_and_snow_is_round() -> None:
    def stretch(layers: tuple[object, ...]) -> float:
        """Return how elongated rain or snow is, from its autocorrelation three pixels down and across."""
        cover = pattern(layers, 64, 80, torch.device("cpu")).cover[0]  # type: ignore[arg-type]
        down, across = (((cover - cover.roll(3, axis)) ** 2).mean() for axis in (0, 1))
        return float(across / down)

    assert stretch(RAIN) > 3 and 0.5 < stretch(SNOW) < 2

    def shifted(wind: float) -> Tensor:
        return seen(grey(20), torch.full((1, HEIGHT, WIDTH), 9.0), rain=1.0, wind=wind)[0, ..., 0].float()

    still, blown = shifted(0.0), shifted(0.5)
    row = HEIGHT - 1
    assert torch.equal(still[0], blown[0])
    assert torch.allclose(still[row][: WIDTH - round(0.5 * row)], blown[row][round(0.5 * row) :], atol=1)


def test_a_wet_lens_bends_what_is_behind_its_drops_and_leaves_the_rest() -> None:
    images = pictures(1)
    wet = seen(images, wet=1.0, lens_row=0.3, lens_column=0.1)
    changed = (wet != images).any(-1).float().mean()
    assert 0.03 < changed < 0.6
    assert torch.equal(wet, seen(images, seed=9, wet=1.0, lens_row=0.3, lens_column=0.1))  # drops stay where they are
    assert not torch.equal(wet, seen(images, wet=1.0, lens_row=0.6, lens_column=0.1))
    drops = lens(HEIGHT, WIDTH, torch.device("cpu"))
    assert drops.cover.max() <= 1 and (drops.rank < 1).all() and not drops.shift[drops.cover == 0].any()


def test_each_image_has_its_own_weather() -> None:
    images, depth = pictures(1).expand(2, -1, -1, -1).clone(), torch.full((2, HEIGHT, WIDTH), 2.0)
    kinds = weathers({"fog": 0.2, "wet": 0.7}, {"dusk": 0.5, "red": 1.1})
    off = {"rain": 0.0, "snow": 0.0}
    both = Weather(**off)(TensorDict({"pixels": images, "weather": kinds, VIEW_DEPTH: depth}, [2]))["pixels"]
    for row in range(2):
        one = {"pixels": images[row], "weather": kinds[row], VIEW_DEPTH: depth[row]}
        assert torch.equal(both[row], Weather(**off)(TensorDict(one, []))["pixels"])


def test_light_has_the_same_bytes_in_any_batch() -> None:
    weather = Weather()._draw(torch.Size([67]), None)
    tint = torch.cat([weather_images.light(few, None).tint for few in weather.split(7)])
    assert torch.equal(tint, weather_images.light(weather, None).tint)


def test_drawn_weather_stays_in_its_ranges_and_never_has_rain_and_snow_together() -> None:
    drawn = Weather(fog=0.2, dusk=0.5, sun=0.1, often=0.5)._draw(torch.Size([5000]), None)
    fog, dusk, red, green, blue, rain, snow, wet, wind, down, along = drawn.unbind(-1)
    assert fog.max() <= 0.2 and dusk.max() <= 0.5 and (red - 1).abs().max() <= 0.1 + 1e-6
    assert torch.allclose(red + blue, torch.tensor(2.0)) and (green - 1).abs().max() < 0.02
    assert not ((rain > 0) & (snow > 0)).any() and wind.abs().max() <= 0.35
    for there in (fog > 0, dusk > 0, wet > 0):
        assert there.float().mean() == pytest.approx(0.5, abs=0.03)
    for there in (rain > 0, snow > 0):
        assert there.float().mean() == pytest.approx(0.375, abs=0.03)
    assert down.min() >= 0 and along.max() < 1 and down.std() > 0.2
    alone = Weather(snow=0.0)._draw(torch.Size([5000]), None)
    assert (alone[:, 5] > 0).float().mean() == pytest.approx(0.5, abs=0.03)


def test_weather_is_weaker_at_the_first_level_of_a_curriculum_and_full_at_the_last() -> None:
    env = weather_env((400,), first=2, easy=0.1, often=1.0, fog=0.5)
    assert isinstance(env, TransformedEnv)
    weather = env.transform[-1] if hasattr(env.transform, "__getitem__") else env.transform
    last = env.base_env.curriculum.starts.levels - 1
    assert last > 0
    fog = env.reset()["weather"][:, 0]
    assert 0 < fog.max() <= 0.05 + 1e-6
    full = weather._draw(torch.Size([400]), torch.full((400, 1), last))[:, 0]
    assert 0.45 < full.max() <= 0.5
    assert weather_env((400,), often=1.0, fog=0.5).reset()["weather"][:, 0].max() > 0.45  # one level: full strength


def test_given_states_have_weather_of_full_strength() -> None:
    env = weather_env((400,), often=1.0, fog=0.5, easy=0.1, first=2)
    begun = env.reset()
    assert begun["weather"][:, 0].max() < 0.1
    assert env.reset(begun.select("state"), set_state=True)["weather"][:, 0].max() > 0.45


def test_an_episode_keeps_its_weather_and_the_next_has_another() -> None:
    batch = seeded_rollout(weather_env((6,)), 12, 0)
    assert torch.equal(batch["next", "weather"], batch["weather"])
    ended = batch["next", "done"][:, :-1, 0]
    before, after = batch["weather"][:, :-1], batch["weather"][:, 1:]
    assert torch.equal(before[~ended], after[~ended]) and ended.any()
    assert (before[ended] != after[ended]).any(-1).all()


def test_every_image_of_a_rollout_shows_its_weather_even_after_partial_resets() -> None:
    off = {"rain": 0.0, "snow": 0.0, "often": 1.0}
    batch, other = seeded_rollout(weather_env((4,), **off), 12, 0), weather_env((4,), seed=5, **off)
    ended = batch["next", "done"][:, :, 0]
    assert (ended.any(0) & ~ended.all(0))[:-1].any()  # resets of some rows, and not of others
    for step in range(12):
        again = other.reset(batch[:, step].select("state", "weather"), set_state=True)
        assert torch.equal(again["pixels"], batch["pixels"][:, step]), step


def test_a_sprite_stands_in_the_weather_too() -> None:
    robot = tiny_robot()
    drawing = DepthDrawing(plain_drawing(), robot.image_height, robot.image_width)
    assert set(drawing.specs) == {"sprite_share", VIEW_DEPTH}
    env = SplatEnv(drawing, BlockChecker(), robot, tiny_task(), Curriculum(tiny_plan(), None), (4,), 0)
    rollout = TransformedEnv(env, Weather(fog=1.0, often=1.0)).rollout(3)
    assert "sprite_share" in rollout and VIEW_DEPTH not in rollout


def test_a_drawing_without_depth_is_refused() -> None:
    with pytest.raises(ValueError, match="view_depth"):
        TransformedEnv(seeing_env(), Weather()).reset()


@pytest.mark.parametrize(
    ("setting", "value"),
    [("fog", -1.0), ("dusk", 1.0), ("rain", 1.5), ("often", 2.0), ("easy", -0.1), ("wet", math.nan)],
)
def test_a_setting_out_of_range_is_refused_by_its_key(setting: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"appearance.{setting}"):
        Weather(**{setting: value})


def test_the_config_sets_up_a_drawing_with_depth_and_works_with_a_sprite(tmp_path: Path) -> None:
    assert isinstance(instantiate(load_config(["transforms/appearance=weather"]).transforms.appearance), Weather)
    for task in ("grid", "apple"):
        env = make_env([*tiny_overrides(tmp_path, task), "transforms/appearance=weather"], batch_size=[2])
        assert VIEW_DEPTH not in env.rollout(2)
    assert "around_drawing" not in load_config()


def test_the_core_draws_the_same_weather_as_pytorch(monkeypatch: pytest.MonkeyPatch) -> None:
    count = 40
    g = torch.Generator().manual_seed(1)
    images = torch.randint(0, 256, (count, HEIGHT, WIDTH, 3), dtype=torch.uint8, generator=g)
    depth = 6 * torch.rand(count, HEIGHT, WIDTH, generator=g)
    depth[:, :4] = math.inf
    made = Weather(often=0.7)
    drawn = made._draw(torch.Size([count]))
    drawn[0, 5:9], drawn[0, 9:] = torch.tensor([1.0, 0.0, 1.0, -0.35]), 0.999999
    drawn[1, 9:] = torch.tensor([-3.7, 8.2])  # as a caller may pass to a reset

    def put(far: Tensor | None) -> Tensor:
        torch.manual_seed(0)
        weather = Weather(often=0.7)
        return weather._changed(images, drawn, far)

    for far in (depth, None):
        by_core = put(far)
        with monkeypatch.context() as patched:
            patched.setattr(weather_images, "in_core", lambda images: False)
            by_torch = put(far)
        apart = (by_core.int() - by_torch.int()).abs()
        assert apart.max() <= 1 and (apart > 0).float().mean() < 1e-3
        assert (by_core != images).any()


def test_the_core_refuses_sizes_that_do_not_match() -> None:
    images, tint = pictures(), torch.ones(2, 3)
    for wrong in (tint[:1], torch.ones(3, 3)):
        with pytest.raises(ValueError, match="weather: expected one row per image"):
            _core.put_into_weather(images, wrong, tint, None, None, None, None, images.clone(), 1)


def test_a_partial_reset_leaves_the_other_rows_unchanged() -> None:
    env = weather_env((4,), often=1.0)
    before = env.reset()
    mask = torch.tensor([[True], [False], [False], [True]])
    calls: list[int] = []
    weather = env.transform[-1] if hasattr(env.transform, "__getitem__") else env.transform
    changed = weather._changed
    weather._changed = lambda images, look, depth: (calls.append(len(images)), changed(images, look, depth))[1]
    after = env.reset(before.clone().set("_reset", mask))
    assert calls == [2]
    assert torch.equal(after["pixels"][1:3], before["pixels"][1:3])
