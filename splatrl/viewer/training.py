"""The page of a training: its progress, and its robots over the scene, replayed from the last batch."""

import math
import threading
import time
from collections.abc import Mapping

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from splatrl.envs.world import World
from splatrl.geometry import rotations_to_quats
from splatrl.training import Trainer
from splatrl.training.collectors import Collector
from splatrl.viewer.page import Page
from splatrl.viewer.robot import BLUE, FACES, wedge

ROBOTS = 256
"""Maximum number of robots shown."""
EVERY = 0.5
"""Minimum seconds between batches that are shown, so that a training with many small batches is not slowed down."""
RATE = 10
"""Playback speed of a batch, steps per second."""
FIGURES = {
    "frames": ",.0f",
    "level": ".0f",
    "success": ".2f",
    "test_success": ".2f",
    "collision": ".2f",
    "return": ".1f",
}
"""Columns of ``progress.csv`` that the page shows, with their formats."""


class WatchedCollector:
    """A collector that passes its robots' states to a view; the collected batches stay unchanged.

    Args:
        collector: the training's collector.
        view: receives states [T, B, ...], either of every step of a batch or only of its end.
    """

    def __init__(self, collector: Collector, view: "TrainingView"):
        self.collector, self.view = collector, view

    @property
    def carried(self) -> TensorDictBase:
        """The TensorDict with which the next batch begins."""
        return self.collector.carried

    @carried.setter
    def carried(self, value: TensorDictBase) -> None:
        self.collector.carried = value

    def collect(self) -> TensorDictBase:
        """Collect the next frames, [B, T]."""
        batch = self.collector.collect()
        if self.view.wants():
            states = batch.get("state", None)
            self.view.see(self.carried["state"].unsqueeze(0) if states is None else states.transpose(0, 1))
        return batch


class TrainingView:
    """Shows a training without affecting it: the view reads copies of states and draws no random numbers.

    Args:
        page: page to add the robots to.
        world: scene and task.
        trainer: the training, before it begins.
    """

    def __init__(self, page: Page, world: World, trainer: Trainer):
        self.page, self.motion = page, world.task.motion
        self.count = min(ROBOTS, trainer.ppo.env.numel())
        still = np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (self.count, 1))
        self.robots = page.server.scene.add_batched_meshes_simple(
            "/robots",
            wedge(world.robot),
            FACES,
            still,
            np.zeros((self.count, 3), np.float32),
            batched_colors=BLUE,
            side="double",
        )
        self.status = page.server.gui.add_markdown("waiting for the first batch")
        self._seen, self._fresh, self._stop = time.monotonic() - EVERY, threading.Event(), threading.Event()
        self._poses: tuple[Tensor, Tensor] | None = None
        self._figures: dict[str, float] = {}
        self.played = 0  # steps shown so far
        trainer.ppo.collector = WatchedCollector(trainer.ppo.collector, self)
        trainer.watch = self.note
        self._thread = threading.Thread(target=self._play, daemon=True)
        self._thread.start()

    def wants(self) -> bool:
        """Whether it is time to show another batch."""
        return time.monotonic() - self._seen >= EVERY

    def see(self, states: Tensor) -> None:
        """Play the states [T, B, ...] of a batch until the next one arrives."""
        self._seen = time.monotonic()
        with torch.no_grad():
            some = states[:, : self.count]
            poses = self.motion.body_to_world(some.reshape(-1, *some.shape[2:]).clone()).cpu()
        quats = rotations_to_quats(poses[:, :3, :3]).view(len(some), -1, 4)
        self._poses = quats, poses[:, :3, 3].reshape(len(some), -1, 3)
        self._fresh.set()

    def note(self, row: Mapping[str, float]) -> None:
        """Show the figures of a row of the history; those that it lacks stay as they were."""
        self._figures |= {name: row[name] for name in FIGURES if not math.isnan(row.get(name, math.nan))}
        self.status.content = "\n".join(
            f"- {name.replace('_', ' ')} {self._figures[name]:{form}}"
            for name, form in FIGURES.items()
            if name in self._figures
        )

    def close(self) -> None:
        """Stop the thread."""
        self._stop.set()
        self._fresh.set()
        self._thread.join(timeout=2.0)

    def _play(self) -> None:
        while not self._stop.is_set():
            self._fresh.wait()
            self._fresh.clear()
            if self._poses is None:
                continue
            for quats, places in zip(*self._poses, strict=True):
                if self._stop.wait(1 / RATE) or self._fresh.is_set():
                    break
                with self.page.server.atomic():
                    self.robots.batched_wxyzs, self.robots.batched_positions = quats.numpy(), places.numpy()
                self.played += 1
