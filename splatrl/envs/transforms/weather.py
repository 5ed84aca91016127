"""Weather and light: fog, dusk, the colour of the sun, rain, snow and drops on the lens."""

import math

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import EnvBase

from splatrl.envs.drawing.depth_drawing import VIEW_DEPTH
from splatrl.envs.transforms.randomness import RandomTransform
from splatrl.envs.transforms.weather_patterns import RAIN, SNOW, lens, pattern
from splatrl.values import require_number

FIELDS = ("fog", "dusk", "red", "green", "blue", "rain", "snow", "wet", "wind", "lens_row", "lens_column")
"""What ``weather`` holds, in its order."""
CLEAR = (0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""The weather that changes nothing."""
LEAST = 0.35
"""Weakest weather of a kind that there is at all, as a share of its strongest."""
SKY = (0.80, 0.83, 0.86)
"""Colour of fog by day, sRGB."""
STREAK, FLAKE = (0.86, 0.89, 0.93), (0.97, 0.97, 0.99)
"""Colours of rain and of snow by day, sRGB."""
NIGHT = (0.86, 0.95, 1.12)
"""Gains of the last light, which is bluer."""
MIST = 0.05
"""Fog that the heaviest rain or snow brings with it, per metre."""
GLOOM = 0.22
"""Share of the light that the heaviest rain takes."""
GAMMA = 2.2


class Weather(RandomTransform):
    """Puts ``pixels`` into weather: one weather for each episode, and rain and snow that fall anew in every step.

    The observation holds what was drawn: ``weather`` [B, 11] float32 is fog (extinction per metre), dusk (share of the
    light that is gone), the gains of red, green and blue, rain, snow and wetness of the lens (0 to 1 each), the wind
    (by how much rain leans), and where on the lens the drops are. A ``weather`` that is given to a reset is kept.

    Each kind is there in some of the episodes, by chance; rain and snow do not come together, and of a given weather
    the stronger of the two falls. In an env whose
    curriculum has several levels, an episode at the first level has ``easy`` of the strength, one at the last has all.

    Colours, from 0 to 1, go through dusk and sun, fog, rain or snow, the lens, and rounding. Fog leaves
    exp(−fog · depth) of the light (Koschmieder's law). It needs the depth of each image: ``view_depth`` of
    ``DepthDrawing``, which is read and taken out of the observation. What comes without, from a replay buffer, has no
    fog, and nothing hides the rain.

    Args:
        fog: strongest, extinction per metre.
        dusk: darkest, share of the light that is gone, below 1.
        sun: largest change of red, up or down, with blue in the opposite direction, in [0, 1].
        rain: heaviest, in [0, 1]; 0 is off.
        snow: heaviest, in [0, 1]; 0 is off.
        wet: wettest lens, in [0, 1]; 0 is off.
        often: share of the episodes that have each kind.
        easy: share of the strength at the first level of a curriculum.
        seed: seed of its own generator (``RandomTransform``).

    Raises:
        ValueError: for values outside these ranges, or an env whose drawing shows no depth.
    """

    most: Tensor  # [6] float32: fog, dusk, sun, rain, snow, wet
    night: Tensor  # [3] float32
    sky: Tensor  # [3] float32, and so are the next two
    streak: Tensor
    flake: Tensor

    def __init__(
        self,
        fog: float = 0.35,
        dusk: float = 0.85,
        sun: float = 0.25,
        rain: float = 1.0,
        snow: float = 1.0,
        wet: float = 1.0,
        often: float = 0.5,
        easy: float = 0.2,
        seed: int = 0,
    ):
        super().__init__(seed, in_keys=["pixels"], out_keys=["pixels", "weather"])
        most = {"fog": fog, "dusk": dusk, "sun": sun, "rain": rain, "snow": snow, "wet": wet}
        limits = {"fog": 100.0, "dusk": 0.99}
        for name, value in {**most, "often": often, "easy": easy}.items():
            require_number(f"appearance.{name}", value, 0, limits.get(name, 1.0))
        self.often, self.easy = often, easy
        self.falls = (rain > 0, snow > 0, wet > 0)
        self.register_buffer("most", torch.tensor(list(most.values()), dtype=torch.float32), persistent=False)
        for name, color in (("night", NIGHT), ("sky", SKY), ("streak", STREAK), ("flake", FLAKE)):
            self.register_buffer(name, torch.tensor(color), persistent=False)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        level = tensordict_reset.get("level", None)
        drawn = self._draw(tensordict_reset.batch_size, level)  # always drawn: later draws do not depend on it
        given = tensordict.get("weather", None)
        tensordict_reset.set("weather", drawn if given is None else given.clone())
        changed = self._change(tensordict_reset.clone(recurse=False))
        mask = tensordict.get("_reset", None)
        if mask is None:
            return changed
        rows = mask.reshape(-1, *[1] * 3)  # TorchRL keeps the old pixels of rows that are not reset
        return changed.set("pixels", torch.where(rows, changed["pixels"], tensordict_reset["pixels"]))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._change(next_tensordict.set("weather", tensordict["weather"].clone()))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Change images that do not come from an env."""
        if "weather" not in tensordict.keys():  # noqa: SIM118, a TensorDict is no dict
            tensordict.set("weather", self._draw(tensordict["pixels"].shape[:-3], tensordict.get("level", None)))
        return self._change(tensordict)

    def _draw(self, batch: torch.Size, level: Tensor | None) -> Tensor:
        """Random weathers: [*batch, 11]."""
        uniform = torch.rand(3, *batch, 6, generator=self.generator, device=self.most.device)
        chance, strength, more = uniform.unbind(0)
        there = (chance < self.often).float()
        there[..., 4] *= (more[..., 4] < 0.5) | (there[..., 3] == 0) if self.falls[0] else 1.0
        there[..., 3] *= there[..., 4] == 0 if self.falls[1] else 1.0
        drawn = there * (LEAST + (1 - LEAST) * strength) * self.most * self._share(level)
        warm = drawn[..., 2:3] * torch.where(more[..., 2:3] < 0.5, -1.0, 1.0)
        gains = torch.cat([1 + warm, 1 + 0.15 * warm, 1 - warm], -1)
        wind = 0.7 * (more[..., 5:6] - 0.5)
        return torch.cat([drawn[..., :2], gains, drawn[..., 3:], wind, more[..., :2]], -1)

    def _share(self, level: Tensor | None) -> Tensor | float:
        """Share of the strength at the level of each episode: [*batch, 1]."""
        curriculum = getattr(self.env, "curriculum", None) if isinstance(self.env, EnvBase) else None
        levels = 1 if curriculum is None else curriculum.starts.levels
        if level is None or levels < 2:
            return 1.0
        return self.easy + (1 - self.easy) * (level / (levels - 1)).clamp(0, 1)

    def _change(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Put images into their weather, and take their depth out."""
        pixels, weather = tensordict["pixels"], tensordict["weather"]
        height, width = pixels.shape[-3:-1]
        count = math.prod(pixels.shape[:-3])
        depth = tensordict.get(VIEW_DEPTH, None)
        far = None if depth is None else depth.reshape(count, height, width)
        given = weather.reshape(count, len(FIELDS), 1, 1).unbind(1)
        fog, dusk, *gains, rain, snow, wet, wind, down, along = (value.unsqueeze(-1) for value in given)
        clouds = 1 - GLOOM * rain
        tint = torch.cat(gains, -1)
        light = ((1 - dusk) * clouds) ** (1 / GAMMA)
        tint = tint * light * (1 + dusk * (self.night - 1))  # [B, 1, 1, 3]
        colors = pixels.reshape(count, height, width, 3).float() / 255 * tint
        if far is not None:
            left = torch.exp(-(fog + MIST * (rain + snow)) * far.unsqueeze(-1))
            left = torch.where(fog + rain + snow > 0, left, 1.0)  # where nothing is seen, the depth is infinite
            colors = colors * left + (1 - left) * self.sky * tint
        if self.falls[0] or self.falls[1]:
            snows = snow > rain
            cover = self._fallen(torch.maximum(rain, snow), torch.where(snows, 0.0, wind), snows, far, (height, width))
            color = torch.where(snows, self.flake, self.streak)
            colors = colors + cover.unsqueeze(-1) * (color * tint - colors)
        if self.falls[2]:
            colors = self._through_drops(colors, wet, down, along)
        changed = (255 * colors + 0.5).floor().clamp(0, 255).to(torch.uint8)
        tensordict.set("pixels", changed.view(pixels.shape))
        return tensordict if depth is None else tensordict.exclude(VIEW_DEPTH, inplace=True)

    def _fallen(
        self, strength: Tensor, wind: Tensor, snows: Tensor, far: Tensor | None, size: tuple[int, int]
    ) -> Tensor:
        """Share of each pixel that rain or snow covers in this step: [B, H, W]."""
        (height, width), count, device = size, len(strength), strength.device
        falling = pattern((*RAIN, *SNOW), height, width, device)
        _, tall, wide = falling.cover.shape
        y, x = torch.arange(height, device=device), torch.arange(width, device=device)
        lean = (wind.reshape(count, 1) * y).round().long()  # [B, H]
        clear = torch.ones(count, height, width, device=device)
        for near in range(len(RAIN)):
            layer = near + len(RAIN) * snows.reshape(count, 1).long()  # [B, 1]
            offset = torch.rand(count, 2, generator=self.generator, device=device)
            rows = ((offset[:, :1] * tall).long() + y) % tall + layer * tall  # [B, H]
            columns = ((offset[:, 1:] * wide).long() - lean).unsqueeze(-1) + x  # [B, H, W]
            texel = (rows.unsqueeze(-1) * wide + columns % wide).flatten()
            cover, rank = (
                texels.flatten().index_select(0, texel).view(clear.shape) for texels in (falling.cover, falling.rank)
            )
            seen = rank < strength.reshape(count, 1, 1)
            if far is not None:
                seen &= far > falling.distance[layer].unsqueeze(-1)
            clear = clear * (1 - cover * seen)
        return 1 - clear

    @staticmethod
    def _through_drops(colors: Tensor, wet: Tensor, down: Tensor, along: Tensor) -> Tensor:
        """Images through a wet lens: [B, H, W, 3]."""
        count, height, width, _ = colors.shape
        drops = lens(height, width, colors.device)
        tall, wide = drops.cover.shape
        y, x = torch.arange(height, device=colors.device), torch.arange(width, device=colors.device)
        rows = ((down.reshape(count, 1) * tall).long() + y) % tall
        columns = ((along.reshape(count, 1) * wide).long() + x) % wide
        texel = (rows[:, :, None] * wide + columns[:, None, :]).flatten()  # [B H W]

        def of(texels: Tensor) -> Tensor:
            return texels.flatten().index_select(0, texel).view(count, height, width)

        cover = (of(drops.cover) * (of(drops.rank) < wet.reshape(count, 1, 1))).unsqueeze(-1)
        source_row = (y[:, None] + of(drops.shift[..., 0])).clamp(0, height - 1)
        source = source_row * width + (x + of(drops.shift[..., 1])).clamp(0, width - 1)
        first = torch.arange(count, device=colors.device).view(count, 1, 1) * (height * width)
        bent = colors.view(-1, 3).index_select(0, (first + source).flatten()).view(colors.shape)
        bent = bent + of(drops.shine).unsqueeze(-1) * (0.25 + bent.mean(-1, keepdim=True))
        return colors + cover * (bent - colors)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add ``weather`` to the observation, and take the depth out."""
        if isinstance(self.env, EnvBase) and VIEW_DEPTH not in observation_spec.keys():  # noqa: SIM118
            raise ValueError(
                f"weather: expected a drawing that shows {VIEW_DEPTH} (around_drawing: DepthDrawing), got none"
            )
        spec = self._with_weather(observation_spec)
        if VIEW_DEPTH in spec.keys():  # noqa: SIM118
            del spec[VIEW_DEPTH]
        return spec

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Read ``weather`` from the input of a step or a reset."""
        return self._with_weather(state_spec)

    @staticmethod
    def _with_weather(spec: Composite) -> Composite:
        spec = spec.clone()
        spec["weather"] = Unbounded(shape=(*spec.shape, len(FIELDS)), dtype=torch.float32, device=spec.device)
        return spec
