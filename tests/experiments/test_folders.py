"""The status, history and settings that run folders record."""

import json
import math
from pathlib import Path

from splatrl.configuration import differences
from splatrl.documents import write_json
from splatrl.evaluation.evaluate import SCENES_SHOWN
from splatrl.experiments.folders import frames_done, history, status
from tests.experiments.made_up import begin, compose, finish, made_up


def test_a_folder_is_new_then_begun_then_finished(tmp_path: Path) -> None:
    new, begun, finished, *_ = made_up(tmp_path).runs
    new.folder.mkdir(parents=True)
    (new.folder / "config.yaml").touch()
    begin(begun, 120)
    finish(finished, 0.9)
    assert [status(run.folder, run.config) for run in (new, begun, finished)] == ["new", "begun", "finished"]
    assert [frames_done(run.folder) for run in (new, begun, finished)] == [0, 120, 400]


def test_an_evaluated_run_is_finished_once_another_batch_would_exceed_its_budget(tmp_path: Path) -> None:
    interrupted, imitated, *_ = made_up(tmp_path).runs
    for run, frames in ((interrupted, 360), (imitated, 391)):
        finish(run, 0.9)
        lines = (run.folder / "progress.csv").read_text().splitlines()
        (run.folder / "progress.csv").write_text("\n".join([*lines[:9], f"{frames},0.4,5,2,,90.0"]))
    assert [status(run.folder, run.config) for run in (interrupted, imitated)] == ["begun", "finished"]


def test_a_run_that_was_killed_before_its_video_is_not_finished(tmp_path: Path) -> None:
    run = made_up(tmp_path).runs[0]
    run.config["logger"]["video"] = True
    finish(run, 0.9)
    assert status(run.folder, run.config) == "begun"
    (run.folder / "rollouts.mp4").touch()
    assert status(run.folder, run.config) == "finished"


def test_a_run_in_several_scenes_is_finished_once_each_shown_scene_has_a_video(tmp_path: Path) -> None:
    run = made_up(tmp_path).runs[0]
    run.config["logger"]["video"] = True
    finish(run, 0.9)
    summary = json.loads((run.folder / "evaluation.json").read_text())
    write_json(run.folder / "evaluation.json", summary | {"scenes": [{"success_rate": 0.9}] * (SCENES_SHOWN + 1)})
    for number in range(SCENES_SHOWN):
        assert status(run.folder, run.config) == "begun"
        place = run.folder / "scenes" / f"{number}-yard-{number}"
        place.mkdir(parents=True)
        (place / "rollouts.mp4").touch()
    assert status(run.folder, run.config) == "finished"


def test_an_empty_cell_of_the_history_is_nan(tmp_path: Path) -> None:
    run = made_up(tmp_path).runs[0]
    begin(run, 80)
    first, second = history(run.folder)
    assert math.isnan(first["success"])
    assert (second["frames"], second["success"]) == (80, 0.08)


def test_differences_of_configs_list_what_changes_results_and_not_what_changes_speed() -> None:
    asked, found = compose(["scene=yard"]), compose(["scene=yard", "collector.total_frames=80"])
    found |= {"threads": 7, "resume": "here", "renderer": {"threads": 3, "tolerance": 0.5}}
    found["collector"]["cuda_graph"] = True
    asked["renderer"] = {"tolerance": 0.5}
    assert differences(asked, found) == ["collector.total_frames: asked for 430, found 80"]
    del found["collector"]["total_frames"]
    asked["renderer"]["tolerance"] = 0.0
    assert differences(asked, found) == [
        "collector.total_frames: asked for 430, found nothing",
        "renderer.tolerance: asked for 0.0, found 0.5",
    ]


def test_a_relative_path_equals_its_absolute_form() -> None:
    asked, found = compose(["scene=yard.spz"]), compose([f"scene={Path('yard.spz').absolute()}"])
    assert differences(asked, found) == []
