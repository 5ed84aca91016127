"""The apple task: find an object that is placed in the scene as a sprite."""

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from splatrl.envs.drawing.base import Drawing
from splatrl.envs.drawing.sprite import Sprite
from splatrl.envs.drawing.sprite_drawing import SpriteDrawing
from splatrl.envs.robot import Robot
from splatrl.envs.tasks.base import NOTHING, Anywhere, Mark, Memory, Outcome, Step, Verdict
from splatrl.envs.tasks.rewards import PUBLISHED, OutcomeTask, Rewards
from splatrl.geometry import azimuths
from splatrl.motions import ForwardMotion
from splatrl.values import are_numbers

BRIGHT, PURE = 102, 1.6
"""A pixel is clearly red if R ≥ 0.4 (102 of 255) and R is at least 1.6 times G and 1.6 times B."""
NEAREST = 0.5
"""Distance to which a robot can be sure to approach an object, in steps."""
COVER = "sprite_share"
"""Key of what ``SpriteDrawing`` returns about each view: the fraction of it that the sprite covers."""


class Apple(OutcomeTask):
    """Walk up to an apple until it fills the view.

    Experiment III of "Robotic Learning in your Backyard". The apple is a sprite at a fixed position, which the env's
    drawing composites into the image (``SpriteDrawing``); that image decides whether the apple is seen.

    Observation: ``pixels`` [B, H, W, 3] uint8, the ego view with the apple in it.
    Action: [B] int64, one of forward, back, left, right (``ForwardMotion``).
    Reward: [B, 1] float32; −0.2 per step, replaced by +50 at the goal, −10 on a collision, −10 out of bounds.
    Termination: collision, out of bounds, or goal: within ``reach`` steps of the apple, with enough of it in view.
    Truncation: after ``max_steps`` steps.
    State: [B, 3] float32, x and y in metres and yaw in radians; ``target`` [B, 3] float32, position of the apple.

    Enough means a minimum fraction of clearly red pixels, so that a red object of the scene itself can be the goal. The
    published test, a mean red channel above 0.55, is already met in a bright room without an apple; ``mean_red``
    selects it. A sprite of any other colour is found by what it covers (``sprite_share``). Collision is off by default,
    as published.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=apple"], batch_size=[4])
        >>> env.rollout(3, break_when_any_done=False)["target"].shape
        torch.Size([4, 3, 3])

    Args:
        motion: how the robots move.
        place: position of the apple, world, metres.
        reach: maximum distance along the ground at which the apple counts as found, steps.
        red_share: minimum fraction of pixels that must be clearly red, in (0, 1].
        mean_red: threshold on the mean red channel, in (0, 1], used in place of ``red_share`` if given.
        sprite_share: minimum fraction of the view that the sprite must cover, in (0, 1], used in place of ``red_share``
            if given.
        facing_deg: used only in planning, which has no image: the apple counts as seen if its bearing is at most this
            far from the centre of the view, degrees.
        rewards: reward of each outcome.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a place that is not three finite numbers, a threshold out of range, or both ``mean_red`` and
            ``sprite_share``.
    """

    motion: ForwardMotion
    place: Tensor  # [3] float32; with several scenes [S, 3]
    of_scene = ("place",)
    landmark = "landmarks.object"

    def __init__(
        self,
        motion: ForwardMotion,
        place: Sequence[float],
        reach: float = 1.1,
        red_share: float = 0.3,
        mean_red: float | None = None,
        sprite_share: float | None = None,
        facing_deg: float = 20.0,
        rewards: Rewards = PUBLISHED,
        max_steps: int = 200,
    ):
        super().__init__(motion, rewards, max_steps)
        if not are_numbers(place, 3):
            raise ValueError(f"task.place: expected x, y and z in metres, got {place}")
        for name, value in (("red_share", red_share), ("mean_red", mean_red), (COVER, sprite_share)):
            if value is not None and not 0 < value <= 1:
                raise ValueError(f"task.{name}: expected a fraction in (0, 1], got {value}")
        if mean_red is not None and sprite_share is not None:
            raise ValueError(f"task.{COVER}: expected null beside task.mean_red={mean_red}, got {sprite_share}")
        self.reach, self.red_share = reach * motion.step, red_share
        self.mean_red, self.sprite_share = mean_red, sprite_share
        self.facing = math.radians(facing_deg)
        self.register_buffer("place", torch.tensor(tuple(place), dtype=torch.float32), persistent=False)

    def check_picture(self, drawing: Drawing, robot: Robot) -> None:
        """Refuse an apple that can never fill the required fraction of the view; see ``Task``.

        What the sprite covers is a mean of its opacity, so it never exceeds the opacity of the most opaque texel.
        """
        if self.sprite_share is not None and COVER not in drawing.specs:
            raise ValueError(f"task.{COVER}: expected a sprite, as transforms/sprite=apple draws, got none")
        if not isinstance(drawing, SpriteDrawing) or self.mean_red is not None:
            return
        counted, least, texels = self._counted(drawing.sprite)
        part, most = float(texels.mean()), float(texels.max())
        if most == 0:
            way_out = (
                f"; task.{COVER}={self.red_share:g} finds a sprite of any colour" if self.sprite_share is None else ""
            )
            raise ValueError(f"drawing.sprite: expected a picture with {counted} in it, got one without{way_out}")
        if most < least:
            raise ValueError(
                f"drawing.sprite: expected a picture that is at least {least:.0%} opaque somewhere, as "
                f"task.{COVER}={least:g} needs, got one of at most {most:.0%}"
            )
        across = 2 * NEAREST * self.motion.step * math.tan(math.radians(robot.fov_deg) / 2)  # seen from there, metres
        down = across * robot.image_height / robot.image_width
        needed = math.sqrt(least * across * down / (part * drawing.sprite.aspect))
        if drawing.size < needed:
            raise ValueError(
                f"drawing.size: expected at least {needed:.2g} m, so that {counted} fills {least:.0%} of the view "
                f"of a robot that gets no closer than half of task.motion.step={self.motion.step:g}, "
                f"got {drawing.size:g}"
            )

    def _counted(self, sprite: Sprite) -> tuple[str, float, Tensor]:
        """Return what counts in words, the fraction of the view that it must fill, and how much each texel counts."""
        texels = sprite.finest
        if self.sprite_share is not None:
            return "something opaque", self.sprite_share, texels[:, 3]
        return "red", self.red_share, _clearly_red(texels[:, :3]).float()

    @property
    def memory_spec(self) -> dict[str, TensorSpec]:
        """Spec of ``target`` [3] float32, position of the apple, world, metres."""
        return {"target": Unbounded(shape=(3,), dtype=torch.float32)}

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        """Place the apple at ``place``; see ``Task.begin``."""
        return {"target": self.place.expand(len(state), 3).clone()}

    def reached(self, state: Tensor) -> Tensor:
        """Return whether robots are near the apple and face it; planning has no image to use: [B, 3] -> [B] bool."""
        planar = self.motion.planar(state)
        away = self.place[..., :2].double() - planar[:, :2]
        bearing = azimuths(away) - planar[:, 2]
        faces = torch.cos(bearing) >= math.cos(self.facing) - 1e-6
        return self._near(state, self.place) & faces

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge a step by the robot's position and its view; see ``Task.judge``."""
        outcome = self._outcome(
            step, self.seen(step.move.state, step.memory["target"], step.pixels, step.shown)
        ).unsqueeze(1)
        return Verdict(self.outcome_rewards[outcome], outcome != Outcome.RUNNING, outcome, step.memory)

    def seen(self, state: Tensor, target: Tensor, pixels: Tensor, shown: Mapping[str, Tensor] = NOTHING) -> Tensor:
        """Return whether robots are near the apple and see enough of it.

        Args:
            state: [B, 3] states of the motion.
            target: [B, 3] position of the apple, world, metres.
            pixels: [B, H, W, 3] uint8, views that include the apple.
            shown: what the drawing returned about the views, by key; ``sprite_share`` [B, 1] is needed if it counts.

        Returns:
            [B] bool.
        """
        if self.sprite_share is not None:
            return self._near(state, target) & (shown[COVER].squeeze(1) >= self.sprite_share)
        return self._near(state, target) & self._red(pixels)

    def marks(self, memory: Memory | None = None) -> list[Mark]:
        """Return a mark at the apple's position; see ``Task.marks``."""
        x, y, _ = (self.place if memory is None else memory["target"]).tolist()
        return [Mark("object", torch.tensor([x, y, math.nan], dtype=torch.float64))]

    def _near(self, state: Tensor, target: Tensor) -> Tensor:
        away = self.motion.planar(state)[:, :2] - target[..., :2]
        return away.norm(dim=1) <= self.reach * (1 + 1e-4)

    def _red(self, pixels: Tensor) -> Tensor:
        """Return whether images are red enough: [B, H, W, 3] uint8 -> [B] bool."""
        colors = pixels.flatten(1, 2).float()
        if self.mean_red is not None:
            return colors[..., 0].mean(1) > 255 * self.mean_red
        return _clearly_red(colors).float().mean(1) >= self.red_share


def _clearly_red(colors: Tensor) -> Tensor:
    """Return which colours are clearly red: [..., 3] float32 in [0, 255] -> [...] bool."""
    red, green, blue = colors.unbind(-1)
    return (red >= BRIGHT) & (red >= PURE * green) & (red >= PURE * blue)
