"""The training loop around PPO: progress, history, tests and checkpoints in a run folder."""

import math
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from splatrl.files import remove_stale
from splatrl.training.checkpoint import Checkpoints, save_checkpoint
from splatrl.training.history import packed, unpacked, write_table
from splatrl.training.interrupts import interrupts
from splatrl.training.ppo import PPO
from splatrl.training.stage import Resumable, Stage
from splatrl.training.trackers import Tracker
from splatrl.values import require_number
from splatrl.waits import Bar

TABLE = "progress.csv"
KEPT = "imitation"
"""Folder in a run folder for what stages of ``prepare`` keep on the disk, removed when they are done."""
PAUSE = 10.0
"""Least time between two saves within a lesson of a stage, seconds."""


class Trainer:
    """Runs PPO for its total number of frames, and leaves a run folder from which training can be resumed.

    Writes ``checkpoints/last.pt``, ``checkpoints/best.pt`` and ``progress.csv``, each under a temporary name first. The
    last checkpoint but one is kept as ``checkpoints/previous.pt``. An interrupt (Ctrl-C or SIGTERM) ends the training
    once the current batch has been learned from and saved; a second one ends it at once.

    Args:
        ppo: the learner.
        folder: the run folder.
        test: tests the current policy without touching PyTorch's generator. It returns the success rate, followed by
            scores that rank policies with the same success rate, most important first. The best checkpoint is the
            highest in this order, and the latest of equals.
        test_interval: frames between tests.
        checkpoint_interval: frames between checkpoints.
        tracker: also receives every row of the history; None for no tracker.
        made_with: plain values on which the training depends, kept in checkpoints.
        prepare: stages run before the first batch of a training, to begin with a policy that has already learned
            something. Each counts the frames that it used in ``ppo.frames``, and yields rows of the history. A stage
            that is stopped on the way continues from what was last saved of it if it is ``Resumable``, or else begins
            anew; those before it are kept.

    Attributes:
        prepared: whether all these stages are done.
        watch: callback that receives each row of the history; it must not affect the training.

    Raises:
        ValueError: for an interval that is not a whole number above 0.
    """

    def __init__(
        self,
        ppo: PPO,
        folder: str | Path,
        test: Callable[[], Mapping[str, float]],
        test_interval: int,
        checkpoint_interval: int,
        tracker: Tracker | None = None,
        made_with: Mapping[str, Any] | None = None,
        prepare: Sequence[Stage] = (),
    ):
        require_number("logger.test_interval", test_interval, 1, whole=True)
        require_number("checkpoint.interval", checkpoint_interval, 1, whole=True)
        self.ppo, self.folder, self.test, self.prepare, self.prepared = ppo, Path(folder), test, prepare, False
        self.watch: Callable[[Mapping[str, float]], object] = lambda row: None
        self.made_with = dict(made_with or {})
        self.test_interval, self.checkpoint_interval = test_interval, checkpoint_interval
        self.tracker = tracker
        self.history: list[dict[str, float]] = []
        self.best: tuple[float, ...] = ()
        self.seconds = 0.0
        self._stage: Resumable | None = None
        self._left: dict[str, Any] | None = None  # of an interrupted stage
        self._began = self._saved = 0.0
        self.checkpoints = Checkpoints(self.folder / "checkpoints")

    @property
    def level(self) -> int:
        """The curriculum's level, counted from 1."""
        return int(self.ppo.env.curriculum.level) + 1

    @property
    def levels(self) -> int:
        """Number of levels of the curriculum."""
        return self.ppo.env.curriculum.starts.levels

    def resume(self, check: Callable[[Mapping[str, Any]], None] = lambda made_with: None) -> None:
        """Continue from the folder's last checkpoint, or start over if the run was stopped before its first one.

        A checkpoint that is damaged or missing is replaced by the one before it, with a warning. The table is written
        anew from the checkpoint, and files that a killed process left half-written are removed.

        Args:
            check: refuses the ``made_with`` of a checkpoint from which this training cannot continue.

        Raises:
            ValueError: if there are traces of a training, but no checkpoint that can be read, or one of an env or a
                network of another shape.
        """
        for folder in (self.folder, self.checkpoints.folder):
            remove_stale(folder)
        state = self.checkpoints.newest(begun=(self.folder / TABLE).exists())
        if state is None:
            return
        check(state.get("made_with", {}))
        try:
            self.load_state_dict(state)
        except (KeyError, RuntimeError) as error:  # what PyTorch and TensorDict raise for tensors of other shapes
            line = " ".join(part.strip() for part in str(error).splitlines()[:2]).rstrip(".")  # the second names a key
            raise ValueError(
                f"{self.folder}: expected a training whose env and network are shaped as these settings say, "
                f"got: {line}; settings that change shapes cannot be changed when a training is resumed"
            ) from error
        write_table(self.folder / TABLE, self.history)

    def fit(self) -> None:
        """Train until all frames are used up, with a progress bar."""
        batch = self.ppo.frames_per_batch
        self._began = time.monotonic() - self.seconds
        if self.ppo.frames == 0:
            self.save()  # so that no checkpoint means that the run has not begun
        if not self.prepared:
            self._prepare()
        shutil.rmtree(self.folder / KEPT, ignore_errors=True)
        self._test_prepared()
        begun = self.ppo.frames
        total = begun + (self.ppo.total_frames - self.ppo.frames) // batch * batch
        bars = {"total": total, "initial": begun, "unit": "frame", "desc": "train"}
        with interrupts() as interrupted, Bar(**bars) as bar:
            while not self.ppo.finished:
                before = self.ppo.frames
                row = self.ppo.iterate()
                row |= self._climbed()
                if self.ppo.finished or _crossed(before, self.ppo.frames, self.test_interval):
                    row |= self._tested()
                self.seconds = row["seconds"] = time.monotonic() - self._began
                self._note(row)
                if self.ppo.finished or _crossed(before, self.ppo.frames, self.checkpoint_interval):
                    self.save()
                bar.update(self.ppo.frames - before)
                climbed = {name: f"{level}/{self.levels}" for name, level in self._climbed().items()}
                bar.set_postfix(success=f"{self._recent('success'):.2f}", **climbed)
                if interrupted:
                    self.save()
                    raise KeyboardInterrupt
        if self.ppo.frames > begun:
            self._tell_of_untried()

    def _tell_of_untried(self) -> None:
        """Say which starts were never used, if the frames were used up below the curriculum's highest level."""
        starts, level = self.ppo.env.curriculum.starts, self.level
        if level < self.levels:
            print(
                f"the curriculum ended at level {level} of {self.levels}: learning from reward began no episode more "
                f"than {starts.limits[level - 1]} steps from the goal, where {1 - starts.share(level - 1):.0%} of the "
                f"starts are; to go on: splatrl-train {shlex.quote(f'resume={self.folder}')} "
                f"collector.total_frames={2 * self.ppo.total_frames}; if the level had stopped rising, begin anew with "
                "demos=100 dagger.rounds=4 curriculum=none instead",
                file=sys.stderr,
            )

    def _prepare(self) -> None:
        """Run the stages of ``prepare``, and save after each."""
        for number, stage in enumerate(self.prepare):
            if number > 0:
                self.save()
            try:
                self._run(stage)
            except KeyboardInterrupt:
                told = (
                    "matching, which begins anew"
                    if self._stage is None
                    else "imitation, which goes on where it was saved"
                )
                print(f"\nstopped within {told} when the training continues", file=sys.stderr)
                raise
        self.prepared = True
        if self.prepare:
            self.save()
            self.save()  # neither checkpoint needs what the stages kept
        if self.ppo.finished and (left := self.ppo.total_frames - self.ppo.frames) > 0:
            told = f"of collector.total_frames={self.ppo.total_frames} {left} are left, less than a batch"
            print(f"no learning from reward: {told} of collector.frames_per_batch", file=sys.stderr)

    def _test_prepared(self) -> None:
        """Test the policy with which learning from reward begins, unless it has been tested."""
        if self.history and self.history[-1].keys().isdisjoint(("success", "test_success")):
            tested = self._tested()  # an interrupt in here costs only this test, which a resumed training repeats
            self._note(self.history.pop() | tested)
            self.save()

    def _run(self, stage: Stage) -> None:
        """Run a stage, and test the policy as often as in the rest of the training."""
        if isinstance(stage, Resumable):
            if self._left is not None:
                stage.load_state_dict(self._left)
            stage.paused, self._stage, self._left = self._paused, stage, None
        for row in stage():
            row |= {"frames": self.ppo.frames} | self._climbed()
            (lesson,) = (name for name in row if name.startswith("loss_"))
            told = f"trained on {self.ppo.frames:,} frames: {lesson} {row[lesson]:.4f}"
            tested_at = int(max((past["frames"] for past in self.history if "test_success" in past), default=0))
            if tested_at == 0 or _crossed(tested_at, self.ppo.frames, self.test_interval):
                row |= self._tested()
                told = f"{told}, success {row['test_success']:.2f}"
            self.seconds = row["seconds"] = time.monotonic() - self._began
            self._note(row)
            print(told, file=sys.stderr)
            if self._stage is not None:
                self.save()
        self._stage = None

    def _paused(self) -> None:
        """Save the training within a lesson, unless it was saved just now."""
        if time.monotonic() - self._saved >= PAUSE:
            self.seconds = time.monotonic() - self._began
            self.save()

    def _climbed(self) -> dict[str, float]:
        """Return the curriculum's level, if it has several."""
        return {"level": self.level} if self.levels > 1 else {}

    def _tested(self) -> dict[str, float]:
        return {f"test_{name}": value for name, value in self.test().items()}

    def _note(self, row: dict[str, float]) -> None:
        self.history.append(row)
        self.watch(row)
        if self.tracker is not None:
            self.tracker.scalars(row, self.ppo.frames)
        tested = tuple(value for name, value in row.items() if name.startswith("test_"))
        if tested and tested >= self.best:
            self.best = tested
            save_checkpoint(self.checkpoints.best, self.state_dict())

    def _recent(self, key: str) -> float:
        """Return the mean of a column over the last five batches, as far as they have it."""
        values = [row[key] for row in self.history[-5:] if not math.isnan(row.get(key, math.nan))]
        return sum(values) / len(values) if values else math.nan

    def save(self) -> None:
        """Write the table and the last checkpoint, keeping the one before it."""
        self.checkpoints.save(self.state_dict())
        write_table(self.folder / TABLE, self.history)
        self._saved = time.monotonic()

    def state_dict(self) -> dict[str, Any]:
        """Return PPO's state, with the history, the best test and the seconds spent."""
        return {
            "ppo": self.ppo.state_dict(),
            "prepared": self.prepared,
            "stage": self._left if self._stage is None else self._stage.state_dict(),
            "history": packed(self.history),
            "best": self.best,
            "seconds": self.seconds,
            "made_with": self.made_with,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a ``state_dict()``."""
        self.ppo.load_state_dict(state["ppo"])
        self.prepared = state.get("prepared", self.ppo.frames > 0)  # older ones were saved only before and after
        self._left = state.get("stage")
        self.history, self.best, self.seconds = unpacked(state["history"]), tuple(state["best"]), state["seconds"]


def _crossed(before: int, after: int, interval: int) -> bool:
    return before // interval < after // interval
