"""Reports of made-up experiments."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from PIL import Image

from splatrl.experiments import Experiment
from splatrl.experiments.curves import learning_curves, look
from splatrl.experiments.report import write_joint_report, write_report
from splatrl.experiments.results import entries
from tests.experiments.made_up import finish, made_up


def reported(folder: Path) -> Experiment:
    experiment = replace(made_up(folder), left_out=("hall: a longer arm is left out.",))
    for number, run in enumerate(experiment.runs):
        finish(run, (9 - number) / 10)
        for name in ("starts.png", "success_map.png", "learning_curve.png", "rollouts.mp4"):
            (run.folder / name).touch()
    return experiment


def links(page: Path) -> list[str]:
    return re.findall(r"\]\(([^)]*)\)", page.read_text())


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of an experiment whose runs are finished."""
    return write_report(reported(tmp_path_factory.mktemp("experiment")), "an abacus")


def test_a_report_states_the_question_the_paper_the_results_and_the_machine(report: Path) -> None:
    text = report.read_text()
    assert "\n*hall: a longer arm is left out.*\n" in text
    order = ["# A title", "Does it?", "It does.", "| yard | with it |", "frames to 90%", "median seed", "an abacus"]
    places = [text.index(part) for part in order]
    assert places == sorted(places)


@pytest.mark.usefixtures("blank_curves")
def test_every_link_of_a_report_points_to_a_file(tmp_path: Path) -> None:
    experiment = reported(tmp_path / "two words")
    own = write_report(experiment, "an abacus")
    joint = write_joint_report([experiment], tmp_path / "two words", "an abacus")
    assert len(links(own)) == len(links(joint)) == 2 + 3 * 4
    for page in (own, joint):
        assert all((page.parent / link.replace("%20", " ")).is_file() for link in links(page))


def test_a_report_shows_pictures_of_the_median_seed(report: Path) -> None:
    assert "yard-with-s1/starts.png" in links(report)
    assert "yard-with-s0/starts.png" not in links(report)


@pytest.mark.usefixtures("blank_curves")
def test_a_report_links_the_success_in_each_scene_of_an_arm_with_several(tmp_path: Path) -> None:
    experiment = reported(tmp_path)
    for run in experiment.runs:
        if run.scene == "yard":
            (run.folder / "scenes.png").touch()
    found = [link for link in links(write_report(experiment, "an abacus")) if link.endswith("scenes.png")]
    assert found == ["yard-with-s1/scenes.png", "yard-without-s1/scenes.png"]


def test_there_is_one_figure_per_comparison(report: Path) -> None:
    figures = {path.name: Image.open(path).size for path in report.parent.glob("*.png")}
    assert figures.keys() == {"curves-yard-430.png", "curves-hall-430.png"}
    assert all(min(size) > 400 for size in figures.values())


def test_a_legend_of_many_arms_leaves_the_panels_their_height(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = list[Figure]()
    monkeypatch.setattr("splatrl.experiments.curves.save_figure", lambda figure, _: drawn.append(figure))
    found = entries(reported(tmp_path))[:1]
    learning_curves(
        [replace(found[0], label=f"an arm with a long label, number {number}") for number in range(25)], tmp_path
    )
    drawn[0].draw_without_rendering()
    height = min(axes.get_window_extent().height for axes in drawn[0].axes) / drawn[0].dpi
    assert height > 1.0  # inch


def test_the_numbers_of_a_report_are_also_written_as_json(report: Path) -> None:
    numbers = json.loads(report.with_name("report.json").read_text())
    arm = numbers["arms"][0]
    assert (arm["scene"], arm["arm"], arm["seeds"], arm["budget"]) == ("yard", "with it", [0, 1], 430)
    assert arm["success_rate"]["values"] == [0.9, 0.6]
    assert numbers["machine"] == "an abacus"


def test_curves_without_values_leave_their_panel_empty(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    experiment = made_up(tmp_path)
    finish(experiment.runs[0], 0.9, tested=())
    write_report(experiment, "a machine")
    assert [str(each.message) for each in recwarn] == []  # of a layout that finds no room


def test_fifteen_curves_of_one_figure_look_different() -> None:
    assert len({(marker, *style.values()) for marker, style in map(look, range(15))}) == 15


def test_a_report_without_a_finished_run_says_so(tmp_path: Path) -> None:
    experiment = made_up(tmp_path)
    assert "None of 6 trainings is finished" in write_report(experiment, "an abacus").read_text()


@pytest.mark.usefixtures("blank_curves")
def test_a_report_of_some_runs_says_how_many_are_finished(tmp_path: Path) -> None:
    experiment = made_up(tmp_path)
    finish(experiment.runs[0], 0.5)
    assert "1 of 6 trainings are finished" in write_report(experiment, "an abacus").read_text()


@pytest.mark.usefixtures("blank_curves")
def test_a_report_names_the_machine_of_the_trainings_and_not_its_own(tmp_path: Path) -> None:
    experiment = reported(tmp_path)
    (experiment.folder / "machine.json").write_text(json.dumps({"machine": "a loom"}))
    text = write_report(experiment, "an abacus").read_text()
    assert "a loom" in text
    assert "an abacus" not in text
