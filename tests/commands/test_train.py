"""End-to-end tests of training: the run folder, kills, resuming and evaluation."""

import contextlib
import json
import random
import shlex
import shutil
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import pytest
import torch
from hydra.errors import HydraException
from omegaconf import DictConfig

from splatrl.building import build_world
from splatrl.commands import evaluate, train
from splatrl.configuration import config_elsewhere, resumed_config, run_config, run_configs, words_of_place
from splatrl.configuration.elsewhere import TYPED
from splatrl.files import alone_in
from splatrl.made_with import check_made_with, made_with
from splatrl.runs import load_policy
from splatrl.scenes import write_gaussians
from splatrl.training import load_checkpoint
from tests.preloaded import Process, start
from tests.tiny import tiny_gaussians, tiny_overrides
from tests.two_rooms import in_both, two_rooms

SETTINGS = [
    "collector.total_frames=1280",
    "collector.frames_per_batch=128",
    "env.num_envs=16",
    "loss.mini_batch_size=64",
    "loss.ppo_epochs=2",
    "checkpoint.interval=256",
    "logger.test_interval=512",
    "logger.num_test_episodes=8",
    "evaluation.batch_size=32",
]
UNFILMED = [*SETTINGS, "logger.video=false"]


def command(module: str, *arguments: str) -> Process:
    return start("-m", f"splatrl.commands.{module}", *arguments)


def finish(process: Process) -> str:
    output, _ = process.communicate(timeout=900)  # seconds, for a busy machine
    assert process.returncode == 0, output
    return output


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    return tiny_overrides(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def run(scene: list[str], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    folder = tmp_path_factory.mktemp("run")
    return folder, finish(command("train", *scene, *SETTINGS, f"hydra.run.dir={folder}"))


def test_a_run_writes_results_pictures_and_checkpoints(run: tuple[Path, str]) -> None:
    folder, output = run
    files = {path.name for path in folder.iterdir()}
    pictures = {"learning_curve.png", "starts.png", "success_map.png", "rollouts.mp4"}
    assert pictures | {"config.yaml", "progress.csv", "evaluation.json", "checkpoints"} <= files
    assert not [path for path in folder.rglob("*") if "tmp" in path.name]
    assert "success 0." in output or "success 1." in output
    assert str(folder) in output
    summary = json.loads((folder / "evaluation.json").read_text())
    keys = {"success_rate", "success_rate_argmax", "step_spl", "collision_rate", "frames", "wall_seconds", "episodes"}
    assert keys <= summary.keys()
    assert summary["frames"] == 1280
    assert summary["episodes"] == summary["start_poses"] > 0
    assert (summary["evaluation"]["checkpoint"], summary["evaluation"]["repeats"]) == ("last", 1)
    assert 0 <= summary["step_spl"] <= summary["success_rate"] <= 1


def test_a_killed_run_resumes_as_if_nothing_had_happened(
    run: tuple[Path, str], scene: list[str], tmp_path: Path
) -> None:
    killed = command("train", *scene, *UNFILMED, f"hydra.run.dir={tmp_path}")
    last = tmp_path / "checkpoints" / "last.pt"
    while not (tmp_path / "progress.csv").exists() and killed.poll() is None:
        time.sleep(0.01)
    killed.kill()
    killed.wait()
    frames = load_checkpoint(last)["ppo"]["frames"]
    assert 0 < frames < 1280
    typed = (tmp_path / TYPED).read_text()
    finish(command("train", f"resume={tmp_path}"))
    assert (tmp_path / TYPED).read_text() == typed  # an evaluation elsewhere starts from it
    whole, resumed = (load_checkpoint(folder / "checkpoints" / "last.pt") for folder in (run[0], tmp_path))
    for key, value in whole["ppo"]["model"].items():
        assert torch.equal(value, resumed["ppo"]["model"][key]), key
    assert torch.equal(whole["ppo"]["torch_rng"], resumed["ppo"]["torch_rng"])
    assert torch.equal(whole["ppo"]["carried"]["pixels"], resumed["ppo"]["carried"]["pixels"])
    assert all(map(torch.equal, resumed["history"]["frames"], whole["history"]["frames"]))
    tables = [(folder / "progress.csv").read_text().splitlines() for folder in (run[0], tmp_path)]
    assert [untimed(table) for table in tables] == [untimed(tables[0])] * 2
    figures = [json.loads((folder / "evaluation.json").read_text()) for folder in (run[0], tmp_path)]
    assert figures[0] | {"wall_seconds": 0} == figures[1] | {"wall_seconds": 0}


def untimed(table: list[str]) -> list[list[str]]:
    """Return the rows of a table without the column of seconds."""
    place = table[0].split(",").index("seconds")
    return [cells[:place] + cells[place + 1 :] for cells in (line.split(",") for line in table)]


@pytest.mark.slow
@pytest.mark.parametrize("count", [100])
def test_kills_at_random_times_do_not_change_the_results(
    run: tuple[Path, str], scene: list[str], count: int, tmp_path: Path
) -> None:
    rng = random.Random(0)
    most = 2 * json.loads((run[0] / "evaluation.json").read_text())["wall_seconds"]  # doubled, to cover evaluation too
    for number in range(count):
        folder = tmp_path / str(number)
        process = command("train", *scene, *UNFILMED, f"hydra.run.dir={folder}")
        for _ in range(2):  # killed as it begins, trains, tests or evaluates; then killed again
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(rng.uniform(0.0, most))
            ended = process.poll() is not None
            process.kill()
            process.wait()
            most *= 0.8 if ended else 1.0 if (folder / "config.yaml").exists() else 1.15  # the machine's speed varies
            again = [f"resume={folder}"] if (folder / "config.yaml").exists() else [*scene, *UNFILMED]
            process = command("train", *again, *([] if "resume" in again[0] else [f"hydra.run.dir={folder}"]))
        finish(process)
        for name in ("last", "best"):
            whole, resumed = (load_checkpoint(one / "checkpoints" / f"{name}.pt")["ppo"] for one in (run[0], folder))
            assert whole["frames"] == resumed["frames"]
            assert all(torch.equal(value, resumed["model"][key]) for key, value in whole["model"].items())
        tables = [(one / "progress.csv").read_text().splitlines() for one in (run[0], folder)]
        assert untimed(tables[0]) == untimed(tables[1])
        figures = [json.loads((one / "evaluation.json").read_text()) for one in (run[0], folder)]
        assert figures[0] | {"wall_seconds": 0} == figures[1] | {"wall_seconds": 0}
        assert not list(folder.rglob("*.tmp"))


def test_ctrl_c_saves_and_says_how_to_continue(run: tuple[Path, str], scene: list[str], tmp_path: Path) -> None:
    often = ["checkpoint.interval=1", "evaluation.starts=8"]
    process = command("train", *scene, *UNFILMED, *often, f"hydra.run.dir={tmp_path}")
    last = tmp_path / "checkpoints" / "last.pt"
    while process.poll() is None and not (last.exists() and load_checkpoint(last)["ppo"]["frames"]):
        time.sleep(0.001)
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 130, output
    assert f"continue with: {shlex.join(['splatrl-train', f'resume={tmp_path}'])}" in output
    assert load_checkpoint(last)["ppo"]["frames"] < 1280
    (tmp_path / "rollouts.mp4").touch()  # as if somebody had evaluated the interrupted training
    finish(command("train", f"resume={tmp_path}"))
    assert not (tmp_path / "rollouts.mp4").exists()  # the whole one is not filmed
    whole, resumed = (load_checkpoint(one / "checkpoints" / "last.pt")["ppo"]["model"] for one in (run[0], tmp_path))
    assert all(torch.equal(value, resumed[key]) for key, value in whole.items())


def test_a_run_folder_is_used_by_one_process_at_a_time(scene: list[str], tmp_path: Path) -> None:
    with alone_in(tmp_path):
        process = command("train", *scene, *UNFILMED, f"hydra.run.dir={tmp_path}")
        output, _ = process.communicate(timeout=120)
    assert process.returncode != 0 and f"{tmp_path}: expected an unused folder" in output


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ("seed=1", "seed: asked for 1, found 0"),
        ("task.motion.step=0.25", "task.motion.step: asked for 0.25, found 0.5"),
        ("loss.gamma=0.5", "loss.gamma: asked for 0.5, found 0.97"),
        ("scene.path={other}", "scene: its Gaussians or its free space differ"),
    ],
)
def test_resuming_a_run_with_changed_settings_is_refused_by_default(
    run: tuple[Path, str], change: str, line: str, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(run[0], folder)
    before = (folder / "config.yaml").read_text()
    other = tmp_path / "other.ply"
    gaussians = tiny_gaussians()
    gaussians.opacities *= 0.9
    write_gaussians(other, gaussians)
    changed = resumed_config(folder, [f"resume={folder}", change.format(other=other)])
    changed.resume = str(folder)
    with pytest.raises(
        ValueError, match=f"got different ones: {line}; to resume with them anyway, type resume_changed=true"
    ):
        check_made_with(made_with(changed, build_world(changed).scene.digest), then(folder))
    assert (folder / "config.yaml").read_text() == before


def then(folder: Path) -> dict[str, Any]:
    return load_checkpoint(folder / "checkpoints" / "last.pt")["made_with"]


def test_a_checkpoint_holds_the_actions_of_the_robot_which_then_meets_its_own_policy(run: tuple[Path, str]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trained = load_policy(run[0])
    assert then(run[0])["actions"] == list(trained.world.task.motion.action_names) != []


def test_settings_that_do_not_affect_training_may_change_on_resume(run: tuple[Path, str]) -> None:
    changes = ["logger.video=false", "checkpoint.interval=7", "evaluation.seed=3", "collector.total_frames=9999"]
    cfg = resumed_config(run[0], [f"resume={run[0]}", *changes])
    now = made_with(cfg, then(run[0])["scene"])
    check_made_with(now, then(run[0]))
    with pytest.warns(UserWarning, match="resume: resuming with isa portable instead of .*, threads 2 instead of 1"):
        check_made_with(now | {"isa": "portable", "threads": 2}, then(run[0]))


def test_runs_that_start_in_the_same_second_get_separate_folders(tmp_path: Path) -> None:
    names = [run_configs._new_folder.__wrapped__(str(tmp_path / "a" / "12-00-00"), "hydra.run.dir") for _ in range(3)]
    assert [Path(name).name for name in names] == ["12-00-00", "12-00-00-2", "12-00-00-3"]
    assert all(Path(name).is_dir() for name in names)


def test_evaluating_again_gives_the_same_results(run: tuple[Path, str]) -> None:
    folder, _ = run
    before = json.loads((folder / "evaluation.json").read_text())
    (folder / "evaluation.json").unlink()
    finish(command("evaluate", f"run={folder}", "video=false"))
    assert json.loads((folder / "evaluation.json").read_text()) == before


def test_an_evaluation_in_another_scene_has_its_own_folder(
    run: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, other = run[0], two_rooms(tmp_path)[1]
    before = (folder / "evaluation.json").read_bytes()
    words = [f"scene={other}", "robot.height=0.3", "transforms/pose_noise=uniform", "video=false", "starts=6"]
    monkeypatch.setattr(sys, "argv", ["splatrl-evaluate", f"run={folder}", *words])
    evaluate.main()
    there = folder / "places" / f"{other.stem}-robot.height=0.3-transforms-pose_noise=uniform-starts=6"
    noisy = json.loads((there / "evaluation.json").read_text())
    assert noisy["evaluated_starts"] == 6
    assert noisy["transforms"] == ["PoseNoise"] and ", under pose noise\n" in capsys.readouterr().out
    assert not json.loads(before)["transforms"] and ", under" not in run[1]
    assert (there / "success_map.png").is_file() and (folder / "evaluation.json").read_bytes() == before
    place = config_elsewhere(folder, words[:3])
    own = run_config(folder)
    assert place.scene.path == str(other) and place.robot.height == 0.3
    assert place.task.max_steps == own.task.max_steps and place.collector == own.collector
    assert list(place.task.motion.lower) == [4.0, -1.5] and list(own.task.motion.lower) != [4.0, -1.5]
    assert words_of_place([f"run={folder}", *words]) == (words[:3], [f"run={folder}", *words[3:]])
    assert words_of_place(["motion@task.motion=drive", "task.max_steps=9", "starts=6"])[1] == ["starts=6"]


def test_the_results_of_an_evaluation_can_go_elsewhere_and_replace_nothing_else(
    run: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = tmp_path / "run", tmp_path / "results, 1"
    shutil.copytree(run[0], folder)
    for where in (folder, out):
        where.mkdir(exist_ok=True)
        (where / "starts.png.0123abcd.tmp").touch()  # of a killed process
    (out / "place.yaml").write_text(f"- run='{folder}'\n")

    def evaluated(cfg: DictConfig, run: Path, results: Path | None, place: list[str]) -> None:
        assert run == folder and place == [] and not list((results or run).glob("*.tmp"))
        if results is not None:
            (results / "evaluation.json").touch()

    def evaluate_into(*words: str) -> str:
        monkeypatch.setattr(sys, "argv", ["splatrl-evaluate", f"run={folder}", *words])
        try:
            evaluate.main()
        except SystemExit as ended:
            return str(ended.code)
        return ""

    monkeypatch.setattr(evaluate, "evaluate_run", evaluated)
    assert evaluate_into() == ""
    for _ in range(2):
        assert evaluate_into(f"out={out}") == ""
    assert sorted(path.name for path in out.iterdir()) == ["evaluation.json", "place.yaml"]
    for taken in (out, folder):
        refused = evaluate_into(f"out={taken}", "starts=5")
        assert refused.startswith("splatrl-evaluate: out: expected a new folder, or that of the same evaluation, got")
    assert "a file" in evaluate_into(f"out={folder}/config.yaml")


def test_places_of_one_name_have_separate_folders_of_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "room.ply").touch()
    monkeypatch.chdir(tmp_path)
    seen: list[Path] = []
    for typed in ("scene=a/room.ply", "scene=b/room.ply", "scene='a/room.ply'", "scene=./b/room.ply", "scene=kitchen"):
        place = [evaluate._absolute(typed)]
        seen.append(evaluate._results_folder(tmp_path / "places", place))
        with evaluate._made(seen[-1], place):
            (seen[-1] / "evaluation.json").touch()
    assert [path.name for path in seen] == ["room", "room-2", "room", "room-2", "kitchen"]
    with evaluate._made(tmp_path / "places" / "none", ["scene=none"]):
        assert (tmp_path / "places" / "none").is_dir()
    assert not (tmp_path / "places" / "none").exists()


@pytest.mark.parametrize("typed", ["scene=tiny", "- scene.path=${oc.env:HOME}", "- +task.motion._target_=os.system"])
def test_the_overrides_saved_in_a_strangers_run_are_treated_as_data(
    run: tuple[Path, str], tmp_path: Path, typed: str
) -> None:
    folder = tmp_path / "theirs"
    (folder / ".hydra").mkdir(parents=True)
    shutil.copy(run[0] / "config.yaml", folder / "config.yaml")
    with pytest.raises(FileNotFoundError, match="expected the overrides typed for the training, found no such file"):
        config_elsewhere(folder, ["scene=backyard"])
    (folder / ".hydra" / "overrides.yaml").write_text(f"{typed}\n")
    with pytest.raises(
        (ValueError, HydraException), match=r"a list of overrides without .* references|os\.system|_target_"
    ):
        config_elsewhere(folder, ["scene=backyard"])


def test_an_evaluation_can_override_the_settings_of_its_run(
    run: tuple[Path, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    given, where = [], []

    def evaluated(cfg: DictConfig, folder: Path, results: Path | None, place: list[str]) -> None:
        given.append(cfg.evaluation)
        where.append(results)

    monkeypatch.setattr(evaluate, "evaluate_run", evaluated)
    monkeypatch.setattr(sys, "argv", ["splatrl-evaluate", f"run={run[0]}", "starts=5", "seed=3", "checkpoint=last"])
    evaluate.main()
    own = run_config(run[0]).evaluation
    assert (given[0].starts, given[0].seed, given[0].checkpoint) == (5, 3, "last") and own.starts != 5
    assert given[0].repeats == own.repeats
    assert where == [run[0] / "places" / "checkpoint=last-starts=5-seed=3"]
    monkeypatch.setattr(sys, "argv", ["splatrl-evaluate", f"run={run[0]}", "video=false"])
    evaluate.main()
    assert (given[1].starts, where[1]) == (own.starts, None)


def test_watching_several_scenes_is_refused_before_they_are_built(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(train, "build_world", lambda cfg: pytest.fail("built"))
    words = [*in_both(tmp_path), "view=true", f"hydra.run.dir={tmp_path / 'run'}"]
    monkeypatch.setattr(sys, "argv", ["splatrl-train", *words])
    with pytest.raises(SystemExit, match="view: expected a training in one scene, got 2 scenes; type view=false"):
        train.main()
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("demos=nowhere/", "nowhere: expected a folder of demonstrations"),
        ("evaluation.episodes=nowhere.json.gz", r"nowhere\.json\.gz: expected an episode file, found none"),
        ("logger.backend=wandb", r"logger\.backend=wandb needs wandb: pip install"),
        ("logger.exp_name=a/b", r"logger\.exp_name: expected a name"),
        ("dagger.guided=2", r"dagger\.guided: expected a number from 0\.0 to 1\.0"),
        ("dagger.rounds=100", r"collector\.total_frames: expected at least [\d,]+, .* of dagger\.rounds, got"),
        (
            "dagger.rounds=1 dagger.frames_per_round=100",
            r"dagger\.frames_per_round: expected a multiple of env.num_envs =",
        ),
        ("dagger.rounds=1 dagger.shown_rounds=2", r"dagger\.shown_rounds: expected at most rounds = 1, got 2"),
        ("dagger.last_epochs=2", r"dagger\.last_epochs: expected 0 without dagger\.rounds and demos, got 2"),
        (
            "matching.frames=32",
            r"matching\.frames: expected 0, or a policy that reads only pixels and imagegoal, got .* pixels",
        ),
        (
            "matching.frames=20 sensors=[rgb,imagegoal]",
            r"matching\.frames: expected a multiple of env\.num_envs = 32, got 20",
        ),
        ("collector.total_frames=1", r"collector\.total_frames: expected at least frames_per_batch = \d+, got 1"),
        ("env.num_envs=7", r"collector\.frames_per_batch: expected a multiple of env\.num_envs = 7, got \d+"),
    ],
)
def test_settings_are_checked_before_a_world_is_built(
    scene: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, word: str, message: str
) -> None:
    monkeypatch.setattr(train, "build_world", lambda cfg: pytest.fail("built"))
    monkeypatch.setitem(sys.modules, "wandb", None)
    monkeypatch.setattr(sys, "argv", ["splatrl-train", *scene, *word.split(), f"hydra.run.dir={tmp_path / 'run'}"])
    with pytest.raises(SystemExit, match=message):
        train.main()
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("repeats=0", r"evaluation\.repeats: expected a whole number from 1"),
        ("checkpoint=first", r"evaluation\.checkpoint: expected one of last, best, got first"),
        ("episodes=nowhere.json.gz", "expected an episode file, found none"),
    ],
)
def test_settings_of_an_evaluation_are_checked_before_a_world_is_built(
    run: tuple[Path, str], monkeypatch: pytest.MonkeyPatch, word: str, message: str
) -> None:
    monkeypatch.setattr(evaluate, "evaluate_run", lambda *_, **__: pytest.fail("built"))
    monkeypatch.setattr(sys, "argv", ["splatrl-evaluate", f"run={run[0]}", word])
    with pytest.raises(SystemExit, match=message):
        evaluate.main()


def test_resuming_a_missing_run_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["splatrl-train", f"resume={tmp_path / 'nowhere'}"])
    with pytest.raises(SystemExit, match="resume: expected a run folder"):
        train.main()


def test_relative_paths_begin_where_they_are_typed_even_if_hydra_changes_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny_overrides(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(train, "build_world", lambda cfg: found.append(Path(cfg.scene.path).is_file()) or sys.exit())
    found = list[bool]()
    words = ["scene=tiny.ply", "landmarks.goal=[0.5,1.0,0.0]", "robot.height=0.5", "hydra.run.dir=run"]
    for chdir in ("true", "false"):
        monkeypatch.setattr(sys, "argv", ["splatrl-train", *words, f"hydra.job.chdir={chdir}"])
        with pytest.raises(SystemExit):
            train.main()
        shutil.rmtree("run")
    assert found == [True, True] and Path.cwd() == tmp_path


def test_each_job_of_a_sweep_given_in_a_file_has_the_settings_of_its_scene_and_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rooms = ",".join(f"'{room}'" for room in two_rooms(tmp_path))
    sweep = f'hydra: {{sweeper: {{params: {{scene.path: "{rooms}"}}}}}}'
    (tmp_path / "mine.yaml").write_text(f"defaults: [train, _self_]\ntask: {{max_steps: 7}}\n{sweep}\n")
    given = list[DictConfig]()

    def trained(cfg: DictConfig, folder: Path) -> float:
        given.append(cfg)
        return 1.0

    monkeypatch.setattr(train, "train", trained)
    chosen = ["--config-dir", str(tmp_path), "--config-name", "mine", f"hydra.sweep.dir={tmp_path / 'jobs'}"]
    monkeypatch.setattr(sys, "argv", ["splatrl-train", "-m", *chosen, "scene=file"])
    train.main()
    assert [(cfg.robot.height, cfg.landmarks.goal) for cfg in given] == [(0.5, [0.5, 1, 0]), (0.65, [5.5, 0.5, 0])]
    assert [cfg.task.max_steps for cfg in given] == [7, 7]


def test_each_job_of_a_sweep_that_fails_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def trained(cfg: DictConfig, folder: Path) -> float:
        if cfg.seed != 1:
            raise ValueError(f"seed: expected another one, got {cfg.seed}")
        return 1.0

    monkeypatch.setattr(train, "train", trained)
    monkeypatch.setattr(sys, "argv", ["splatrl-train", "-m", "seed=0,1,2", f"hydra.sweep.dir={tmp_path}"])
    with pytest.raises(SystemExit):
        train.main()
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("splatrl-train: ")]
    zero, two = (f"splatrl-train: job #{seed}: seed: expected another one, got {seed}" for seed in (0, 2))
    assert lines == [zero, two, zero]
