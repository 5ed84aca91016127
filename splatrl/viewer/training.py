"""The page of a training: its robots over the scene, as they were in the last batch, and how far it is."""

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
"""Robots shown, at most."""
EVERY = 0.5
"""Seconds between batches that are looked at, at least: a training of many small ones is not slowed down."""
RATE = 10
"""Steps a second at which a batch is played."""
FIGURES = {"frames": ",.0f", "success": ".2f", "test_success": ".2f", "collision": ".2f", "return": ".1f"}
"""Columns of ``progress.csv`` that the page shows, and how."""


class WatchedCollector:
    """A collector whose robots are looked at; what it collects stays as it is.

    Args:
        collector: that of the training.
        view: is given states [T, B, ...], of each step of a batch or of its end alone.
    """

    def __init__(self, collector: Collector, view: "TrainingView"):
        self.collector, self.view = collector, view

    @property
    def carried(self) -> TensorDictBase:
        """What the next batch begins with."""
        return self.collector.carried

    @carried.setter
    def carried(self, value: TensorDictBase) -> None:
        self.collector.carried = value

    def collect(self) -> TensorDictBase:
        """The next frames, [B, T]."""
        batch = self.collector.collect()
        if self.view.wants():
            states = batch.get("state", None)
            self.view.see(self.carried["state"].unsqueeze(0) if states is None else states.transpose(0, 1))
        return batch


class TrainingView:
    """Shows a training without changing it: it reads copies of states, and draws no random numbers.

    Args:
        page: to add to.
        world: scene and task.
        trainer: the training, not yet begun.
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
        self.played = 0  # steps shown so far
        trainer.ppo.collector = WatchedCollector(trainer.ppo.collector, self)
        trainer.watch = self.note
        self._thread = threading.Thread(target=self._play, daemon=True)
        self._thread.start()

    def wants(self) -> bool:
        """Whether it is time to look at another batch."""
        return time.monotonic() - self._seen >= EVERY

    def see(self, states: Tensor) -> None:
        """Play the states [T, B, ...] of a batch until another one comes."""
        self._seen = time.monotonic()
        with torch.no_grad():
            some = states[:, : self.count]
            poses = self.motion.body_to_world(some.reshape(-1, *some.shape[2:]).clone()).cpu()
        quats = rotations_to_quats(poses[:, :3, :3]).view(len(some), -1, 4)
        self._poses = quats, poses[:, :3, 3].reshape(len(some), -1, 3)
        self._fresh.set()

    def note(self, row: Mapping[str, float]) -> None:
        """Show a row of the history."""
        found = {name: row[name] for name in FIGURES if name in row}
        self.status.content = "\n".join(
            f"- {name.replace('_', ' ')} {value:{FIGURES[name]}}" for name, value in found.items()
        )

    def close(self) -> None:
        """End the thread."""
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
