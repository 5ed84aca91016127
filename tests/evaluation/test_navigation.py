"""A navigation policy from training to its evaluation on a saved set of episodes."""

import json
import sys
from pathlib import Path

import pytest

from splatrl.building import build_world
from splatrl.commands import evaluate, train
from splatrl.configuration import load_config, run_config
from splatrl.evaluation.episode_sets import MOST_EPISODES
from splatrl.evaluation.evaluate import summary_lines
from splatrl.evaluation.starts import given_episodes
from tests.tiny import tiny_overrides

MEASURES = ("success", "spl", "soft_spl", "distance_to_goal", "collisions")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of a short training with a lidar, a compass, the point goal and depth."""
    folder = tmp_path_factory.mktemp("run")
    few = ["env.num_envs=4", "collector.frames_per_batch=32", "collector.total_frames=64", "loss.mini_batch_size=16"]
    few += ["logger.num_test_episodes=4", "evaluation.starts=6", "logger.video=false", "loss.ppo_epochs=1"]
    few += ["task.goals=5", "task.test_goals=4", "task.nearest=0.3", "task.cell=0.1", "robot.body.radius=0.1"]
    cfg = load_config([*tiny_overrides(folder, "pointnav"), "sensors=[lidar,compass,pointgoal,depth]", *few])
    train.train(cfg, folder)
    return folder


def test_the_report_has_habitats_measures_and_the_episodes_are_saved(run: Path) -> None:
    report = json.loads((run / "evaluation.json").read_text())
    for key in (*MEASURES, *(f"{key}_argmax" for key in MEASURES)):
        assert report[key] >= 0.0, key
    assert report["success"] == report["success_rate"] and report["spl"] <= report["success"]
    assert not {"step_spl", "start_poses", "longest_path"} & report.keys()  # each episode has its own start and goal
    assert "over 6 episodes, each with its own goal" in summary_lines(report)[0]
    assert (run / "episodes.json.gz").is_file()


def test_evaluating_the_saved_episodes_gives_the_same_report_in_its_own_folder(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = (run / "evaluation.json").read_bytes()
    words = [f"run={run}", f"episodes={run / 'episodes.json.gz'}", "video=false"]
    monkeypatch.setattr(sys, "argv", ["splatrl-evaluate", *words])
    evaluate.main()
    assert (run / "evaluation.json").read_bytes() == own
    before, after = json.loads(own), json.loads((run / "places" / "episodes=episodes" / "evaluation.json").read_text())
    assert after["evaluated_starts"] == 6
    for key in ("success_argmax", "spl_argmax", "soft_spl_argmax", "distance_to_goal_argmax", "mean_length_argmax"):
        assert after[key] == pytest.approx(before[key], abs=1e-4), key


@pytest.mark.parametrize(("typed", "most"), [(["evaluation.starts=2"], 2), ([], MOST_EPISODES)])
def test_a_file_of_episodes_is_evaluated_whole_unless_a_number_of_starts_is_typed(
    run: Path, typed: list[str], most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []
    monkeypatch.setattr(
        evaluate, "evaluate_run", lambda cfg, folder, results, place: asked.append(cfg.evaluation.starts)
    )
    words = [f"run={run}", f"episodes={run / 'episodes.json.gz'}", *typed]
    monkeypatch.setattr(sys, "argv", ["splatrl-evaluate", *words])
    evaluate.main()
    assert asked == [most]


def test_a_refused_evaluation_leaves_the_run_unchanged(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = sorted(run.rglob("*"))
    (tmp_path / "walks.json.gz").write_bytes(b"none")
    monkeypatch.setattr(sys, "argv", ["splatrl-evaluate", f"run={run}", f"episodes={tmp_path / 'walks.json.gz'}"])
    with pytest.raises(SystemExit, match=r"walks\.json\.gz"):
        evaluate.main()
    assert sorted(run.rglob("*")) == before


def test_episodes_that_cannot_be_evaluated_are_refused_before_the_training(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cfg, path = run_config(run), run / "episodes.json.gz"
    world, folder = build_world(cfg), tmp_path / "run"
    assert len(given_episodes(world, path)[1].state) == 6
    assert len(given_episodes(world, path, 4)[1].memory["goal"]) == 4
    other = build_world(load_config(tiny_overrides(tmp_path)))
    folder.mkdir()
    for built, given, refused in (
        (other, path, r"evaluation\.episodes: expected a navigation task, such as task=pointnav, got Grid"),
        (world, tmp_path / "gone.json.gz", r"gone\.json\.gz: "),
    ):
        monkeypatch.setattr(train, "build_world", lambda cfg, built=built: built)
        cfg.evaluation.episodes = str(given)
        with pytest.raises((ValueError, FileNotFoundError), match=refused):
            train.train(cfg, folder)
    assert not (folder / "checkpoints").exists()
