"""The training loop around PPO."""

import csv
import os
import shlex
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from tensordict import TensorDictBase

from splatrl.envs.stateful_env import StatefulEnv
from splatrl.envs.transforms import Appearance
from splatrl.training import Trainer, load_checkpoint, save_checkpoint
from tests.tiny import tiny_env
from tests.training.test_ppo import learner, parameters


def trainer(folder: str | Path, tests: list[float], frames: int = 64 * 6) -> Trainer:
    """Make a trainer of six batches that tests after every second one, with the given results."""
    ppo = learner(tiny_env([4], max_steps=10), total_frames=frames)
    results = ({"success": success} for success in tests)
    return Trainer(ppo, folder, results.__next__, test_interval=128, checkpoint_interval=192)


def test_the_best_checkpoint_is_the_one_that_tested_best(tmp_path: Path) -> None:
    loop = trainer(str(tmp_path), [0.4, 0.9, 0.6])
    loop.fit()
    best, last = (load_checkpoint(tmp_path / "checkpoints" / f"{name}.pt") for name in ("best", "last"))
    assert (best["ppo"]["frames"], last["ppo"]["frames"]) == (256, 384)
    assert best["best"] == last["best"] == (0.9,)


def test_among_equal_success_rates_the_checkpoint_with_more_goals_is_kept(tmp_path: Path) -> None:
    ppo = learner(tiny_env([4], max_steps=10), total_frames=64 * 6)
    results = iter([{"success": 0.5, "goals": 9.0}, {"success": 1.0, "goals": 4.0}, {"success": 1.0, "goals": 3.0}])
    loop = Trainer(ppo, tmp_path, results.__next__, test_interval=128, checkpoint_interval=192)
    loop.fit()
    assert load_checkpoint(tmp_path / "checkpoints" / "best.pt")["ppo"]["frames"] == 256
    assert loop.best == (1.0, 4.0) and loop.history[3]["test_goals"] == 4.0


def test_among_equal_test_results_the_later_checkpoint_is_kept(tmp_path: Path) -> None:
    trainer(tmp_path, [0.5, 0.5, 0.1]).fit()
    assert load_checkpoint(tmp_path / "checkpoints" / "best.pt")["ppo"]["frames"] == 256


def test_the_history_has_a_row_per_batch_and_is_saved_as_a_table(tmp_path: Path) -> None:
    loop = trainer(tmp_path, [0.4, 0.9, 0.6])
    loop.fit()
    with (tmp_path / "progress.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["frames"]) for row in rows] == [64, 128, 192, 256, 320, 384]
    assert [row["test_success"] for row in rows] == ["", "0.4", "", "0.9", "", "0.6"]
    assert "level" not in rows[0]  # its curriculum has only one
    assert [float(row["seconds"]) for row in rows] == sorted(row["seconds"] for row in loop.history)


@pytest.mark.parametrize(("threshold", "told"), [(1.0, True), (0.001, False)])
def test_a_training_that_ends_below_the_highest_level_says_which_starts_it_never_used(
    threshold: float, told: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    env = tiny_env([4], max_steps=10, first=5 if told else 8, threshold=threshold, window=100 if told else 1)
    folder = tmp_path / "Bob's run"
    loop = Trainer(learner(env, total_frames=256), folder, lambda: {"success": 0.0}, 1000, 1000)
    loop.fit()
    share = 1 - env.curriculum.starts.share(0)
    expected = (
        f"the curriculum ended at level 1 of 5: learning from reward began no episode more than 5 steps from the goal, "
        f"where {share:.0%} of the starts are; to go on: splatrl-train {shlex.quote(f'resume={folder}')} "
        "collector.total_frames=512; "
        "if the level had stopped rising, begin anew with demos=100 dagger.rounds=4 curriculum=none instead"
    )
    assert (expected in capsys.readouterr().err) == told and 0 < share < 1
    assert told or loop.level == loop.levels == 2
    loop.fit()  # nothing is left to learn, and nothing to say
    assert "curriculum" not in capsys.readouterr().err


def test_resuming_keeps_history_best_result_and_weights(tmp_path: Path) -> None:
    first = trainer(tmp_path, [0.4, 0.3], frames=64 * 3)
    first.fit()
    again = trainer(tmp_path, [0.3, 0.2])
    again.resume()
    assert (parameters(again.ppo) == parameters(first.ppo)).all()
    assert again.seconds == first.seconds
    again.fit()
    assert [row["frames"] for row in again.history] == [64, 128, 192, 256, 320, 384]
    assert again.best == (0.4,)
    assert again.seconds > first.seconds


def test_resuming_in_an_empty_folder_begins_anew(tmp_path: Path) -> None:
    loop = trainer(tmp_path, [])
    loop.resume()
    assert loop.ppo.frames == 0 and not loop.history


def test_a_damaged_checkpoint_is_replaced_by_the_previous_one(tmp_path: Path) -> None:
    whole = trainer(tmp_path, [0.4, 0.9, 0.6])
    whole.fit()
    weights, last = parameters(whole.ppo), tmp_path / "checkpoints" / "last.pt"
    for damage in (lambda: last.write_bytes(last.read_bytes()[:1000]), last.unlink):
        damage()
        again = trainer(tmp_path, [0.9, 0.6])
        message = r"last\.pt: expected .*; resuming from the previous checkpoint, previous\.pt"
        with pytest.warns(UserWarning, match=message):
            again.resume()
        assert again.ppo.frames == 192
        again.fit()
        assert (parameters(again.ppo) == weights).all()
        trainer(tmp_path, []).resume()  # the checkpoint is complete again


def test_a_folder_with_traces_of_a_training_but_no_checkpoint_is_refused(tmp_path: Path) -> None:
    trainer(tmp_path, [0.4, 0.9, 0.6]).fit()
    for name in ("last", "previous"):
        (tmp_path / "checkpoints" / f"{name}.pt").unlink()
    with pytest.raises(ValueError, match=r"last\.pt: expected a checkpoint, found none; there is no earlier"):
        trainer(tmp_path, []).resume()


def test_resuming_restores_the_table_and_removes_temporary_files(tmp_path: Path) -> None:
    trainer(tmp_path, [0.4, 0.9, 0.6]).fit()
    table = (tmp_path / "progress.csv").read_text()
    (tmp_path / "progress.csv").write_text(table[:100])
    stale = [tmp_path / "progress.csv.0123abcd.tmp", tmp_path / "checkpoints" / "last.pt.89abcdef.tmp"]
    kept = tmp_path / "mine.tmp"
    for path in (*stale, kept):
        path.write_text("half")
    trainer(tmp_path, []).resume()
    assert (tmp_path / "progress.csv").read_text() == table
    assert kept.exists() and not any(path.exists() for path in stale)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_the_training_after_the_batch_is_saved(tmp_path: Path, number: signal.Signals) -> None:
    loop = trainer(tmp_path, [0.4, 0.9, 0.6])
    collect, before = loop.ppo.collect, signal.getsignal(signal.SIGTERM)

    def interrupted() -> TensorDictBase:
        if loop.ppo.frames == 64:
            signal.raise_signal(number)
        return collect()

    loop.ppo.collect = interrupted  # type: ignore[method-assign]
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as the commands set it
    try:
        with pytest.raises(KeyboardInterrupt):
            loop.fit()
        assert signal.getsignal(signal.SIGTERM) is signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGTERM, before)
    assert load_checkpoint(tmp_path / "checkpoints" / "last.pt")["ppo"]["frames"] == 128


def test_an_interrupt_in_the_last_batch_ends_the_command_with_the_training_saved(tmp_path: Path) -> None:
    loop = trainer(tmp_path, [0.4, 0.9, 0.6])
    collect, handler = loop.ppo.collect, signal.getsignal(signal.SIGINT)

    def interrupted() -> TensorDictBase:
        if loop.ppo.frames == 320:
            os.kill(os.getpid(), signal.SIGINT)
        return collect()

    loop.ppo.collect = interrupted  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        loop.fit()
    assert load_checkpoint(tmp_path / "checkpoints" / "last.pt")["ppo"]["frames"] == 384
    assert signal.getsignal(signal.SIGINT) == handler


def test_an_interrupt_in_the_test_after_preparation_costs_only_this_test(tmp_path: Path) -> None:
    loop, results = trainer(tmp_path, []), iter([{"success": 0.1}])

    def teach() -> Iterator[dict[str, float]]:
        for _ in range(2):
            loop.ppo.frames += 32
            yield {"loss_cloning": 1.0}

    def interrupted() -> dict[str, float]:
        if loop.ppo.frames == 64:
            raise KeyboardInterrupt
        return next(results)

    loop.prepare, loop.test = [teach], interrupted
    with pytest.raises(KeyboardInterrupt):
        loop.fit()
    again = trainer(tmp_path, [0.9, 0.6, 0.5, 0.4])
    again.resume()
    assert again.prepared and again.history == loop.history
    again.fit()
    tests = {row["frames"]: row["test_success"] for row in again.history if "test_success" in row}
    assert tests == {32: 0.1, 64: 0.9, 128: 0.6, 256: 0.5, 384: 0.4}
    assert [row["frames"] for row in again.history] == [32, 64, 128, 192, 256, 320, 384]


def test_preparation_that_leaves_no_frames_to_learn_from_reward_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    loop = trainer(tmp_path, [0.5])

    def teach() -> Iterator[dict[str, float]]:
        loop.ppo.frames += loop.ppo.total_frames - 5
        yield {"loss_cloning": 1.0}

    loop.prepare = [teach]
    loop.fit()
    said = f"no learning from reward: of collector.total_frames={loop.ppo.total_frames} 5 are left"
    assert said in capsys.readouterr().err


def test_resuming_with_an_env_or_a_network_of_another_shape_is_refused_in_one_line(tmp_path: Path) -> None:
    trainer(tmp_path, [0.4, 0.9, 0.6]).fit()
    others = [
        learner(tiny_env([4], max_steps=10), total_frames=64 * 8, memory=16),
        learner(StatefulEnv(tiny_env([4], max_steps=10), Appearance()), total_frames=64 * 8),
    ]
    for other in others:
        loop = Trainer(other, tmp_path, dict, test_interval=128, checkpoint_interval=192)
        with pytest.raises(ValueError, match=r"expected a training whose env and network .*cannot be changed") as found:
            loop.resume()
        assert "\n" not in str(found.value)


def test_a_run_of_a_high_level_resumes_at_the_last_level_there_is(tmp_path: Path) -> None:
    env = tiny_env([4], max_steps=10, first=1)
    env.curriculum.progress[0] = env.curriculum.starts.levels - 1
    results = iter([{"success": 0.5}] * 3)
    loop = Trainer(learner(env, total_frames=64), tmp_path, results.__next__, 128, 192)
    loop.fit()
    assert [row["level"] for row in loop.history] == [loop.levels]  # levels count from one
    again = Trainer(learner(tiny_env([4], max_steps=10), total_frames=128), tmp_path, results.__next__, 128, 192)
    again.resume()
    assert int(again.ppo.env.curriculum.level) == 0
    again.fit()


@pytest.mark.parametrize("value", [0, -1, 1.5, True, "abc"])
@pytest.mark.parametrize("key", ["logger.test_interval", "checkpoint.interval"])
def test_an_interval_is_a_whole_number_above_0(tmp_path: Path, key: str, value: object) -> None:
    intervals = {"logger.test_interval": 100, "checkpoint.interval": 100} | {key: value}
    with pytest.raises(ValueError, match=rf"{key}: expected a whole number of at least 1, got {value!r}"):
        Trainer(learner(tiny_env([4])), tmp_path, lambda: 0.0, *intervals.values())  # type: ignore[arg-type]


def test_an_error_on_a_full_disk_names_the_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    loop = trainer(tmp_path, [])
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"cannot write: No space left on device: '.*last\.pt'"):
        loop.save()


@pytest.mark.parametrize("key", ["success", "return", "length", "entropy", "episodes"])
def test_a_row_of_the_history_has_what_a_learning_curve_needs(tmp_path: Path, key: str) -> None:
    loop = trainer(tmp_path, [0.1], frames=64)
    loop.fit()
    assert key in loop.history[0]


def test_a_checkpoint_that_lacks_something_is_refused_by_the_name_of_what_is_missing(tmp_path: Path) -> None:
    trainer(tmp_path, [0.4], frames=64).fit()
    path = tmp_path / "checkpoints" / "last.pt"
    state = load_checkpoint(path)
    del state["ppo"]["env"]["curriculum.cohort"]
    save_checkpoint(path, state)
    with pytest.raises(ValueError, match=r'got: .* Missing key.*"curriculum\.cohort"; settings that change shapes'):
        trainer(tmp_path, []).resume()
