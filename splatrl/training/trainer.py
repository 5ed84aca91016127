"""The training loop around PPO: progress, history, tests and checkpoints in a run folder."""

import csv
import io
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from torchrl.record.loggers import get_logger
from tqdm import tqdm

from splatrl.files import checked_name, replacing
from splatrl.training.checkpoint import load_checkpoint, save_checkpoint
from splatrl.training.ppo import PPO

BACKENDS = ("csv", "tensorboard", "wandb")


class Trainer:
    """Runs PPO for its total number of frames, and leaves a run folder from which it can be resumed.

    Writes ``checkpoints/last.pt``, ``checkpoints/best.pt`` and ``progress.csv``, each under a temporary name first.

    Args:
        ppo: the learner.
        folder: the run folder.
        test: returns the success rate of the current policy; it must not touch PyTorch's generator.
        test_interval: frames between tests.
        checkpoint_interval: frames between checkpoints.
        backend: csv, or a TorchRL logger (tensorboard, wandb) in addition to it.
        exp_name: name of the run for that logger.

    Raises:
        ValueError: for any other backend, or a name that is no name of a file.
    """

    def __init__(
        self,
        ppo: PPO,
        folder: Path,
        test: Callable[[], float],
        test_interval: int,
        checkpoint_interval: int,
        backend: str = "csv",
        exp_name: str = "splatrl",
    ):
        if backend not in BACKENDS:
            raise ValueError(f"logger.backend: expected one of {', '.join(BACKENDS)}, got {backend}")
        self.ppo, self.folder, self.test = ppo, folder, test
        self.test_interval, self.checkpoint_interval = test_interval, checkpoint_interval
        self.logger = (
            None if backend == "csv" else get_logger(backend, str(folder), checked_name("logger.exp_name", exp_name))
        )
        self.history: list[dict[str, float]] = []
        self.best = -math.inf
        self.seconds = 0.0
        (folder / "checkpoints").mkdir(parents=True, exist_ok=True)

    @property
    def levels(self) -> int:
        """Number of levels of the curriculum."""
        return self.ppo.env.curriculum.starts.levels

    def resume(self) -> None:
        """Continue from the folder's last checkpoint, or start over if the run was stopped before its first one."""
        path = self.folder / "checkpoints" / "last.pt"
        if path.exists():
            self.load_state_dict(load_checkpoint(path))

    def fit(self) -> None:
        """Train until the frames are used up, with a progress bar."""
        batch = self.ppo.frames_per_batch
        total = self.ppo.total_frames // batch * batch
        began = time.monotonic() - self.seconds
        with tqdm(total=total, initial=self.ppo.frames, unit="frame", desc="train", dynamic_ncols=True) as bar:
            while not self.ppo.finished:
                before = self.ppo.frames
                row = self.ppo.iterate()
                row["level"] = int(self.ppo.env.curriculum.level)
                if self.ppo.finished or _crossed(before, self.ppo.frames, self.test_interval):
                    row["test_success"] = self.test()
                self.seconds = row["seconds"] = time.monotonic() - began
                self._note(row)
                if self.ppo.finished or _crossed(before, self.ppo.frames, self.checkpoint_interval):
                    self.save()
                bar.update(self.ppo.frames - before)
                bar.set_postfix(success=f"{self._recent('success'):.2f}", level=f"{row['level'] + 1}/{self.levels}")

    def _note(self, row: dict[str, float]) -> None:
        self.history.append(row)
        if self.logger is not None:
            for key, value in row.items():
                self.logger.log_scalar(key, value, step=self.ppo.frames)
        if "test_success" in row and row["test_success"] >= self.best:
            self.best = row["test_success"]
            save_checkpoint(self.folder / "checkpoints" / "best.pt", self.state_dict())

    def _recent(self, key: str, rows: int = 5) -> float:
        values = [row[key] for row in self.history[-rows:] if not math.isnan(row[key])]
        return sum(values) / len(values) if values else math.nan

    def save(self) -> None:
        """Write the last checkpoint and the history."""
        save_checkpoint(self.folder / "checkpoints" / "last.pt", self.state_dict())
        keys = list(dict.fromkeys(key for row in self.history for key in row))
        table = io.StringIO(newline="")
        writer = csv.DictWriter(table, keys)
        writer.writeheader()
        writer.writerows(self.history)
        with replacing(self.folder / "progress.csv") as stream:
            stream.write(table.getvalue().encode())

    def state_dict(self) -> dict[str, Any]:
        """PPO's state, with the history, the best test and the seconds spent."""
        return {"ppo": self.ppo.state_dict(), "history": self.history, "best": self.best, "seconds": self.seconds}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a ``state_dict()``."""
        self.ppo.load_state_dict(state["ppo"])
        self.history, self.best, self.seconds = list(state["history"]), state["best"], state["seconds"]


def _crossed(before: int, after: int, interval: int) -> bool:
    return before // interval < after // interval
