"""The config of a run, in another place or another working directory."""

import json
from pathlib import Path

import pytest
from hydra import initialize_config_dir

from splatrl.configuration import (
    check_files,
    command_line,
    conf_dir,
    config_elsewhere,
    load_config,
    resumed_config,
    run_config,
    save_config,
    words_of_place,
)
from splatrl.scenes import write_gaussians
from tests.tiny import tiny_gaussians

PROPOSED = "splat: a.ply\nrobot_height: 0.7\nantialiased: false\nvoxel_size: 0.08\n"


def trained(folder: Path, words: list[str]) -> Path:
    """Write the config and the record of a run that was started with some words, or of a job of a sweep after -m."""
    typed = [word for word in command_line("train", words) if word != "-m"]
    (folder / ".hydra").mkdir(parents=True)
    (folder / ".hydra" / "overrides.yaml").write_text(json.dumps(typed))  # JSON is YAML
    save_config(load_config(typed), folder)
    return folder


@pytest.fixture(autouse=True)
def gardens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, proposed in (("garden", PROPOSED), ("elsewhere/garden", "splat: a.ply\n")):
        (tmp_path / name).mkdir(parents=True)
        write_gaussians(tmp_path / name / "a.ply", tiny_gaussians())
        (tmp_path / name / "scene.yaml").write_text(proposed)
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("sweep", [[], ["-m"]])
def test_what_a_scene_proposed_does_not_hold_in_another_one(tmp_path: Path, sweep: list[str]) -> None:
    run = trained(tmp_path / "run", [*sweep, "robot.fov_deg=70", "scene=garden/", "robot.height=0.5"])
    assert run_config(run).robot.height == 0.5 and run_config(run).renderer.antialiased is False
    there, usual = config_elsewhere(run, ["scene=backyard"]), load_config(["scene=backyard"])
    assert there.renderer.antialiased == usual.renderer.antialiased is True
    assert there.collision.occupancy.resolution == usual.collision.occupancy.resolution
    assert (there.robot.height, there.robot.fov_deg) == (0.5, 70)  # these were typed
    here = config_elsewhere(run, ["robot.fov_deg=60"])
    assert (here.robot.height, here.robot.fov_deg, here.renderer.antialiased) == (0.5, 60, False)


def test_a_job_of_a_sweep_is_moved_alike_by_a_command_with_another_config(tmp_path: Path) -> None:
    run = trained(tmp_path / "run", ["-m", "scene=garden/"])
    alone = config_elsewhere(run, ["scene=backyard"])
    assert alone.robot.height == load_config(["scene=backyard"]).robot.height != 0.7
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):  # as splatrl-evaluate and splatrl-view do
        assert config_elsewhere(run, ["scene=backyard"]) == alone


def test_a_run_is_moved_from_any_working_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = trained(tmp_path / "run", ["scene=garden/"])
    monkeypatch.chdir(tmp_path / "elsewhere")  # where another scene has the same name
    assert config_elsewhere(run, ["robot.fov_deg=60"]).scene.path == str(tmp_path / "garden")
    assert config_elsewhere(run, ["scene=backyard"]).robot.height == load_config(["scene=backyard"]).robot.height


def test_a_run_in_several_scenes_keeps_them_in_any_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = trained(tmp_path / "run", ["scene=many", "scene.paths=[garden/,backyard]"])
    monkeypatch.chdir(tmp_path / "elsewhere")
    garden, backyard = config_elsewhere(run, ["robot.fov_deg=80"]).scene.places
    assert garden.scene.path == str(tmp_path / "garden") and garden.robot.height == 0.7 and "path" not in backyard.scene
    assert (
        "robot" not in config_elsewhere(run, ["robot.height=0.3"]).scene.places[0]
    )  # what is typed holds in all scenes
    assert config_elsewhere(run, ["scene=backyard"]).scene == load_config(["scene=backyard"]).scene


def test_a_run_keeps_the_path_of_its_sprite_but_not_the_name_of_a_built_in_one(tmp_path: Path) -> None:
    (tmp_path / "duck.png").touch()
    words = ["scene=garden/", "task=apple"]
    assert run_config(trained(tmp_path / "a", [*words, "drawing.sprite=duck.png"])).drawing.sprite == str(
        tmp_path / "duck.png"
    )
    assert run_config(trained(tmp_path / "b", words)).drawing.sprite == "apple"


def test_a_run_keeps_the_files_of_its_things_and_looks_in_any_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in (tmp_path, tmp_path / "elsewhere"):  # another file of the same name must not be taken
        (folder / "box.xml").touch()
    things = ["+task.motion.things={crate: box.xml}", "+task.motion.looks.ball=garden/a.ply"]
    run = trained(tmp_path / "run", ["scene=garden/", "task=push", *things])
    monkeypatch.chdir(tmp_path / "elsewhere")
    for cfg in (run_config(run), config_elsewhere(run, ["task.max_steps=50"])):
        assert dict(cfg.task.motion.things) == {"ball": "ball", "crate": str(tmp_path / "box.xml")}
        assert dict(cfg.task.motion.looks) == {"ball": str(tmp_path / "garden" / "a.ply")}


def moved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]) -> Path:
    """Start a run in the garden, move the garden to ``home/mine``, and go there."""
    run = trained(tmp_path / "run", words)
    (tmp_path / "home").mkdir()
    (tmp_path / "garden").rename(tmp_path / "home" / "mine")
    monkeypatch.chdir(tmp_path / "home")
    return run


def test_a_run_whose_scene_has_moved_keeps_everything_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = moved(tmp_path, monkeypatch, ["scene=garden/", "transforms/pose_noise=uniform"])
    own = run_config(run)
    with pytest.raises(FileNotFoundError, match=r"/garden: expected .* found none; if it has moved, type scene\.path="):
        check_files(own)
    own.scene.path = str(tmp_path / "home" / "mine")
    (run / ".hydra" / "overrides.yaml").unlink()  # as in a copy without hidden files
    there = config_elsewhere(run, ["scene.path=mine"])
    check_files(there)
    assert there == own and own.transforms.pose_noise
    with pytest.raises(FileNotFoundError, match=r"overrides\.yaml: expected .* can be typed.* got scene=m"):
        config_elsewhere(run, ["scene=mine", "scene.path=mine"])


def test_a_run_goes_to_another_place_from_where_its_files_are_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "garden" / "duck.png").touch()
    run = moved(tmp_path, monkeypatch, ["task=apple", "scene=garden/", "drawing.sprite=garden/duck.png"])
    words, others = words_of_place(["drawing.sprite=mine/duck.png", "scene.path=mine", "robot.fov_deg=60", "seed=1"])
    assert others == ["seed=1"]
    there = config_elsewhere(run, words)
    paths = [str(tmp_path / "home" / "mine"), str(tmp_path / "home" / "mine" / "duck.png")]
    assert [there.scene.path, there.drawing.sprite] == paths
    assert (there.robot.fov_deg, there.robot.height) == (60, 0.7)
    backyard = config_elsewhere(run, [words[0], "scene=backyard"])
    assert backyard.drawing.sprite == paths[1] and "path" not in backyard.scene


def test_one_of_several_scenes_may_have_moved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = moved(tmp_path, monkeypatch, ["scene=many", "scene.paths=[garden/,yard:3]"])
    with pytest.raises(FileNotFoundError, match=r"/garden: .* type scene\.paths=\[\.\.\.\] anew"):
        check_files(run_config(run))
    expected, word = list(run_config(run).scene.places), "scene.paths=[mine,yard:3]"
    expected[0].scene.path = str(tmp_path / "home" / "mine")
    resumed = resumed_config(run, command_line("train", [f"resume={run}", word]))
    for cfg in (resumed, config_elsewhere(run, [word]), config_elsewhere(run, [word, "robot.fov_deg=60"])):
        assert list(cfg.scene.places) == expected
    save_config(resumed, run)
    save_config(resumed_config(run, [f"resume={run}", "scene.places.0.scene.path=mine"]), run)
    assert list(run_config(run).scene.places) == expected
    for paths in ("[yard:3]", "[mine,yard:4]", "[backyard,yard:3]", "[garden,yard:3]", "mine"):
        told = r"scene\.paths: expected the run's own scenes, \['mine','yard:3'\], with new paths .*, got "
        with pytest.raises(ValueError, match=told):
            config_elsewhere(run, [f"scene.paths={paths}"])
    assert len(config_elsewhere(run, ["scene=many", "scene.paths=[mine]"]).scene.places) == 1


@pytest.mark.parametrize("command", ["evaluate", "view", "export", "clips", "replay"])
def test_all_commands_that_read_a_run_are_told_in_the_same_way_where_its_files_are(
    command: str, tmp_path: Path
) -> None:
    run = trained(tmp_path / "run", ["scene=garden/"])
    folder = f"{'demos' if command == 'replay' else 'run'}={run}"
    *_, place = command_line(command, [folder, "scene.path=home", "robot.path=mine.xml"])
    assert place == r"place=['scene.path=home','robot.path=mine.xml']"


@pytest.mark.parametrize("command", ["evaluate", "view", "export", "clips", "replay"])
@pytest.mark.parametrize("plus", ["", "+"])
def test_all_commands_that_read_a_run_take_transforms_as_part_of_the_place(
    command: str, plus: str, tmp_path: Path
) -> None:
    run = trained(tmp_path / "run", [])
    folder = f"{'demos' if command == 'replay' else 'run'}={run}"
    *_, place = command_line(command, [folder, f"{plus}transforms/latency=none"])
    assert place == r"place=['transforms/latency=none']"
    *_, place = command_line(command, [folder, "+task.motion.looks.ball=ball.ply"])
    assert place == r"place=['+task.motion.looks.ball=ball.ply']"  # which a run may lack


def test_a_run_keeps_its_transforms_elsewhere_except_those_that_are_chosen(tmp_path: Path) -> None:
    words = ["transforms/latency=varied", "transforms/appearance=weather", "transforms/pose_noise=uniform"]
    run = trained(tmp_path / "run", ["scene=garden/", "memory=stack", *words])
    changes = [f"resume={run}", "resume_changed=true", "transforms.pose_noise.height=0.01"]
    save_config(resumed_config(run, changes), run)
    own, there = run_config(run), config_elsewhere(run, ["scene=backyard"])
    assert there.transforms == own.transforms and there.around_drawing == own.around_drawing
    steady = config_elsewhere(run, ["scene=backyard", "transforms/latency=none", "transforms/appearance=none"])
    assert not steady.transforms.latency and not steady.transforms.appearance and not steady.around_drawing
    assert steady.transforms.stack == own.transforms.stack and steady.transforms.pose_noise.height == 0.01
    foggy = config_elsewhere(run, ["transforms.appearance.rain=0"])
    assert foggy.transforms.appearance == {**own.transforms.appearance, "rain": 0}
    assert foggy.around_drawing and foggy.transforms.latency == own.transforms.latency


def test_changed_settings_are_allowed_for_one_resumption_only(tmp_path: Path) -> None:
    run = trained(tmp_path / "run", ["scene=garden/"])
    changed = resumed_config(run, [f"resume={run}", "resume_changed=true", "loss.gamma=0.9", "view=true"])
    assert changed.resume_changed and changed.view
    save_config(changed, run)
    again = resumed_config(run, [f"resume={run}"])
    assert again.loss.gamma == 0.9 and not again.resume_changed and not again.view


def test_settings_changed_on_a_resumption_hold_elsewhere_too(tmp_path: Path) -> None:
    run = trained(tmp_path / "run", ["scene=garden/", "robot.fov_deg=70", "task.max_steps=99"])
    words = ["robot.fov_deg=80", "task.max_steps=50", "landmarks.goal=[1,2,0]", "robot.image_width=32"]
    save_config(resumed_config(run, [f"resume={run}", "resume_changed=true", *words]), run)
    there = config_elsewhere(run, ["scene=backyard", "robot.image_width=16"])
    assert (there.robot.fov_deg, there.task.max_steps, there.robot.image_width) == (80, 50, 16)
    assert there.landmarks.goal == load_config(["scene=backyard"]).landmarks.goal
    assert there.robot.height == load_config(["scene=backyard"]).robot.height
    here = config_elsewhere(run, ["robot.image_width=16"])
    assert (here.robot.fov_deg, here.robot.height, list(here.landmarks.goal)) == (80, 0.7, [1, 2, 0])
    assert config_elsewhere(run, ["task=fps"]).task.max_steps == 99, "what was changed in another task does not hold"
