"""Evaluations of a policy, and the files that they write."""

from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase

from splatrl.building import build_world
from splatrl.configuration import load_config
from splatrl.evaluation.evaluate import EvaluationSettings, evaluate, summary_lines
from splatrl.evaluation.pictures import Pictures
from tests.tiny import tiny_overrides

CHECKPOINT: dict[str, Any] = {"ppo": {"frames": 8}, "seconds": 1.0, "history": [{"frames": 8}]}
SETTINGS = EvaluationSettings("last", 4, 1, 4, 0)


def ahead(td: TensorDictBase) -> TensorDictBase:
    """Always choose the same action."""
    return td.set("action", torch.ones(len(td), dtype=torch.int64))


def test_results_are_written_last_since_they_make_a_run_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: object) -> Path:
        raise KeyboardInterrupt

    world = build_world(load_config(tiny_overrides(tmp_path)))
    folder = tmp_path / "run"
    folder.mkdir()
    with monkeypatch.context() as patch:
        patch.setattr(Pictures, "success_map", stop)
        with pytest.raises(KeyboardInterrupt):
            evaluate(world, ahead, CHECKPOINT, folder, SETTINGS, seed=0, video=False)
    assert (folder / "starts.png").is_file() and not (folder / "evaluation.json").exists()
    summary, files = evaluate(world, ahead, CHECKPOINT, folder, SETTINGS, seed=0, video=False)
    assert f"over 4 of {len(world.plan.start_rows):,} start poses" in summary_lines(summary)[0]
    assert summary_lines(summary)[0].startswith("success 0.000, 95 % CI 0.000 to 0.490, argmax 0.000, ")
    assert summary["level"] is None and summary_lines(summary)[1] == "8 frames in 1 s"  # there was no curriculum
    rising = CHECKPOINT | {"history": [{"frames": 4, "level": 1}, {"frames": 8, "level": 2}]}
    climbed, _ = evaluate(world, ahead, rising, folder, SETTINGS, seed=0, video=False)
    assert summary_lines(climbed)[1] == "8 frames in 1 s, curriculum level 2"
    drawn = {key: value for key, value in summary.items() if key != "start_poses"}  # as of a task that draws its starts
    assert "over 4 episodes" in summary_lines(drawn)[0]
    assert (folder / "evaluation.json").is_file() and all(file.is_file() for file in files)
