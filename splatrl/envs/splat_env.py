"""The one environment: a batch of robots in one scene."""

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Categorical, Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase

from splatrl.collision.base import Checker
from splatrl.collision.nothing import NoChecker
from splatrl.curriculum.starts import Curriculum
from splatrl.envs.robot import Robot
from splatrl.envs.tasks.base import Outcome, SeenGoal, Task
from splatrl.faults import Faulty
from splatrl.renderers.base import Renderer, to_pixels

HAZE = 0.5
"""A pixel that Gaussians cover less than this shows what is behind them, and has no depth."""


class SplatEnv(EnvBase):
    """B robots that see, move and collide in one splat scene: a batch-locked TorchRL env.

    Everything about an episode travels in the TensorDict, so the env itself holds only its random generator and the
    curriculum, both part of ``state_dict()``.

    A step reads no tensor on the host, and neither does a reset by mask, as on a GPU: it draws start states for all
    rows, of which TorchRL takes those that were asked for, and the renderer is told which to draw. On a CPU the rows
    are looked up, so that nothing is drawn in vain.

    Observation: ``pixels`` [B, H, W, 3] uint8. For users, not for the policy: ``state`` (the task's), ``step_count``
        [B, 1] int64, ``episode_return`` [B, 1] float32, ``level`` [B, 1] int64 at which the episode began, ``outcome``
        [B, 1] int64 (an ``Outcome``), ``touched_fraction`` [B, 1] float32 (how much of the last move was free; 1 when
        nothing was touched). With ``depth`` also ``depth`` [B, H, W] float32, metres along the optical axis (0 where
        there is nothing but haze), and ``camera_to_world`` [B, 4, 4] float32 of the camera that took the pixels. With a
        task whose goal is an object, ``target`` [B, 3] float32, its place in the world, metres.
    Action: the task's.
    Reward: [B, 1] float32, the task's.
        A goal that must be seen is granted by the ``ImageGoal`` transform, which then also tells the curriculum.
    Termination: the task's. A blocked move leaves the robot where it was.
    Truncation: after ``task.max_steps`` steps; never together with termination.
    Reset: start states from the curriculum, or with ``reset(td, set_state=True)`` those in ``td["state"]``.
    Input: ``camera_offset`` [B, 6] float32, if present, moves the camera and not the robot (``Robot.cameras``).

    Args:
        renderer: makes the pixels.
        checker: holds the robot's body, finds what it touches.
        robot: body and camera.
        task: motion, goal and rewards.
        curriculum: where episodes begin.
        batch_size: [B], the number of robots.
        seed: of the env's generator.
        device: of every tensor that it takes and gives.
        depth: whether to observe depth and the camera's pose beside the pixels, as ``SpriteOverlay`` needs them.
        reset_by_mask: whether resets of some rows go by mask; None does so anywhere but on a CPU.

    Raises:
        ValueError: for a batch size that is not one positive number, or a given state that the task does not have.
    """

    batch_locked = True
    _supports_set_state = True

    def __init__(
        self,
        renderer: Renderer,
        checker: Checker,
        robot: Robot,
        task: Task,
        curriculum: Curriculum,
        batch_size: Sequence[int],
        seed: int | None = 0,
        device: torch.device | str = "cpu",
        depth: bool = False,
        reset_by_mask: bool | None = None,
    ):
        if len(batch_size) != 1 or batch_size[0] < 1:
            raise ValueError(f"batch_size: expected one number of at least 1, got {list(batch_size)}")
        super().__init__(device=device, batch_size=torch.Size(batch_size))
        self.renderer, self.checker, self.robot = renderer, checker, robot
        self.task, self.curriculum, self.depth = task, curriculum, depth
        self.reset_by_mask = reset_by_mask
        self.generator = torch.Generator(self.device)
        self._make_specs()
        torch.nn.Module.to(self, self.device)  # EnvBase.to does nothing for the device that it already has
        self.set_seed(seed)

    @property
    def seen_goal(self) -> SeenGoal | None:
        """The task, if its goal is an object that must be seen."""
        return self.task if isinstance(self.task, SeenGoal) else None

    @property
    def resets_by_mask(self) -> bool:
        """Whether resets of some rows go by mask."""
        return self.device.type != "cpu" if self.reset_by_mask is None else self.reset_by_mask

    @property
    def capturable(self) -> bool:
        """Whether a step can be captured in a CUDA graph: what notes its faults on the device asks the host nothing."""
        return isinstance(self.renderer, Faulty) and isinstance(self.checker, (Faulty, NoChecker))

    def to(self, device: torch.device | str) -> "SplatEnv":
        """Move to a device: task, curriculum, and renderer and checker where they have ``to``.

        Its generator begins anew there, with the seed that it had.
        """
        super().to(device)
        if self.generator.device != self.device:
            self.generator = torch.Generator(self.device).manual_seed(self.generator.initial_seed())
        for name in ("renderer", "checker"):
            move = getattr(getattr(self, name), "to", None)
            if move is not None:
                setattr(self, name, move(self.device))
        return self

    def raise_faults(self) -> None:
        """Wait for the device, and raise what renderer or checker refused since the last call; see ``Faulty``."""
        for part in (self.renderer, self.checker):
            if isinstance(part, Faulty):
                part.raise_faults()

    def _make_specs(self) -> None:
        motion, robot = self.task.motion, self.robot
        count = Unbounded(shape=(1,), dtype=torch.int64)
        number = Unbounded(shape=(1,), dtype=torch.float32)
        carried: dict[str, TensorSpec] = {
            "state": motion.state_spec,
            "step_count": count,
            "episode_return": number,
            "level": count.clone(),
        }
        if self.seen_goal is not None:
            carried["target"] = Unbounded(shape=(3,), dtype=torch.float32)
        shown: dict[str, TensorSpec] = {
            "pixels": Bounded(0, 255, shape=(robot.image_height, robot.image_width, 3), dtype=torch.uint8),
            "outcome": Categorical(len(Outcome), shape=(1,), dtype=torch.int64),
            "touched_fraction": Bounded(0.0, 1.0, shape=(1,), dtype=torch.float32),
        }
        if self.depth:
            shown["depth"] = Bounded(0.0, torch.inf, shape=(robot.image_height, robot.image_width), dtype=torch.float32)
            shown["camera_to_world"] = Unbounded(shape=(4, 4), dtype=torch.float32)
        flag = Categorical(2, shape=(1,), dtype=torch.bool)
        done = {"done": flag, "terminated": flag.clone(), "truncated": flag.clone()}
        self.observation_spec = self._batched({**shown, **carried})
        self.state_spec = self._batched({key: spec.clone() for key, spec in carried.items()})
        self.action_spec = self._batched({"action": motion.action_spec})
        self.reward_spec = self._batched({"reward": number.clone()})
        self.done_spec = self._batched(done)

    def _batched(self, specs: dict[str, TensorSpec]) -> Composite:
        size = self.batch_size
        specs = {key: spec.expand(*size, *spec.shape) for key, spec in specs.items()}
        return Composite(specs, shape=size).to(self.device)

    def _reset(self, tensordict: TensorDictBase | None = None, *, set_state: bool = False, **_: Any) -> TensorDictBase:
        given = TensorDict(batch_size=self.batch_size) if tensordict is None else tensordict
        mask = given.get("_reset", None)
        if mask is None or (self.resets_by_mask and not set_state):
            begun = self._begun(given, slice(None), self.numel(), None if mask is None else mask.flatten(), set_state)
        else:
            rows = mask.flatten().nonzero().squeeze(1)
            part = self._begun(given, rows, len(rows), None, set_state)
            begun = {key: value.new_zeros(self.numel(), *value.shape[1:]) for key, value in part.items()}
            for key, value in part.items():
                begun[key][rows] = value  # the rest of the batch is TorchRL's to fill in
        count = torch.zeros(self.numel(), 1, dtype=torch.int64, device=self.device)
        values = {
            **begun,
            "step_count": count,
            "episode_return": count.float(),
            "outcome": count.clone(),
            "touched_fraction": torch.ones_like(count, dtype=torch.float32),
            **{key: count.bool() for key in ("done", "terminated", "truncated")},
        }
        return TensorDict(values, batch_size=self.batch_size, device=self.device)

    def _begun(
        self, given: TensorDictBase, rows: slice | Tensor, count: int, only: Tensor | None, set_state: bool
    ) -> dict[str, Tensor]:
        """What episodes of some rows begin with, by key.

        Args:
            given: what the reset was given.
            rows: of the batch.
            count: how many these are.
            only: [count] bool, which of them to render; None renders all.
            set_state: whether to begin at the states in ``given``.
        """
        if set_state:
            state = self._checked_state(given["state"][rows].clone())
            level = torch.full_like(state[:, :1], -1, dtype=torch.int64)  # given by hand: of no level
        else:
            state = self.curriculum.sample(count, self.generator)
            level = self.curriculum.level.expand(count, 1).clone()
        offset = given.get("camera_offset", None)
        poses = self.task.motion.body_to_world(state)
        begun = {"state": state, "level": level}
        begun |= self._views(poses, None if offset is None else offset[rows], only)
        if self.seen_goal is not None:
            target = given.get("target", None) if set_state else None
            begun["target"] = self.fresh_targets(count) if target is None else target[rows].clone()
        return begun

    def _checked_state(self, state: Tensor) -> Tensor:
        """States from outside: a wrong one would otherwise wrap around or end far away."""
        spec = self.task.motion.state_spec.to(state.device)
        if not spec.expand(len(state), *spec.shape).is_in(state):
            wrong = [row for row, one in enumerate(state) if not spec.is_in(one)]
            limits = f" from {spec.low.tolist()} to {spec.high.tolist()}" if isinstance(spec, Bounded) else ""
            got = f"{state.dtype} {state[wrong[0]].tolist()} in row {wrong[0]}"
            raise ValueError(f"state: expected {spec.dtype}{limits}, got {got}")
        return state

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        state, action = tensordict["state"], tensordict["action"]
        motion = self.task.motion
        ahead = motion.advance(state, action)
        start, end = motion.body_to_world(state), motion.body_to_world(ahead)
        touched = self.checker.touched_fraction(start, end)
        hit = touched < 1
        reward, terminated, outcome = self.task.judge(state, action, ahead, hit)
        blocked = hit | ~motion.inside(ahead)
        state = torch.where(blocked.view(-1, *[1] * (state.ndim - 1)), state, ahead)
        poses = torch.where(blocked.view(-1, 1, 1), start, end)
        step_count = tensordict["step_count"] + 1
        truncated = (step_count >= self.task.max_steps) & ~terminated
        outcome = torch.where(truncated, Outcome.TIMEOUT, outcome)
        level, done = tensordict["level"], terminated | truncated
        if self.seen_goal is None:
            self.curriculum.record(level.flatten(), done.flatten(), (outcome == Outcome.GOAL).flatten())
        values = {
            **self._views(poses, tensordict.get("camera_offset", None)),
            "state": state,
            "step_count": step_count,
            "episode_return": tensordict["episode_return"] + reward,
            "level": level.clone(),
            "outcome": outcome,
            "touched_fraction": touched.unsqueeze(1),
            "reward": reward,
            "done": done,
            "terminated": terminated,
            "truncated": truncated,
        }
        if self.seen_goal is not None:
            values["target"] = tensordict["target"].clone()
        return TensorDict(values, batch_size=self.batch_size, device=self.device)

    def _views(
        self, body_to_world: Tensor, camera_offset: Tensor | None, only: Tensor | None = None
    ) -> dict[str, Tensor]:
        """What robots at some poses observe with their cameras, by key; ``only`` as for ``Renderer``."""
        cameras = self.robot.cameras(body_to_world, camera_offset)
        if not self.depth:
            return {"pixels": self.renderer.pixels(cameras, only=only)}
        rgb, depth, alpha = self.renderer.render(cameras, only=only)
        solid = depth.masked_fill(alpha < HAZE, 0.0)
        return {"pixels": to_pixels(rgb), "depth": solid, "camera_to_world": cameras.camera_to_world}

    def fresh_targets(self, count: int) -> Tensor:
        """Draw places for the object of the task: [count, 3] float32, world, metres."""
        assert self.seen_goal is not None
        return self.seen_goal.targets(self.curriculum.anywhere(count, self.generator))

    def _set_seed(self, seed: int | None) -> None:
        if seed is None:
            self.generator.seed()
        else:
            self.generator.manual_seed(seed)

    def get_extra_state(self) -> Tensor:
        """State of the random generator, for ``state_dict()``: [n] uint8."""
        return self.generator.get_state()

    def set_extra_state(self, state: Tensor) -> None:
        """Put the random generator back, from ``load_state_dict()``."""
        self.generator.set_state(state.cpu())
