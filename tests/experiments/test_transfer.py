"""Policies are tested in every scene of their experiment, with a steady camera."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from omegaconf import OmegaConf
from PIL import Image
from tensordict import TensorDictBase

from splatrl import waits
from splatrl.building import build_one_world
from splatrl.configuration import load_config, placed, run_config
from splatrl.experiments import Experiment, Run, checked, planned, transfer
from splatrl.experiments.report import write_report
from splatrl.experiments.tables import transfer_sentences, transfer_table
from splatrl.experiments.transfer import score_everywhere
from tests.experiments.made_up import NODE, SCENES, compose, finish
from tests.experiments.trained import save_run
from tests.test_waits import terminal_of
from tests.tiny import LONG_STEPS, tiny_overrides


def run_of(folder: Path, scene: str, *more: str) -> Run:
    """Return a run of the first-person task in the tiny room, as if trained."""
    cfg = load_config([*tiny_overrides(folder, "fps"), *LONG_STEPS, *more])
    save_run(folder / f"{scene}-a-s0", cfg, 2)
    config = OmegaConf.to_container(cfg)
    assert isinstance(config, dict)
    return Run(
        scene, "a", "an arm", 0, folder / f"{scene}-a-s0", (), {str(key): value for key, value in config.items()}
    )


def test_every_policy_is_tested_in_every_scene(tmp_path: Path) -> None:
    small = ["task.max_steps=8", "evaluation.starts=5", "task.motion.upper=[0.0,1.5]", "landmarks.goal=[-0.5,1.0,0.0]"]
    runs = [
        run_of(tmp_path, "room", "task.max_steps=8", "evaluation.starts=9", "transforms/pose_noise=uniform"),
        run_of(tmp_path, "part", *small),
    ]
    rows = score_everywhere(runs, tmp_path)
    assert [(row["run"], row["place"]) for row in rows] == [
        ("room-a-s0", "part"),
        ("room-a-s0", "room"),
        ("part-a-s0", "part"),
        ("part-a-s0", "room"),
    ]
    assert all(0 <= row["success_rate"] <= 1 and 0 <= row["step_spl"] <= 1 for row in rows)
    assert [row["starts"] for row in rows] == [9, 9, 5, 5]
    assert rows == score_everywhere(runs, tmp_path)


def test_a_policy_that_repeats_actions_is_measured_by_the_steps_of_shortest_paths(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(waits, "LONG", 1e-9)
    terminal = terminal_of(monkeypatch)
    cfg = load_config([*tiny_overrides(tmp_path), "transforms/skip=four"])
    world = build_one_world(cfg)

    def planner(td: TensorDictBase) -> TensorDictBase:
        return td.set("action", world.plan.optimal(td["state"]).int().argmax(1))

    monkeypatch.setattr(transfer, "load_policy", lambda *given, **more: SimpleNamespace(policy=planner))
    rates = transfer.tested(tmp_path, cfg, world)
    assert rates["success_rate"] == rates["step_spl"] == 1.0
    assert f"{tmp_path.name}:" in terminal.getvalue()  # on the bar of a test that takes long


def test_a_policy_keeps_its_network_and_takes_the_robot_and_goal_of_the_test_place(tmp_path: Path) -> None:
    own = run_of(tmp_path, "room", "transforms/pose_noise=uniform", "memory=stack").folder
    other = run_of(tmp_path, "part", "robot.height=0.7", "landmarks.goal=[0.0,0.5,90.0]").folder
    moved = placed(run_config(own), run_config(other))
    assert moved.robot.height == 0.7 and moved.landmarks.goal == [0.0, 0.5, 90.0]
    assert moved.transforms == run_config(own).transforms and moved.network.memory == run_config(own).network.memory


def test_tests_in_other_scenes_are_without_pose_noise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run, seen = run_of(tmp_path, "room", "transforms/pose_noise=uniform", "transforms/latency=varied"), []
    monkeypatch.setattr(transfer, "build_world", lambda cfg: seen.append(cfg.transforms))
    monkeypatch.setattr(transfer, "tested", lambda *_: {})
    score_everywhere([run], tmp_path)
    assert run_config(run.folder).transforms.pose_noise and not seen[0].pose_noise and seen[0].latency


def experiment(folder: Path) -> Experiment:
    return planned("tried", checked("tried", NODE), SCENES, folder, compose)


TESTS = [
    {"run": "hall-with-s0", "place": "yard", "starts": 40, "success_rate": 0.5, "success_rate_argmax": 0.4}
    | {"collision_rate": 0.1, "step_spl": 0.3},
    {"run": "hall-with-s1", "place": "yard", "starts": 40, "success_rate": 0.7, "success_rate_argmax": 0.4}
    | {"collision_rate": 0.1, "step_spl": 0.3},
    {"run": "yard-with-s0", "place": "yard", "starts": 40, "success_rate": 0.9, "success_rate_argmax": 0.8}
    | {"collision_rate": 0.0},
    {"run": "gone-with-s0", "place": "yard", "starts": 1, "success_rate": 0.0},
]


def test_tests_in_other_scenes_are_listed_by_place_and_training_scene(tmp_path: Path) -> None:
    lines = transfer_table(TESTS, experiment(tmp_path))
    assert lines[2].startswith("| yard | yard | with it | 1 | 40 | **90.0 %** | 80.0 % | 0.0 % | – |")
    assert lines[3].startswith("| yard | hall | with it | 2 | 40 | **60.0 ± 14.1 %** |") and len(lines) == 4
    (said,) = transfer_sentences(TESTS, experiment(tmp_path))
    each = "90.0 % (with it, trained in yard), 60.0 ± 14.1 % (with it, trained in hall)"
    assert "tested in yard" in said and each in said


def test_places_may_have_a_weather_and_places_without_training_come_last(tmp_path: Path) -> None:
    tests = [{**TESTS[0], "place": place} for place in ("attic, snow", "yard, clear", "yard, snow")]
    lines = transfer_table(tests, experiment(tmp_path))
    assert [line.split("|")[1].strip() for line in lines[2:]] == ["yard, clear", "yard, snow", "attic, snow"]


@pytest.mark.usefixtures("blank_curves")
def test_a_report_includes_tests_in_other_scenes_and_the_captured_scene(tmp_path: Path) -> None:
    asked = experiment(tmp_path)
    for run in asked.runs:
        finish(run, 0.9)
    (asked.folder / "scores.json").write_text(json.dumps({"scores": TESTS}))
    (asked.folder / "capture.json").write_text(json.dumps({"figures": {"psnr": 31.25, "spl": None}}))
    Image.new("RGB", (8, 8)).save(asked.folder / "views.png")
    text = write_report(asked, "an abacus").read_text()
    assert "# Tests in each scene" in text and "| psnr | 31.25 |" in text and "](views.png)" in text
    assert "labelled clips" not in text
    assert pytest.approx(json.loads((asked.folder / "report.json").read_text())["scores"][0]["success_rate"]) == 0.5
