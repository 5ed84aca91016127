"""A scene folder is all that a training needs, its values are data, and the command line overrides them."""

import warnings
from pathlib import Path

import pytest
import torch
from omegaconf import DictConfig

from splatrl.building import build_trainer, build_world
from splatrl.configuration import command_line, load_config, run_config, save_config, with_scene_paths
from splatrl.scenes import read_scene, write_gaussians
from splatrl.scenes.description import read_description, write_description
from tests.tiny import HEIGHT, tiny_gaussians

PROPOSALS = {
    "metric": True,
    "robot_height": HEIGHT,
    "walk": [[-1.0, -1.5], [1.0, 1.5]],
    "step": 0.5,
    "voxel_size": 0.06,
    "cutoff": 0.8,
    "goal": [0.5, 1.0, 0.0],
    "object": [0.75, 1.0, 0.5],
    "source": "Zoë, CC BY 4.0, https://example.org/garden",
    "quality": {"psnr": 27.5, "scale_from": "marker", "trusted": True, "ssim": None},
}
SMALL = ["device=cpu", "robot.image_width=16", "robot.image_height=12", "network.pool=1"]


@pytest.fixture
def garden(tmp_path: Path) -> Path:
    """The tiny room as the folder of a captured scene."""
    folder = tmp_path / "garden"
    folder.mkdir()
    write_gaussians(folder / "splat.ply", tiny_gaussians())
    bounds = ((-1.5, -2.0, 0.0), (1.5, 2.0, 1.2))
    write_description(folder, "splat.ply", "garden", {"scale": 1.0}, bounds, proposals=PROPOSALS)
    return folder


def test_a_description_is_read_back_as_written_and_every_line_has_a_comment(garden: Path) -> None:
    assert {key: read_description(garden)[key] for key in PROPOSALS} == {
        **PROPOSALS,
        "quality": {**PROPOSALS["quality"], "ssim": None},  # type: ignore[dict-item]
    }
    lines = (garden / "scene.yaml").read_text().splitlines()
    figures = [line for line in lines if line.startswith("  ") and "#" not in line]
    assert len(figures) == 4 and all("#" in line for line in lines if line not in figures)


def test_a_folder_states_everything_that_a_training_needs(garden: Path, tmp_path: Path) -> None:
    cfg = load_config([f"scene={garden}", *SMALL])
    assert cfg.robot.height == cfg.task.motion.height == HEIGHT
    assert (cfg.task.motion.lower, cfg.task.motion.upper) == ([-1.0, -1.5], [1.0, 1.5])
    assert (cfg.task.motion.step, cfg.collision.occupancy.resolution) == (0.5, 0.06)
    assert cfg.collision.occupancy.density.cutoff == 0.8
    assert (cfg.task.goal, cfg.landmarks.object) == ([0.5, 1.0, 0.0], [0.75, 1.0, 0.5])
    save_config(cfg, tmp_path)
    assert run_config(tmp_path) == load_config([f"scene={garden.absolute()}", *SMALL])


@pytest.mark.parametrize("task", ["pointnav", "imagenav"])
def test_a_task_that_measures_its_goal_in_metres_keeps_its_own_steps(garden: Path, task: str) -> None:
    motion = load_config([f"scene={garden}", f"task={task}", *SMALL]).task.motion
    assert (motion.step, motion.spacing) == (0.25, 0.5)
    assert load_config([f"scene={garden}", f"task={task}", "task.motion.step=0.1", *SMALL]).task.motion.step == 0.1


def trained(cfg: DictConfig, folder: Path) -> int:
    """Train for a few batches, and return the number of frames that the policy was trained on."""
    world = build_world(cfg)
    assert len(world.plan.start_rows) > 10
    trainer = build_trainer(cfg, world, folder)
    trainer.fit()
    return trainer.ppo.frames


def test_a_policy_trains_in_a_scene_folder_without_further_overrides_of_the_scene(garden: Path, tmp_path: Path) -> None:
    few = ["collector.total_frames=256", "collector.frames_per_batch=128", "env.num_envs=16", "logger.video=false"]
    arguments = command_line("train", [f"scene={garden}/", *SMALL, *few, "logger.num_test_episodes=8"])
    assert trained(load_config(arguments), tmp_path) == 256


def test_the_command_line_overrides_the_scene_folder(garden: Path) -> None:
    own = ["robot.height=0.7", "landmarks.goal=[0.0,1.0,90.0]", "task.motion.lower=[-0.5,-0.5]"]
    for overrides in ([*own, f"scene={garden}"], [f"scene={garden}", *own]):
        cfg = load_config(command_line("train", overrides))
        assert (cfg.robot.height, cfg.task.goal, cfg.task.motion.lower) == (0.7, [0.0, 1.0, 90.0], [-0.5, -0.5])
        assert cfg.task.motion.upper == [1.0, 1.5]


def test_a_folder_given_as_scene_path_proposes_the_same_values(garden: Path) -> None:
    short, full = (load_config(said) for said in ([f"scene={garden}"], ["scene=file", f"scene.path='{garden}'"]))
    assert short == full
    assert load_config(with_scene_paths([f"scene={garden}"])) == short


@pytest.mark.parametrize("task", ["circle", "fps", "sim2real", "snake", "drive", "grid,circle"])
def test_a_task_takes_only_the_proposals_for_its_own_keys(task: str, garden: Path) -> None:
    proposed = with_scene_paths([f"task={task}", f"scene={garden}"])[:-3]  # without the words given; "scene" became two
    keys = {override.partition("=")[0] for override in proposed}
    solid = {"collision.occupancy.resolution", "collision.occupancy.density.cutoff"}
    always = {"robot.height", "landmarks.goal", "landmarks.object"} | solid
    bounds = set() if "circle" in task else {"task.motion.lower", "task.motion.upper"}
    assert always | bounds <= keys and keys - always - bounds <= {"task.motion.step", "task.motion.spacing"}
    for one in task.split(","):
        load_config([*proposed, f"task={one}", "scene=file", f"scene.path={garden}"])


def test_a_motion_chosen_on_the_command_line_takes_the_bounds(garden: Path) -> None:
    cfg = load_config(["task=fps", "motion@task.motion=drive", f"scene={garden}"])
    assert cfg.task.motion.upper == [1.0, 1.5] and "time_step" in cfg.task.motion


def test_a_folder_that_proposes_nothing_changes_nothing(garden: Path) -> None:
    (garden / "scene.yaml").write_text("splat: splat.ply\nrobot_height: null\n")
    assert with_scene_paths([f"scene={garden}"]) == ["scene=file", f"scene.path='{garden}'"]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            "robot_height: ${oc.env:HOME}",
            r"robot_height: expected a positive, finite number of metres, got '\$\{oc.env:HOME\}'",
        ),
        ("robot_height: -1.0", "robot_height: expected a positive, finite number of metres, got -1.0"),
        ("robot_height: .inf", "robot_height: expected a positive, finite number of metres, got inf"),
        ("voxel_size: true", "voxel_size: expected a positive, finite number of metres, got True"),
        ("cutoff: 1.0", "cutoff: expected a fraction of the light above 0 and below 1, got 1.0"),
        (
            "step: {_target_: os.system}",
            "step: expected a positive, finite number of metres, got {'_target_': 'os.system'}",
        ),
        ("goal: [1.0, 2.0]", r"goal: expected \[x, y, yaw\].* got \[1.0, 2.0\]"),
        ("object: ['${seed}', 0, 0]", r"object: expected \[x, y, z\] in metres"),
        ("walk: [[1, 0], [0, 1]]", "walk: .*the lower corner first, got"),
        ("walk: [0, 1]", "walk: expected"),
        ("metric: 1", "metric: expected true or false, got 1"),
        ("quality: {psnr: {_target_: os.system}}", "quality: expected measures by name"),
        ("collector: {total_frames: 1}", "expected the keys splat, .*quality, got collector"),
    ],
)
def test_invalid_values_in_a_scene_folder_are_refused(line: str, message: str, garden: Path) -> None:
    (garden / "scene.yaml").write_text(f"splat: splat.ply\n{line}\n")
    with pytest.raises(ValueError, match=message):
        load_config([f"scene={garden}"])
    with pytest.raises(SystemExit, match=message):
        command_line("train", [f"scene={garden}"])
    key, _, value = line.partition(": ")
    if key == "robot_height":
        with pytest.raises(ValueError, match="robot_height"):
            write_description(garden, "splat.ply", "x", {}, ((0, 0, 0), (1, 1, 1)), True, {key: value})


@pytest.mark.parametrize(
    ("metric", "up", "scale", "said"),
    [
        ("true", "null", "null", ["up and its scale may be far off; see the capture's report.html"]),
        ("true", "null", "0.05", ["up may be far off; see the capture's report.html"]),
        ("false", "1.5", "null", ["not metric: its scale is unknown or only a guess, so its lengths are not metres"]),
        ("true", "1.5", "0.05", []),
    ],
)
def test_a_scene_whose_capture_does_not_know_how_far_up_or_the_scale_is_off_causes_a_warning(
    garden: Path, metric: str, up: str, scale: str, said: list[str]
) -> None:
    quality = f"quality:\n  up_error_deg: {up}\n  scale_error: {scale}\n"
    (garden / "scene.yaml").write_text(f"splat: splat.ply\nmetric: {metric}\n{quality}")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_scene(garden)
    assert [str(warning.message) for warning in caught] == [f"{garden}: {each}" for each in said]


def test_a_scene_of_unknown_scale_causes_a_warning(garden: Path) -> None:
    (garden / "scene.yaml").write_text("splat: splat.ply\nmetric: false\n")
    with pytest.warns(UserWarning, match="not metric: its scale is unknown"):
        scene = read_scene(garden)
    assert torch.isfinite(scene.gaussians.means).all()
