"""``scene=many scene.paths=[...]``: values that belong to each scene, and overrides that apply to all of them."""

from pathlib import Path

import pytest
from omegaconf import OmegaConf

from splatrl.building import build_one_world, build_world
from splatrl.configuration import (
    check_config,
    job_config,
    load_config,
    place_configs,
    place_names,
    run_config,
    save_config,
    with_scene_paths,
)
from splatrl.configuration.command_line import command_line
from splatrl.configuration.search_path import composed
from splatrl.envs.world import Worlds
from tests.two_rooms import in_both, overrides, two_rooms


def test_each_scene_has_the_values_that_its_folder_proposes(tmp_path: Path) -> None:
    west, east = place_configs(load_config(in_both(tmp_path)))
    assert (west.robot.height, east.robot.height) == (0.5, 0.65)
    assert (west.task.goal, east.task.goal) == ([0.5, 1.0, 0.0], [5.5, 0.5, 0.0])
    assert (west.task.motion.lower, east.task.motion.lower) == ([-1.0, -1.5], [4.0, -1.5])
    assert [Path(place.scene.path).name for place in (west, east)] == ["west", "east"]


def test_an_override_applies_to_all_scenes_wherever_it_is_typed(tmp_path: Path) -> None:
    words = in_both(tmp_path)
    for typed in ([*words, "robot.height=0.6"], ["robot.height=0.6", *words]):
        assert [place.robot.height for place in place_configs(load_config(typed))] == [0.6, 0.6]


def test_scenes_may_be_folders_and_configs_with_or_without_a_seed(tmp_path: Path) -> None:
    west, _ = two_rooms(tmp_path)
    words = [*overrides(), "scene=many", f"scene.paths=[{west},backyard:7,backyard]"]
    places = place_configs(load_config(words))
    assert [place.scene.get("seed") for place in places] == [None, 7, 0]
    assert [place.robot.height for place in places] == [0.5, 0.4, 0.4]


@pytest.mark.parametrize(
    ("paths", "message"),
    [
        ("[]", "scene.paths: expected at least one scene, got none; type scene.paths="),
        ("backyard", "scene.paths: expected a list .* got backyard"),
        ("[nowhere/]", "scene.paths: expected one of backyard, .* or an existing path, got nowhere/"),
        ("[backyard:x]", "scene.paths: expected .* got backyard:x"),
        (
            "[yards]",
            r"scene.paths: expected one of backyard, town, yard, one with a seed such as yard:3, or .* got yards",
        ),
        ("[kitchen]", "scene.paths: expected .* got kitchen"),  # its path is missing
    ],
)
def test_an_invalid_list_of_scenes_is_refused_with_what_is_expected(paths: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        check_config(load_config(["scene=many", f"scene.paths={paths}"]))


def test_each_job_of_a_sweep_over_folders_has_the_values_that_its_folder_proposes(tmp_path: Path) -> None:
    west, east = two_rooms(tmp_path)
    words = command_line("train", ["-m", *overrides(), "seed=0,1", f"scene={west},{east}"])
    assert words == ["-m", *overrides(), "seed=0,1", "scene=file", f"scene.path='{west}','{east}'"]
    for typed, height in (([], 0.65), (["robot.height=0.4"], 0.4)):
        job = [*overrides(), *typed, "seed=1", "scene=file", f"scene.path='{east}'"]
        cfg = job_config(composed(job, "train"), job)
        assert (cfg.robot.height, cfg.seed, cfg.landmarks.goal) == (height, 1, [5.5, 0.5, 0.0])
        assert cfg.task.motion.lower == [4.0, -1.5] and cfg.scene.path == str(east)
    (tmp_path / "x, y").symlink_to(west)
    given = f"'{tmp_path}/x, y','{east}'"
    assert command_line("train", ["-m", f"scene={given}"])[-1] == f"scene.path={given}"
    with pytest.raises(SystemExit, match=f"only existing paths, .*, got {west} among"):
        command_line("train", ["-m", f"scene={west},{tmp_path}/nowhere/"])


def test_a_job_in_a_folder_with_the_name_of_a_config_trains_in_that_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    west, _ = two_rooms(tmp_path)
    west.rename(tmp_path / "backyard")
    monkeypatch.chdir(tmp_path)
    job = ["scene=file", "scene.path=backyard"]  # as a file may sweep
    assert job_config(composed(job, "train"), job).scene.path == str(tmp_path / "backyard")
    monkeypatch.chdir("/")  # as with hydra.job.chdir=true, where the scene is said to be missing
    assert job_config(composed(job, "train"), job).scene.path == "backyard"


@pytest.mark.parametrize(
    ("typed", "swept", "jobs"),
    [
        (["scene=yard", "scene.seed=1,0"], ["scene=yard", "scene.seed=1,0"], ["yard:1", "yard:0"]),
        (["scene=yard:1,yard:0"], ["scene=yard", "scene.seed=1,0"], ["yard:1", "yard:0"]),
    ],
)
def test_each_job_of_a_sweep_over_yards_has_the_goal_of_its_yard(
    typed: list[str], swept: list[str], jobs: list[str]
) -> None:
    assert command_line("train", ["-m", *typed, "seed=0,1"]) == ["-m", *swept, "seed=0,1"]
    for job, seed in zip(jobs, (1, 0), strict=True):
        words = ["scene=yard", f"scene.seed={seed}", "seed=1"]
        assert job_config(composed(words, "train"), words) == load_config([f"scene={job}", "seed=1"])


def test_a_sweep_given_in_a_file_trains_in_each_yard_with_its_own_goal() -> None:
    words = with_scene_paths(["-m", "scene=yard", "+x=1"])  # the seeds are in hydra.sweeper.params of some file
    assert words == ["-m", "scene=yard", "+x=1"]
    job = ["scene.seed=2", *words[1:]]
    yard = load_config(["scene=yard", "scene.seed=2"])
    assert job_config(composed(job, "train"), job).landmarks == yard.landmarks
    assert yard.landmarks != load_config(["scene=yard"]).landmarks


def test_each_job_of_a_sweep_over_lists_of_scenes_has_all_scenes_of_its_list(tmp_path: Path) -> None:
    west, east = two_rooms(tmp_path)
    for key, job, names in (
        ("scene=yards", "scene.count=2", ["yard:0", "yard:1"]),
        ("scene=many", f"scene.paths=[{west},{east}]", [str(west), str(east)]),
    ):
        other = job.replace("2", "1").replace(f"{west},", "")
        assert command_line("train", ["-m", *overrides(), key, f"{job},{other.partition('=')[2]}"])[-2] == key
        words = [*overrides(), key, job]
        assert place_names(job_config(composed(words, "train"), words)) == names


def test_a_name_is_a_folder_where_the_config_of_that_name_is_incomplete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    west, _ = two_rooms(tmp_path)
    west.rename(tmp_path / "kitchen")
    monkeypatch.chdir(tmp_path)
    (place,) = place_configs(load_config([*overrides(), "scene=many", "scene.paths=[kitchen]"]))
    assert place.robot.height == 0.5


def test_an_error_in_one_of_several_scenes_names_that_scene(tmp_path: Path) -> None:
    words, west = in_both(tmp_path), tmp_path / "west"
    (west / "scene.yaml").write_text("splat: room.ply\ngoal: [0.5, 1.0, 0.0]\n")
    with pytest.raises(
        ValueError, match=f"robot.height: expected a value in {west}, got none; state robot_height in its"
    ):
        check_config(load_config(words))
    with pytest.raises(ValueError, match=f"{west}: scene: expected free poses, got 200 poses"):
        build_world(load_config([*words, "robot.height=0.04"]))
    with pytest.raises(ValueError, match=r"goals/west: task\.goals: expected at most"):
        (tmp_path / "goals").mkdir()
        build_world(load_config([*in_both(tmp_path / "goals", "pointnav"), "task.goals=90000"]))


def test_settings_in_which_scenes_must_agree_are_refused_together_before_a_scene_is_built(tmp_path: Path) -> None:
    words = [*in_both(tmp_path, "apple"), f"scene.paths=[{tmp_path / 'west'},yard:3,{tmp_path / 'east'}]"]
    del words[-2]
    for name, step in (("west", 0.2), ("east", 0.25)):
        with (tmp_path / name / "scene.yaml").open("a") as stream:
            stream.write(f"antialiased: {'true' if name == 'west' else 'false'}\nobject_size: 0.05\nstep: {step}\n")
    with pytest.raises(ValueError) as refused:
        check_config(load_config(words))
    west, east = tmp_path / "west", tmp_path / "east"
    assert str(refused.value) == (
        "antialiased, object_size, step: expected the same in all scenes, "
        f"got antialiased True in {west} and False in {east}, object_size 0.05 in {west} and 0.16 in yard:3, "
        f"step 0.2 in {west} and 0.1 in yard:3 and 0.25 in {east}; "
        "type renderer.antialiased=... drawing.size=... task.motion.step=... task.motion.spacing=..."
    )
    words += ["renderer.antialiased=true", "task.motion.step=0.1", "task.motion.spacing=0.1"]
    with pytest.raises(ValueError, match=r"^object_size: expected .*, got 0\.05 in .* and 0\.16 in"):
        check_config(load_config(words))
    check_config(load_config([*words, "drawing.size=0.05"]))


def test_a_run_folder_stores_its_scenes(tmp_path: Path) -> None:
    cfg = load_config(in_both(tmp_path))
    save_config(cfg, tmp_path)
    world = build_world(run_config(tmp_path))
    assert isinstance(world, Worlds) and world.name == "west, east"
    assert world.digest == build_world(cfg).digest


@pytest.mark.parametrize("key", ["scene", "task"])
def test_a_scene_in_a_strangers_run_can_name_only_trusted_constructors(tmp_path: Path, key: str) -> None:
    cfg = load_config(in_both(tmp_path))
    OmegaConf.set_struct(cfg, False)
    if key == "scene":
        cfg.scene.places[1].scene._target_ = "os.system"
    else:  # a reference that is harmless until the scene changes what it refers to
        cfg.task._target_ = "${landmarks.kind}"
        cfg.landmarks.kind = "splatrl.envs.tasks.Grid"
        cfg.scene.places[1].landmarks.kind = "os.system"
    with pytest.raises(ValueError, match=r"_target_: expected a constructor that appears in conf/.*'os.system'"):
        check_config(cfg)


def test_a_scene_cannot_extend_the_allowed_targets(tmp_path: Path) -> None:
    cfg = load_config(in_both(tmp_path))
    OmegaConf.set_struct(cfg, False)
    cfg.scene.places[1].allow_targets = ["os"]
    assert [list(place.allow_targets) for place in place_configs(cfg)] == [[], []]


def test_commands_for_one_scene_refuse_several(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="scene: expected one scene for this command, got 2"):
        build_one_world(load_config(in_both(tmp_path)))


def test_there_are_as_many_yards_as_requested_each_with_its_own_goal() -> None:
    words = ["scene=yards", "scene.count=2", "scene.first=3"]
    places = place_configs(load_config(words))
    assert [place.scene.seed for place in places] == [3, 4]
    assert places[0].task.goal != places[1].task.goal and all(len(place.task.goal) == 3 for place in places)
    one = place_configs(load_config(["scene=many", "scene.paths=[yard:4]"]))[0]
    assert one.task.goal == places[1].task.goal


@pytest.mark.parametrize(
    ("word", "message"), [("scene.count=0", "scene.count: expected"), ("scene.first=x", "scene.first")]
)
def test_an_invalid_number_of_yards_is_refused(word: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_config(["scene=yards", word])
