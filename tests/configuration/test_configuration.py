"""Configs compose, build what they describe, and explain what is wrong with them."""

from itertools import zip_longest
from pathlib import Path
from typing import Any, NoReturn

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig
from torchrl.envs import EnvBase, RewardScaling

from splatrl.bodies import Sphere
from splatrl.building import build_trainer, build_world, make_env
from splatrl.building.places import constructor
from splatrl.collision import CudaChecker, NativeChecker, NoChecker
from splatrl.commands.evaluate import evaluate_run
from splatrl.configuration import (
    UserError,
    check_config,
    command_line,
    conf_dir,
    load_config,
    place_configs,
)
from splatrl.configuration.search_path import group_node
from splatrl.envs.nesting import layers
from splatrl.envs.tasks.base import Anywhere, Outcome, Step, Verdict
from splatrl.envs.tasks.module import TaskModule
from splatrl.envs.transforms import FrameStack, PoseNoise
from splatrl.motions import LatticeMotion
from splatrl.renderers import (
    CudaRenderer,
    DeviceLatticeRenderer,
    GsplatRenderer,
    LatticeRenderer,
    NativeRenderer,
    ReferenceRenderer,
)
from tests.envs.devices import pretend_device
from tests.tiny import LONG_STEPS, WALKING, tiny_overrides

TASKS = sorted((conf_dir() / "task").glob("*.yaml"))
SCENES = sorted((conf_dir() / "scene").glob("*.yaml"))
NOT_OF_TRAIN = {"scene", "task", "experiment", "launcher"}
OF_GPUS = {Path("renderer/gsplat")}
OPTIONS = sorted(
    path.relative_to(conf_dir()).with_suffix("")
    for path in conf_dir().rglob("*/*.yaml")
    if path.relative_to(conf_dir()).parts[0] not in NOT_OF_TRAIN
)
SENSORS = {option for option in OPTIONS if option.parent == Path("sensors")}
TASK_OF = {"transforms/sprite/apple": "apple", "motion/drive": "fps", "motion/forward": "fps", "motion/orbit": "circle"}
TASK_OF |= {
    f"{group}/{option}": "pointnav"
    for group, option in (
        ("robot", "round"),
        ("motion", "navigate"),
        ("rewards", "navigation"),
        ("sensors", "pointgoal"),
        ("sensors", "imagegoal"),
    )
}
TASK_OF |= {option: "push" for option in ("motion/physics", "robot/mjcf", "rewards/push", "sensors/ego_motion")}
TASK_OF |= {"motion/strides": "strides", "rewards/strides": "strides"}
TASK_OF |= {"motion/walk": "walk", "rewards/course": "walk"}
TASK_OF |= {f"sensors/{name}": "walk" for name in ("felt", "feet", "imu", "joints", "velocity")}
"""The task for each option that does not work with grid."""
COARSE = ["task.motion.time_step=0.4", "task.motion.spacing=0.25", "task.motion.headings=8"]
"""A coarse grid on which to plan the paths of a driving robot."""
NEEDS = {"robot/mjcf": ["robot.path=wheels"], "motion/drive": COARSE}
"""Overrides without which an option does not work, or is slow."""
PACKAGES = {"motion": "motion@task.motion", "rewards": "rewards@task.rewards"}
"""Command-line names of the groups whose package does not follow from their name."""


def side_by_side() -> list[tuple[str, list[Path]]]:
    """Combine options that work with the same task, one per group, so that few envs contain every option once.

    Options named ``none`` are combined with one another, so that they disable no other option.
    """
    by_task: dict[str, dict[Path, list[Path]]] = {}
    for option in sorted(OPTIONS, key=lambda option: option.name != "none"):
        if option not in OF_GPUS | SENSORS:
            task = TASK_OF.get(option.as_posix(), "grid")
            by_task.setdefault(task, {}).setdefault(option.parent, []).append(option)
    rounds = [(task, zip_longest(*groups.values())) for task, groups in by_task.items()]
    return [(task, [option for option in chosen if option]) for task, each in rounds for chosen in each]


@pytest.mark.parametrize(
    ("task", "options"),
    side_by_side(),
    ids=lambda value: value if isinstance(value, str) else "+".join(map(str, value)),
)
def test_every_option_of_every_group_builds_an_env_that_steps(task: str, options: list[Path], tmp_path: Path) -> None:
    chosen = []
    for option in options:
        group = PACKAGES.get(str(option.parent), option.parent.as_posix())
        chosen += [f"{group}={option.name}", *NEEDS.get(option.as_posix(), [])]
    env = make_env([*tiny_overrides(tmp_path, task), *chosen], batch_size=[2])
    assert env.rollout(2)["next", "reward"].shape[0] == 2


@pytest.mark.parametrize("task", sorted({TASK_OF.get(option.as_posix(), "grid") for option in SENSORS}))
def test_every_sensor_is_read_in_an_env_that_steps(task: str, tmp_path: Path) -> None:
    names = [option.name for option in sorted(SENSORS) if TASK_OF.get(option.as_posix(), "grid") == task]
    env = make_env([*tiny_overrides(tmp_path, task), f"sensors=[{','.join(names)}]"], batch_size=[2])
    first = env.reset()
    assert env.rollout(2)["next", "reward"].shape[0] == 2
    for name in names:
        node = group_node("sensors", name)
        read = {*node.get("sensors", {}), *node.get("inputs", {})}
        assert read and all(len(first[key]) == 2 for key in read), name


def test_the_motion_and_the_rewards_of_a_task_can_be_replaced(tmp_path: Path) -> None:
    chosen = ["motion@task.motion=drive", "rewards@task.rewards=unit", "task.rewards.step=-0.5"]
    task = build_world(load_config([*tiny_overrides(tmp_path, "fps"), *chosen, *COARSE])).task
    assert type(task.motion).__name__ == "DriveMotion" and task.motion.upper.tolist() == [1.0, 1.5]
    assert task.outcome_rewards.tolist() == [-0.5, 1.0, -1.0, -1.0]


def test_an_option_that_runs_only_on_gpus_is_refused_on_a_cpu(tmp_path: Path) -> None:
    for option in OF_GPUS:
        chosen = [*tiny_overrides(tmp_path), f"{option.parent}={option.name}", "device=cpu"]
        with pytest.raises(ValueError, match=f"{option.parent}: expected device=cuda for this choice, got device=cpu"):
            build_world(load_config(chosen))


def test_an_option_that_runs_only_on_cpus_is_refused_on_a_gpu() -> None:
    with pytest.raises(ValueError, match="collision: expected device=cpu for this choice, got device=cuda:1"):
        constructor(load_config(["collision=fcl"]), "collision", torch.device("cuda:1"))


@pytest.mark.parametrize(
    ("overrides", "cpu", "cuda"),
    [
        (["renderer=auto"], NativeRenderer, CudaRenderer),
        (["renderer=reference"], ReferenceRenderer, ReferenceRenderer),
        (["renderer=gsplat"], None, GsplatRenderer),
        (["collision=auto"], NativeChecker, CudaChecker),
        (["collision=none"], NoChecker, NoChecker),
    ],
)
def test_a_group_has_a_constructor_for_each_kind_of_device(overrides: list[str], cpu: type | None, cuda: type) -> None:
    group = overrides[0].split("=")[0]
    cfg = load_config([*overrides, "device=cuda:1"])
    made = constructor(cfg, group, torch.device("cuda:1"))
    assert made.func is cuda
    assert made.keywords.get("device", "cuda:1") == "cuda:1"
    if cpu is not None:
        assert constructor(cfg, group, torch.device("cpu")).func is cpu


def test_the_settings_of_a_renderer_apply_on_every_device() -> None:
    said = {"antialiased": False, "background": [0.5, 0.0, 1.0]}
    for name, own in (("auto", {"tolerance": 0.25}), ("reference", {}), ("gsplat", {})):
        values = {**said, **own}
        cfg = load_config([f"renderer={name}", *(f"renderer.{key}={value}" for key, value in values.items())])
        for kind in ("cpu", "cuda"):
            if cfg.renderer[kind] is not None:
                keywords = constructor(cfg, "renderer", torch.device(kind)).keywords
                assert {key: keywords[key] for key in values} == values, (name, kind)


def test_a_choice_without_a_constructor_for_any_device_is_refused_by_its_key(tmp_path: Path) -> None:
    cfg = load_config(tiny_overrides(tmp_path))
    cfg.renderer.cache = {"max_bytes": 5}
    with pytest.raises(ValueError, match=r"renderer\.cache: expected a constructor for cpu or cuda, got max_bytes"):
        constructor(cfg, "renderer.cache", torch.device("cpu"))


def test_views_are_cached_on_each_kind_of_device_unless_the_cache_is_disabled(tmp_path: Path) -> None:
    overrides = tiny_overrides(tmp_path)
    cfg = load_config([*overrides, "renderer.cache.max_bytes=5"])
    for kind, expected in (("cpu", LatticeRenderer), ("cuda", DeviceLatticeRenderer)):
        made = constructor(cfg, "renderer.cache", torch.device(kind))(None)
        assert type(made) is expected and made.max_bytes == 5
    kept = build_world(load_config(overrides)).drawing.renderer
    assert isinstance(kept, LatticeRenderer) and isinstance(kept.renderer, NativeRenderer)
    plain = build_world(load_config([*overrides, "renderer.cache=null"])).drawing.renderer
    assert isinstance(plain, NativeRenderer)


MINE = [
    "allow_targets=[torchrl]",
    "+transforms.mine._target_=torchrl.envs.RewardScaling",
    "+transforms.mine.loc=1.0",
    "+transforms.mine.scale=0.0",
]


@pytest.mark.parametrize(
    ("order", "kinds"),
    [
        ("[pose_noise,mine,appearance,stack]", [PoseNoise, RewardScaling, FrameStack]),
        ("[stack,mine,pose_noise]", [FrameStack, RewardScaling, PoseNoise]),  # a disabled transform needs no entry
    ],
)
def test_a_custom_transform_takes_its_place_in_the_order(order: str, kinds: list[type], tmp_path: Path) -> None:
    chosen = ["memory=stack", "transforms/pose_noise=uniform", *MINE, f"transforms.order={order}"]
    env = make_env([*tiny_overrides(tmp_path), *chosen], batch_size=[2])
    assert [type(transform) for transform in env.transform] == kinds
    rewards = env.rollout(2)["next", "reward"]
    torch.testing.assert_close(rewards, torch.ones_like(rewards), atol=1e-3, rtol=0)


def test_an_order_with_an_unknown_or_a_missing_transform_is_refused(tmp_path: Path) -> None:
    overrides = tiny_overrides(tmp_path)
    known = r"expected only names from pose_noise, latency, skip, appearance, stack, got stak"
    with pytest.raises(ValueError, match=rf"transforms\.order: {known}"):
        make_env([*overrides, "transforms.order=[pose_noise,stak]"])
    with pytest.raises(ValueError, match=r"transforms\.order: expected an entry for mine, got \['pose_noise', .*\]"):
        make_env([*overrides, *MINE])
    with pytest.raises(ValueError, match=r"transforms\.order: expected each name once, got stack more than once"):
        make_env([*overrides, "memory=stack", "transforms.order=[pose_noise,stack,stack]"])
    with pytest.raises(ValueError, match=r"transforms\.order: expected an entry for stack, got \[\]"):
        make_env([*overrides, "memory=stack", "transforms.order=[]"])


def test_a_task_moves_to_the_device_of_its_env_and_the_plan_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pretend_device(monkeypatch)
    world = build_world(load_config(tiny_overrides(tmp_path)))
    assert world.env(2, device="meta").task.goal.device.type == "meta"
    assert world.task.goal.device.type == world.plan.motion.moves.device.type == "cpu"


@pytest.mark.parametrize("path", TASKS, ids=lambda path: path.stem)
def test_every_task_builds_an_env_that_steps(path: Path, tmp_path: Path) -> None:
    steps = LONG_STEPS if path.stem in WALKING else ()
    env = make_env([*tiny_overrides(tmp_path, path.stem), *steps], batch_size=[2])
    assert env.rollout(2)["next", "reward"].shape[0] == 2


@pytest.mark.parametrize("path", TASKS, ids=lambda path: path.stem)
@pytest.mark.parametrize("robot", ["round", pytest.param("wheels", marks=pytest.mark.slow)])
def test_a_robot_that_is_typed_keeps_its_body_in_every_task(path: Path, robot: str) -> None:
    typed = load_config([f"task={path.stem}", f"robot={robot}"])
    assert typed.robot.body == load_config([f"robot={robot}"]).robot.body


def test_a_task_published_with_a_point_takes_a_sphere_too(tmp_path: Path) -> None:
    world = build_world(
        load_config([*tiny_overrides(tmp_path, "fps"), *LONG_STEPS, "robot=round", "robot.body.radius=0.1"])
    )
    assert world.robot.body == Sphere(0.1)


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_every_scene_composes_and_sets_the_goal_and_the_height(path: Path) -> None:
    several = {"many": ["scene.paths=[backyard]"], "yards": ["scene.count=1"]}
    cfg = place_configs(load_config([f"scene={path.stem}", *several.get(path.stem, [])]))[0]
    made = {"backyard": "splatrl.backyard", "many": "splatrl.backyard", "yard": "splatrl.yard", "yards": "splatrl.yard"}
    made |= {"town": "splatrl.town"}
    assert cfg.scene._target_ == made.get(path.stem, "splatrl.read_scene")
    if path.stem != "file":
        assert len(cfg.task.goal) == 3
        assert cfg.task.motion.height == cfg.robot.height > 0


def test_the_kitchen_has_the_settings_with_which_results_are_compared(shared_scenes: Path) -> None:
    world = build_world(load_config(["scene=kitchen", f"scene.path={shared_scenes / 'kitchen' / 'kitchen.spz'}"]))
    assert world.robot.body.size == (0.4, 0.4, 0.1)
    assert world.robot.height == 1.05
    assert world.task.motion.shape == (11, 11, 16)
    assert world.task.goal.tolist() == [0.4, 0.4, 0.0]
    assert len(world.plan.start_rows) > 500


def test_a_missing_value_is_named(tmp_path: Path) -> None:
    with pytest.raises(
        ValueError, match=r"scene\.path: expected a value, got none; type scene\.path=<splat file or folder>"
    ):
        build_world(load_config(["scene=kitchen"]))


def test_a_hydra_that_is_already_initialised_is_left_unchanged(tmp_path: Path) -> None:
    (tmp_path / "other.yaml").write_text("size: 3\n")
    assert not GlobalHydra.instance().is_initialized()
    with initialize_config_dir(str(tmp_path), version_base="1.3"):
        outer = GlobalHydra.instance().hydra
        assert load_config(["task=fps"]).task._target_ == "splatrl.envs.tasks.Fps"
        with pytest.raises(UserError):
            load_config(["task=nothing"])
        assert GlobalHydra.instance().hydra is outer
        assert compose("other", ["size=4"]).size == 4
    load_config()
    assert not GlobalHydra.instance().is_initialized()


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ("task=grid", r"overrides: expected a list of texts such as \['task=fps'\], got 'task=grid'"),
        ({"task": "grid"}, "overrides: expected a list of texts"),
        ([1], r"overrides: expected a list of texts .*, got \[1\]"),
        (3, "overrides: expected a list of texts"),
    ],
)
def test_anything_but_a_list_of_overrides_is_refused(overrides: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        load_config(overrides)


@pytest.mark.parametrize("typed", ["robot.fov=70", "ppo.gama=1", "task=nope", "grid", "task=[a", "task.max_steps=1,2"])
def test_the_library_refuses_an_override_in_the_words_of_the_command_line(typed: str) -> None:
    with pytest.raises(SystemExit) as said:
        command_line("train", [typed])
    with pytest.raises(ValueError, match=r"expected|no such key") as error:
        load_config([typed])
    assert f"splatrl-train: {error.value}" == said.value.code and "\n" not in str(error.value)


class Wander(TaskModule):
    """A task without a goal, which rewards every free step."""

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        hit = (step.move.free_fraction < 1).unsqueeze(1)
        return Verdict((~hit).float(), hit, torch.where(hit, Outcome.COLLISION, Outcome.RUNNING))


def aimless(folder: Path) -> DictConfig:
    """Return the config of a short training of the task above on the tiny lattice."""
    overrides = [one for one in tiny_overrides(folder) if not one.startswith("task.max_steps")]
    settings = {"total_frames": 256, "frames_per_batch": 128}
    return load_config(
        [
            *overrides,
            "~task.goal",
            "~task.rewards",
            "allow_targets=[tests]",
            "task._target_=tests.configuration.test_configuration.Wander",
            "task.max_steps=8",
            *(f"collector.{key}={value}" for key, value in settings.items()),
            "env.num_envs=16",
            "logger.num_test_episodes=8",
            "logger.video=false",
        ]
    )


def test_a_task_without_goal_states_is_planned_trained_and_evaluated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cfg = aimless(tmp_path)
    world = build_world(cfg)
    assert isinstance(world.task.motion, LatticeMotion)
    plan = world.plan
    assert plan.field is None and not plan.at_goal(plan.states).any()
    assert torch.equal(plan.start_rows, plan.free.nonzero().squeeze(1)) and 0 < len(plan.start_rows) < len(plan.free)
    build_trainer(cfg, world, tmp_path).fit()
    summary = evaluate_run(cfg, tmp_path, world)
    assert not {"step_spl", "step_spl_argmax", "mean_shortest"} & summary.keys()
    assert summary["success_rate"] == 0 and summary["collision_rate"] + summary["timeout_rate"] == 1
    assert 0 < summary["mean_return"] <= 8
    assert (tmp_path / "learning_curve.png").exists() and not (tmp_path / "starts.png").exists()
    said = capsys.readouterr().out
    assert "SPL" not in said and f"return {summary['mean_return']:.1f}" in said


def test_a_snake_is_tested_by_the_number_of_its_apples(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for module in ("start_maps", "training_figures"):
        monkeypatch.setattr(f"splatrl.evaluation.{module}.save_figure", lambda *_: None)
    settings = ["task.red_share=0.001", "task.reach=9.0", "env.num_envs=8", "logger.num_test_episodes=4"]
    settings += ["task.motion.step=0.25", "task.motion.angle_step_deg=45.0", "task.apples=2", "logger.video=false"]
    settings += ["collector.total_frames=128", "collector.frames_per_batch=128", "evaluation.starts=16"]
    cfg = load_config([*tiny_overrides(tmp_path, "snake"), *LONG_STEPS, *settings])
    world = build_world(cfg)
    trainer = build_trainer(cfg, world, tmp_path)
    trainer.fit()
    (row,) = trainer.history
    assert trainer.best == (row["test_success"], row["test_goals"]) and row["test_goals"] >= 2 * row["test_success"]
    summary = evaluate_run(cfg, tmp_path, world)
    assert summary["mean_goals"] > summary["success_rate"] and "step_spl" not in summary
    assert f"{summary['mean_goals']:.2f} goals per episode" in capsys.readouterr().out
    seeds: list[int] = []

    def begun(env: EnvBase, *_: object) -> NoReturn:
        seeds.append(layers(env)[0].generator.initial_seed())
        raise InterruptedError

    monkeypatch.setattr("splatrl.evaluation.evaluate.run_episodes", begun)
    for seed in (7, 8):  # which decides where further apples appear
        cfg.evaluation.seed = seed
        with pytest.raises(InterruptedError):
            evaluate_run(cfg, tmp_path, world)
    assert seeds == [7, 8]


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("logger.test_interval=0", r"logger\.test_interval: expected a whole number from 1 to \d+, got 0"),
        ("checkpoint.interval=0", r"checkpoint\.interval: expected a whole number from 1 to"),
        ("env.num_envs=abc", r"env\.num_envs: expected a whole number from 1 to \d+, got 'abc'"),
        ("env.num_envs=null", r"env\.num_envs: expected a whole number from 1 to \d+, got None"),
        ("collector.frames_per_batch=0", r"collector\.frames_per_batch: expected a whole number from 1 to"),
        ("seed=-1", r"seed: expected a whole number from 0 to \d+, got -1"),
        ("threads=0", r"threads: expected a whole number from 1 to 1024, got 0"),
        ("renderer.threads=0", r"renderer\.threads: expected a whole number from 1 to 1024, got 0"),
        ("evaluation.batch_size=2.5", r"evaluation\.batch_size: expected a whole number from 1 to \d+, got 2\.5"),
        ("robot.image_width=64.5", r"robot\.image_width: expected a whole number from 1 to 65536, got 64\.5"),
        ("task.max_steps=2.5", r"task\.max_steps: expected a whole number of at least 1, got 2\.5"),
        ("task.rewards.step=nan", r"task\.rewards\.step: expected a number from .*, got nan"),
        ("robot.fov_deg=180", r"robot\.fov_deg: expected a number from 1 to 179, got 180"),
        ("optim.lr=1e400", r"optim\.lr: expected a number of at least 0\.0, got inf"),
        ("network.pool=0", r"network\.pool: expected a whole number of at least 1, got 0"),
        ("network.features=0", r"network\.features: expected a whole number of at least 1, got 0"),
        ("network.channels=[16,0]", r"network\.channels: expected a whole number of at least 1, got 0"),
        ("network.channels=[16]", r"network\.channels: expected two numbers, got \[16\]"),
        ("curriculum.window=2.5", r"curriculum\.window: expected a whole number of at least 1, got 2\.5"),
        ("curriculum.first=1.5", r"curriculum\.first: expected a whole number of at least 1, got 1\.5"),
        ("curriculum.stride=0", r"curriculum\.stride: expected a whole number of at least 1, got 0"),
        ("curriculum.threshold=nan", r"curriculum\.threshold: expected a success rate in \(0, 1\], got nan"),
        ("evaluation.checkpoint=newest", r"evaluation\.checkpoint: expected one of last, best, got newest"),
    ],
)
def test_a_value_out_of_range_is_named_before_the_training_starts(override: str, message: str, tmp_path: Path) -> None:
    cfg = load_config([*tiny_overrides(tmp_path), override])
    with pytest.raises(Exception, match=message):  # Hydra wraps what constructors raise
        build_trainer(cfg, build_world(cfg), tmp_path)


def test_a_config_of_a_user_may_have_keys_of_its_own(tmp_path: Path) -> None:
    arguments = ["--config-dir", str(tmp_path), "--config-name", "mine", "mykey=4"]
    assert command_line("train", arguments) == arguments
    (tmp_path / "mine.yaml").write_text(
        f"hydra: {{searchpath: [{conf_dir().as_uri()}]}}\n"
        "defaults: [train, _self_]\nmykey: 3\nnetwork: {_target_: tests.configuration.test_configuration.Wander}\n"
    )
    with initialize_config_dir(str(tmp_path), version_base="1.3"):
        cfg = compose("mine", ["mykey=4"])
        assert cfg.mykey == 4
        check_config(cfg)  # a user's own config is trusted like ours
        assert GlobalHydra.instance().is_initialized()
    with pytest.raises(ValueError, match="expected a constructor that appears in conf/"):
        check_config(cfg)
