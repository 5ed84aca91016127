"""The training loop around PPO."""

import csv
from pathlib import Path

import pytest

from splatrl.training import Trainer, load_checkpoint
from tests.tiny import tiny_env
from tests.training.test_ppo import learner, parameters


def trainer(folder: Path, tests: list[float], frames: int = 64 * 6) -> Trainer:
    """A trainer of six batches with a test after every second one, whose results are given."""
    ppo = learner(tiny_env([4], max_steps=10), total_frames=frames)
    return Trainer(ppo, folder, iter(tests).__next__, test_interval=128, checkpoint_interval=192)


def test_the_best_checkpoint_is_the_one_that_tested_best(tmp_path: Path) -> None:
    loop = trainer(tmp_path, [0.4, 0.9, 0.6])
    loop.fit()
    best, last = (load_checkpoint(tmp_path / "checkpoints" / f"{name}.pt") for name in ("best", "last"))
    assert (best["ppo"]["frames"], last["ppo"]["frames"]) == (256, 384)
    assert best["best"] == last["best"] == 0.9


def test_of_equal_tests_the_later_is_kept(tmp_path: Path) -> None:
    trainer(tmp_path, [0.5, 0.5, 0.1]).fit()
    assert load_checkpoint(tmp_path / "checkpoints" / "best.pt")["ppo"]["frames"] == 256


def test_the_history_has_a_row_a_batch_and_is_a_table_on_disk(tmp_path: Path) -> None:
    loop = trainer(tmp_path, [0.4, 0.9, 0.6])
    loop.fit()
    with (tmp_path / "progress.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["frames"]) for row in rows] == [64, 128, 192, 256, 320, 384]
    assert [row["test_success"] for row in rows] == ["", "0.4", "", "0.9", "", "0.6"]
    assert [float(row["seconds"]) for row in rows] == sorted(row["seconds"] for row in loop.history)


def test_going_on_keeps_history_best_and_weights(tmp_path: Path) -> None:
    first = trainer(tmp_path, [0.4, 0.3], frames=64 * 3)
    first.fit()
    again = trainer(tmp_path, [0.3, 0.2])
    again.resume()
    assert (parameters(again.ppo) == parameters(first.ppo)).all()
    assert again.seconds == first.seconds
    again.fit()
    assert [row["frames"] for row in again.history] == [64, 128, 192, 256, 320, 384]
    assert again.best == 0.4
    assert again.seconds > first.seconds


def test_a_folder_without_a_checkpoint_begins_anew(tmp_path: Path) -> None:
    loop = trainer(tmp_path, [])
    loop.resume()
    assert loop.ppo.frames == 0 and not loop.history


def test_an_unknown_backend_is_refused_with_those_there_are(tmp_path: Path) -> None:
    ppo = learner(tiny_env([4]))
    with pytest.raises(ValueError, match=r"logger\.backend: expected one of csv, tensorboard, wandb, got paper"):
        Trainer(ppo, tmp_path, lambda: 0.0, 100, 100, backend="paper")


@pytest.mark.parametrize("key", ["success", "return", "length", "entropy", "level", "episodes"])
def test_a_row_tells_what_a_learning_curve_needs(tmp_path: Path, key: str) -> None:
    loop = trainer(tmp_path, [0.1], frames=64)
    loop.fit()
    assert key in loop.history[0]
