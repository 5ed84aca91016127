"""End-to-end tests of ``splatrl-record``, ``splatrl-replay`` and ``splatrl-train demos=``."""

import csv
import json
import re
import shutil
import sys
import warnings
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from omegaconf import DictConfig

from splatrl.building import build_trainer, build_world
from splatrl.commands import record, replay
from splatrl.configuration import load_config
from splatrl.datasets import Demonstrations, planner_episodes, read_demonstrations
from splatrl.envs.world import World
from splatrl.made_with import check_made_with
from splatrl.physics.robots import mjcf_path
from splatrl.scenes import write_gaussians
from splatrl.training import Cloner, load_checkpoint
from splatrl.training.history import unpacked
from tests.commands.test_train import SETTINGS, command, finish
from tests.tiny import tiny_gaussians, tiny_overrides

EPISODES = 12


def call(module: ModuleType, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", ["splatrl", *arguments])
    module.main()


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    return tiny_overrides(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def demos(scene: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "new" / "demos"
    with pytest.MonkeyPatch.context() as patch:
        call(record, patch, *scene, "by=planner", f"episodes={EPISODES}", f"out={folder}")
    return folder


def test_recorded_demonstrations_replay_byte_for_byte(
    demos: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = len(read_demonstrations(demos))
    assert sorted(path.name for path in demos.iterdir()) == ["config.yaml", "demonstrations.json", "memmap"]
    assert json.loads((demos / "demonstrations.json").read_text())["by"] == "planner"
    call(replay, monkeypatch, f"demos={demos}")
    told = capsys.readouterr().out
    same = "states, actions, rewards and outcomes are identical, byte for byte"
    assert f"{demos}: {EPISODES} episodes, {frames} frames: {same}" in told
    assert f"views are identical in {frames} of {frames} frames" in told


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder that nobody can write to")
def test_the_working_directory_need_not_be_writable(
    scene: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir("/proc")
    call(record, monkeypatch, *scene, "episodes=1", f"out={tmp_path / 'demos'}")
    assert len(read_demonstrations(tmp_path / "demos").starts) == 1


def test_the_same_frames_are_written_for_lerobot(
    scene: list[str], tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    pytest.importorskip("pyarrow", reason="needs the extra lerobot")
    folders = [f"out={tmp_path / 'demos'}", f"lerobot={tmp_path / 'lerobot'}"]
    drive = [*tiny_overrides(tmp_path_factory.mktemp("room"), "drive"), "task.motion.spacing=0.5"]
    call(record, monkeypatch, *drive, "episodes=3", *folders)
    facts = json.loads((tmp_path / "lerobot" / "meta" / "info.json").read_text())
    assert facts["features"]["action"]["names"] == ["forward (m/s)", "turn (rad/s)"]
    assert facts["total_frames"] == len(read_demonstrations(tmp_path / "demos"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["demos", "lerobot"]
    with pytest.raises(SystemExit, match=r"lerobot: expected a new folder, got .* already exists"):
        call(record, monkeypatch, *scene, "episodes=3", f"out={tmp_path / 'other'}", folders[1])
    (tmp_path / "other.takes").mkdir()
    with pytest.raises(SystemExit, match=r"already exists; remove it if it is of the interrupted recording in .*takes"):
        call(record, monkeypatch, *scene, "episodes=3", f"out={tmp_path / 'other'}", folders[1])


def test_a_scene_that_has_changed_since_the_recording_is_mentioned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = tiny_overrides(tmp_path)
    call(record, monkeypatch, *scene, "by=planner", "episodes=2", f"out={tmp_path / 'demos'}")
    demos, said = f"demos={tmp_path / 'demos'}", "demos: recorded in another scene than tiny as it is now"
    cfg = load_config([*scene, *SETTINGS, demos])
    with warnings.catch_warnings():
        warnings.filterwarnings("error", said)
        call(replay, monkeypatch, demos)
        build_trainer(cfg, build_world(cfg), tmp_path)
    (splat,) = tmp_path.glob("*.ply")
    faded = tiny_gaussians()
    faded.sh *= 0.9
    write_gaussians(splat, faded)
    with pytest.warns(UserWarning, match=said):
        call(replay, monkeypatch, demos)
    with pytest.warns(UserWarning, match=said):
        build_trainer(cfg, build_world(cfg), tmp_path)


def test_demonstrations_are_replayed_where_their_scene_has_moved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    call(record, monkeypatch, *tiny_overrides(tmp_path), "by=planner", "episodes=2", f"out={tmp_path / 'demos'}")
    (splat,) = tmp_path.glob("*.ply")
    (tmp_path / "home").mkdir()
    splat.rename(tmp_path / "home" / "room.ply")
    monkeypatch.chdir(tmp_path / "home")
    with pytest.raises(SystemExit, match=r"expected a file or a folder, .*; if it has moved, type scene\.path="):
        call(replay, monkeypatch, f"demos={tmp_path / 'demos'}")
    call(replay, monkeypatch, f"demos={tmp_path / 'demos'}", "scene.path=room.ply")
    assert "are identical, byte for byte" in capsys.readouterr().out


def test_a_replay_that_differs_ends_with_an_error(demos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    changed = tmp_path / "changed"
    shutil.copytree(demos, changed)
    path = changed / "memmap" / "next" / "state.memmap"
    content = np.fromfile(path, np.int64)
    content[0] += 1
    content.tofile(path)
    with pytest.raises(SystemExit, match=r"frames do not replay as recorded\nnext\.state: differs in 1 frames"):
        call(replay, monkeypatch, f"demos={changed}")


@pytest.mark.parametrize(
    ("module", "arguments", "message"),
    [
        (record, ["by=me", "out={new}"], "splatrl-record: by: expected planner, teacher or keys, got me"),
        (record, ["episodes=0", "out={new}"], "splatrl-record: episodes: expected a whole number"),
        (record, ["out={demos}"], "splatrl-record: out: expected a new folder, got .* already exists"),
        (record, ["out={new}", "lerobot={new}"], "lerobot: expected a folder separate from out=.*new, got"),
        (record, ["out={new}", "lerobot={new}/other"], "splatrl-record: lerobot: expected a folder separate from out="),
        (record, ["out={new}/demos", "lerobot={new}"], "splatrl-record: lerobot: expected a folder separate from out="),
        (record, [], "splatrl-record: out: expected a value, got none"),
        (record, ["out={new}", "episode=3"], "episode: no such key, did you mean episodes"),
        (replay, ["demos={new}"], "splatrl-replay: .*: expected a folder of demonstrations"),
        (replay, [], "splatrl-replay: demos: expected a value, got none"),
    ],
)
def test_invalid_arguments_are_reported_and_nothing_is_written(
    module: ModuleType,
    arguments: list[str],
    message: str,
    demos: Path,
    scene: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    given = [each.format(new=tmp_path / "new", demos=demos) for each in arguments]
    with pytest.raises(SystemExit, match=message):
        call(module, monkeypatch, *(scene if module is record else []), *given)
    assert "record:" not in capsys.readouterr().err, "the world is not built first, and no bar is drawn"
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("robot.image_width=15", "robot.image_width, robot.image_height: expected even numbers, got 15 and 12"),
        (None, r"the LeRobot format needs pyarrow: pip install 'splatrl\[lerobot\]'"),
    ],
)
def test_an_impossible_lerobot_export_is_refused_before_anything_is_recorded(
    change: str | None, message: str, scene: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if change is None:
        monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setattr(record, "scripted", lambda *_: pytest.fail("something was recorded"))
    folders = [f"out={tmp_path / 'demos'}", f"lerobot={tmp_path / 'lerobot'}"]
    with pytest.raises(SystemExit, match=message):
        call(record, monkeypatch, *scene, *folders, *([change] if change else []))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("task", "by", "message"),
    [
        (
            "push",
            "planner",
            "goal states, got Push; by=teacher records the task's own teacher; by=keys records what you drive",
        ),
        ("strides", "planner", "Strides; by=teacher records the task's own teacher"),
        ("snake", "planner", "Snake; by=keys records what you drive"),
        ("snake", "teacher", "by=teacher: expected a task with a teacher of its own, got Snake; by=keys records .*"),
        ("fps", "teacher", "Fps; by=planner records shortest paths; by=keys records what you drive"),
        ("strides", "keys", "task: expected actions that keys can express, .* got 12 numbers per action"),
    ],
)
def test_a_task_that_cannot_be_demonstrated_is_refused_before_the_world_is_built(
    task: str, by: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if task in ("push", "strides"):
        pytest.importorskip("mujoco", reason="needs the extra physics")
    monkeypatch.setattr(record, "build_one_world", lambda _: pytest.fail("the world was built"))
    with pytest.raises(SystemExit, match=f"{message}$"):
        call(record, monkeypatch, f"task={task}", f"by={by}", f"out={tmp_path / 'demos'}")


@pytest.mark.parametrize("task", ["push", "pointnav"])
def test_a_teacher_that_cannot_act_is_refused_before_the_world_is_built(
    task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record, "build_one_world", lambda _: pytest.fail("the world was built"))
    change, message = "transforms/skip=four", "by=teacher: expected transforms/skip=none, .* got actions of 4 steps$"
    speeds = []
    if task == "push":  # torques in place of velocities
        pytest.importorskip("mujoco", reason="needs the extra physics")
        text = mjcf_path("wheels").read_text()
        (tmp_path / "torques.xml").write_text(re.sub(r"<velocity ([^>]*)kv=\S+", r"<motor \1", text))
        change, message = f"robot.path={tmp_path / 'torques.xml'}", "by=teacher: expected a task with a teacher"
        speeds = ["task.motion.linear=[-0.25,0.5]", "task.motion.angular_deg=90"]
    with pytest.raises(SystemExit, match=message):
        call(record, monkeypatch, f"task={task}", "by=teacher", f"out={tmp_path / 'demos'}", change, *speeds)


def test_a_recording_whose_folder_was_taken_in_the_meantime_gets_another_folder(
    scene: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, walk = tmp_path / "demos", record.scripted

    def meanwhile(cfg: DictConfig, world: World) -> Demonstrations:
        (out / "of another").mkdir(parents=True)
        return walk(cfg, world)

    monkeypatch.setattr(record, "scripted", meanwhile)
    call(record, monkeypatch, *scene, f"out={out}", "episodes=2")
    assert [path.name for path in out.iterdir()] == ["of another"]
    assert len(read_demonstrations(tmp_path / "demos-2").starts) == 2
    assert f"{out}-2: 2 episodes" in capsys.readouterr().out


def test_a_training_starts_with_the_demonstrations_and_counts_their_frames(
    demos: Path, scene: list[str], tmp_path: Path
) -> None:
    frames = len(read_demonstrations(demos))
    folder = tmp_path / "run"
    quick = ["evaluation.starts=8", "logger.video=false", f"hydra.run.dir={folder}"]
    finish(command("train", *scene, *SETTINGS, f"demos={demos}", *quick))
    with (folder / "progress.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    batches = (1280 - frames) // 128
    assert [int(row["frames"]) for row in rows] == [frames + 128 * number for number in range(batches + 1)]
    assert float(rows[0]["loss_cloning"]) < 1.79 and rows[0]["test_success"] and not rows[0]["success"]
    assert rows[1]["success"] and not rows[1]["loss_cloning"]


def test_a_number_of_demonstrations_is_recorded_by_the_planner(scene: list[str], tmp_path: Path) -> None:
    settings = ["demos=5", "cloning.epochs=1", "dagger.rounds=2", "dagger.frames_per_round=96", "dagger.epochs=1"]
    cfg = load_config([*scene, *SETTINGS, *settings, "seed=3", "collector.total_frames=512"])
    world = build_world(cfg)
    trainer = build_trainer(cfg, world, tmp_path)
    trainer.fit()
    frames = len(planner_episodes(world, 5, seed=3))
    assert [row["frames"] for row in trainer.history[:4]] == [frames, frames + 96, frames + 192, frames + 320]
    assert all("loss_cloning" in row for row in trainer.history[:3])
    assert "test_success" in trainer.history[0]  # later tests are as frequent as those of PPO
    assert "loss_cloning" not in trainer.history[3]


def test_a_tasks_own_teacher_is_recorded_replayed_and_imitated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    task, demos = tiny_overrides(tmp_path, "imagenav"), tmp_path / "demos"
    call(record, monkeypatch, *task, "task.max_steps=60", "by=teacher", "episodes=3", "seed=2", f"out={demos}")
    assert json.loads((demos / "demonstrations.json").read_text())["by"] == "teacher"
    call(replay, monkeypatch, f"demos={demos}")
    assert "are identical, byte for byte" in capsys.readouterr().out
    frames, history = len(read_demonstrations(demos)), []
    for shown in (f"demos={demos}", "demos=3"):
        budget = f"collector.total_frames={frames + 128}"
        cfg = load_config([*task, "task.max_steps=60", *SETTINGS, "cloning.epochs=1", shown, "seed=2", budget])
        trainer = build_trainer(cfg, build_world(cfg), tmp_path / "run")
        trainer.fit()
        history.append([(row["frames"], row.get("loss_cloning")) for row in trainer.history])
    assert history[0] == history[1], "a number records the same episodes"
    assert [row[0] for row in history[0]] == [frames, frames + 128]


def test_imitation_may_use_up_all_frames(scene: list[str], tmp_path: Path) -> None:
    settings = ["dagger.rounds=3", "dagger.frames_per_round=96", "dagger.epochs=1", "collector.total_frames=288"]
    trainer = build_trainer(cfg := load_config([*scene, *SETTINGS, *settings]), build_world(cfg), tmp_path)
    trainer.fit()
    assert [row["frames"] for row in trainer.history] == [96, 192, 288]
    assert load_checkpoint(tmp_path / "checkpoints" / "last.pt")["ppo"]["frames"] == 288


@pytest.fixture(scope="module")
def taught(demos: Path, scene: list[str], tmp_path_factory: pytest.TempPathFactory) -> tuple[DictConfig, World, Path]:
    """An uninterrupted training that starts with imitation: its config, its world and its run folder."""
    settings = [
        f"demos={demos}",
        "cloning.epochs=2",
        "dagger.rounds=2",
        "dagger.frames_per_round=64",
        "dagger.epochs=2",
        "dagger.last_epochs=2",
    ]
    cfg = load_config([*scene, *SETTINGS, *settings, "collector.total_frames=768"])
    world, folder = build_world(cfg), tmp_path_factory.mktemp("taught")
    build_trainer(cfg, world, folder).fit()
    return cfg, world, folder


@pytest.mark.parametrize(
    ("step", "rows"),
    [
        pytest.param(1, 0, marks=pytest.mark.slow),  # in the first pass over the demonstrations
        (2, 0),  # in the second
        (4, 1),  # in the first pass of a DAgger round
        pytest.param(11, 2, marks=pytest.mark.slow),  # in the second
        (17, 3),  # in the last epochs, when all frames are known
    ],
)
def test_a_training_killed_during_imitation_continues_with_the_same_bytes(
    step: int,
    rows: int,
    taught: tuple[DictConfig, World, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    cfg, world, whole = taught
    steps, really = list[int](), Cloner._step

    def counted(cloner: Cloner, frames: dict[str, torch.Tensor]) -> torch.Tensor:
        steps.append(len(steps) + 1)
        if steps[-1] == step:
            raise KeyboardInterrupt
        return really(cloner, frames)

    monkeypatch.setattr(Cloner, "_step", counted)
    monkeypatch.setattr("splatrl.training.trainer.PAUSE", 0.0)
    killed = build_trainer(cfg, world, tmp_path)
    with pytest.raises(KeyboardInterrupt):
        killed.fit()
    assert "stopped within imitation, which goes on where it was saved" in capsys.readouterr().err
    saved = load_checkpoint(tmp_path / "checkpoints" / "last.pt")
    assert len(unpacked(saved["history"])) == rows
    if rows == 1:  # two rounds of 64 frames are to come
        less, used = build_trainer(cfg, world, tmp_path, check_made_with), saved["ppo"]["frames"]
        less.ppo.total_frames = used + 127
        with pytest.raises(ValueError, match=f"at least {used + 128} to continue with imitation, after {used}, got"):
            less.fit()
    torch.manual_seed(99)
    again = build_trainer(cfg, world, tmp_path, check_made_with)
    again.fit()
    assert len(steps) <= 18 + 3, "only the pass in which it was stopped is repeated"
    one, other = (load_checkpoint(run / "checkpoints" / "last.pt") for run in (whole, tmp_path))
    assert one["ppo"]["frames"] == other["ppo"]["frames"] > 0
    assert all(torch.equal(value, other["ppo"]["model"][key]) for key, value in one["ppo"]["model"].items())
    rows = [[row | {"seconds": 0.0} for row in unpacked(state["history"])] for state in (one, other)]
    assert repr(rows[0]) == repr(rows[1])  # nan equals nan
    assert not (tmp_path / "imitation").exists()


def test_demonstrations_are_not_read_again_after_imitation(
    taught: tuple[DictConfig, World, Path], tmp_path: Path
) -> None:
    cfg, world, whole = taught
    shutil.copytree(whole, tmp_path / "run")
    changed = cfg.copy()
    changed.demos = str(tmp_path / "nowhere")
    trainer = build_trainer(changed, world, tmp_path / "run", check_made_with)
    assert not trainer.prepare and trainer.ppo.frames > 0
    with pytest.raises(FileNotFoundError, match="nowhere: expected a folder of demonstrations"):
        build_trainer(changed, world, tmp_path / "new")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("robot.image_width=24", "demos: expected images of 24 × 12 .* got 16 × 12"),
        (
            "collector.total_frames=128",
            "collector.total_frames: expected at least .* of demos and 256 frames of dagger",
        ),
        ("demos=nowhere", "nowhere: expected a folder of demonstrations"),
        ("demos=0", "demos: expected a whole number from 1 to 1000000, got 0"),
        ("demos=true", "demos: expected a whole number"),
        ("dagger.frames_per_round=100", "dagger.frames_per_round: expected a multiple of env.num_envs = 16, got 100"),
    ],
)
def test_demonstrations_that_do_not_fit_are_refused(
    change: str, message: str, demos: Path, scene: list[str], tmp_path: Path
) -> None:
    shown = [] if "demos=" in change else [f"demos={demos}"]
    cfg = load_config([*scene, *SETTINGS, *shown, "dagger.rounds=2", change])
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        build_trainer(cfg, build_world(cfg), tmp_path / "run").fit()
