"""Randomised weather and light: fog, dusk, colour of the sun, rain, snow and drops on the lens."""

import torch
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import EnvBase

from splatrl.envs.drawing.depth_drawing import VIEW_DEPTH
from splatrl.envs.transforms.episode_look import EpisodeLook
from splatrl.envs.transforms.weather_images import LAYERS, Wet, falling, light, put_into
from splatrl.values import require_number

FIELDS = ("fog", "dusk", "red", "green", "blue", "rain", "snow", "wet", "wind", "lens_row", "lens_column")
"""Fields of ``weather``, in order."""
CLEAR = (0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""The weather that leaves images unchanged."""
LEAST = 0.35
"""Minimum strength of any weather that occurs, as a fraction of its maximum."""


class Weather(EpisodeLook):
    """Applies weather to ``pixels``: one weather per episode, with rain and snow placed anew in every step.

    The values drawn are part of the observation: ``weather`` [B, 11] float32 holds fog (extinction per metre), dusk
    (fraction of the light that is lost), the gains of red, green and blue, rain, snow and wetness of the lens (0 to 1
    each), wind (slant of the rain, columns per row), and the position of the drop pattern on the lens. A ``weather``
    given to a reset is kept.

    Each kind of weather occurs at random in some of the episodes. Rain and snow never occur together; if a given
    weather has both, the stronger one is shown. In an env whose curriculum has several levels, the strength rises from
    the fraction ``easy`` at the first level to its full value at the last, which given states have too.

    Colours, from 0 to 1, pass through dusk and sun, fog, rain or snow, the lens, and rounding. Fog leaves the fraction
    exp(−fog · depth) of the light (Koschmieder's law). It needs the depth of each image: ``view_depth`` of
    ``DepthDrawing``, which is read and then removed from the observation. Images without depth, from a replay buffer,
    get no fog, and nothing occludes their rain.

    Args:
        fog: maximum fog, extinction per metre.
        dusk: maximum fraction of the light that is lost, below 1.
        sun: maximum change of the red gain, up or down, with blue changing in the opposite direction, in [0, 1].
        rain: maximum rain, in [0, 1]; 0 disables it.
        snow: maximum snow, in [0, 1]; 0 disables it.
        wet: maximum wetness of the lens, in [0, 1]; 0 disables it.
        often: probability that an episode has each kind; if rain and snow coincide, one of them is dropped.
        easy: fraction of the strength at the first level of a curriculum.
        seed: seed of the transform's own generator (``RandomTransform``).

    Raises:
        ValueError: for values outside these ranges, or an env whose drawing does not return depth.
    """

    KEY = "weather"
    SIZE = len(FIELDS)
    DEPTH = VIEW_DEPTH
    most: Tensor  # [6] float32: fog, dusk, sun, rain, snow, wet

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
        super().__init__(seed)
        most = {"fog": fog, "dusk": dusk, "sun": sun, "rain": rain, "snow": snow, "wet": wet}
        limits = {"fog": 100.0, "dusk": 0.99}
        for name, value in {**most, "often": often, "easy": easy}.items():
            require_number(f"appearance.{name}", value, 0, limits.get(name, 1.0))
        self.often, self.easy = often, easy
        self.falls = (rain > 0, snow > 0, wet > 0)
        self.register_buffer("most", torch.tensor(list(most.values()), dtype=torch.float32), persistent=False)

    def _draw(self, batch: torch.Size, level: Tensor | None = None) -> Tensor:
        """Draw random weathers: [*batch, 11]."""
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
        """Return the fraction of the strength at the level of each episode: [*batch, 1]."""
        curriculum = getattr(self.env, "curriculum", None) if isinstance(self.env, EnvBase) else None
        levels = 1 if curriculum is None else curriculum.starts.levels
        if level is None or levels < 2:
            return 1.0
        level = torch.where(level < 0, levels - 1, level)  # given states belong to no level
        return self.easy + (1 - self.easy) * (level / (levels - 1)).clamp(0, 1)

    def _changed(self, images: Tensor, look: Tensor, depth: Tensor | None) -> Tensor:
        seen, things, drops = light(look, depth), None, None
        if self.falls[0] or self.falls[1]:
            begin = torch.rand(len(images), LAYERS, 2, generator=self.generator, device=images.device)
            things = falling(look, seen.tint, begin)
        if self.falls[2]:
            drops = Wet(look[:, 7], look[:, 9:])
        return put_into(images, seen, depth, things, drops)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add ``weather`` to the observation, and remove the depth."""
        if isinstance(self.env, EnvBase) and VIEW_DEPTH not in observation_spec.keys():  # noqa: SIM118
            raise ValueError(
                f"weather: expected a drawing that provides {VIEW_DEPTH} (around_drawing: DepthDrawing), got none"
            )
        spec = super().transform_observation_spec(observation_spec)
        if VIEW_DEPTH in spec.keys():  # noqa: SIM118
            del spec[VIEW_DEPTH]
        return spec
