"""Whatever a user types wrong, a command answers in one line that names it and says what to type."""

import errno
import io
import os
import shlex
import socket
import sys
import warnings
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from warnings import formatwarning as formatted

import pytest
from hydra.errors import CompactHydraException
from hydra.types import RunMode
from omegaconf import OmegaConf

from splatrl.commands import capture, clips, entries, evaluate, experiment, faults, scene, train
from splatrl.commands.faults import in_one_line
from splatrl.configuration import command_line, load_config, run_configs, save_config
from splatrl.configuration.kinds import check_kind
from splatrl.scenes import write_gaussians
from tests.tiny import tiny_gaussians

MAINS: dict[str, Callable[[], None]] = {
    "train": train.main,
    "evaluate": evaluate.main,
    "clips": clips.main,
    "experiment": experiment.main,
    "scene": scene.main,
    "capture": capture.main,
    "gait": entries.gait,
    "view": entries.view,
}
TINY = (
    "device=cpu robot.image_width=16 robot.image_height=12 network.pool=1 robot.body.size=[0.3,0.3,0.2] "
    "task.motion.step=0.5 task.motion.lower=[-1.0,-1.5] task.motion.upper=[1.0,1.5] "
    "collector.total_frames=256 collector.frames_per_batch=128 env.num_envs=16 "
)
ROOM = "scene=room.ply robot.height=0.5 landmarks.goal=[0.5,1.0,0.0] landmarks.object=[0.75,1.0,0.5] " + TINY
GRID = ROOM.replace("landmarks.goal=[0.5,1.0,0.0] ", "")
EXPERIMENTS = ("grid", "fps", "apple", "sim2real", "loop", "generalise", "weather", "demonstrations")
ERRORS = [
    # Values that a scene needs and that were not given.
    ("train scene=room.ply", "robot.height: expected a value, got none; type robot.height=0.4"),
    ("train scene=room.ply robot.height=0.5", "landmarks.goal: expected a value, got none; type landmarks.goal=[x,y"),
    ("train task=apple scene=room.ply robot.height=0.5", "landmarks.object: expected a value, got none; type landm"),
    ("train scene=kitchen", "scene.path: expected a value, got none; type scene.path=<splat file or folder>"),
    ("train scene=nowhere", "scene: expected one of backyard, file, kitchen, "),
    ("train scene=nowhere.ply", "scene: expected one of backyard, file, kitchen, "),
    (
        "train scene=empty",
        "scene: expected a splat file, or a folder with scene.yaml or blocks.yaml, got empty; make one with",
    ),
    ("train scene=text.ply robot.height=0.5 landmarks.goal=[0,0,0]", "scene: text.ply: expected a PLY file"),
    ("train scene=bad robot.height=0.5 landmarks.goal=[0,0,0]", "scene: bad/gone.ply: no such splat file"),
    ("train scene=bad/scene.yaml robot.height=0.5 landmarks.goal=[0,0,0]", "scene: bad/gone.ply: no such splat file"),
    ("train scene=blank", "blank/scene.yaml: splat: expected the name of a file in this folder, got none"),
    ("train scene=vast/scene.yaml landmarks.goal=[0.5,1.0,0.0]", "task.motion: expected at most 16,777,216 states"),
    ("train scene.path=room.ply", "scene.path: no such key, did you mean scene=<the path>?"),
    ("scene ~t.ply", "~t.ply: no such splat file"),
    ("capture ~no-such-user/t.mp4", "~no-such-user/t.mp4: expected a video"),
    # Unknown keys and options.
    ("train tsak=grid", "tsak: no such key, did you mean task? Valid keys at the top level: seed, device"),
    ("train frames=1000", "frames: no such key, did you mean collector.frames_per_batch or collector.total_frames"),
    ("train ppo.gamma=1", "ppo.gamma: no such key, did you mean loss.gamma? ppo is a config group with the options "),
    ("train nothing.at_all=1", "nothing.at_all: no such key. nothing has no keys"),
    ("train height=1", "height: no such key, did you mean robot.height"),
    ("train task=Gird", "task: expected one of apple, circle, drive"),
    ("train transforms/appearance=foo", "transforms/appearance: expected one of none, varied"),
    ("train grid", "grid: expected key=value; did you mean task=grid?"),
    ("train --task=fps", "--task=fps: expected task=fps, without --"),
    (
        "train landmarks.goal=[0.4, 0.4, 0.0] task=grid",
        "landmarks.goal=[0.4,: expected one word; quote it: 'landmarks.goal=[0.4, 0.4, 0.0]'",
    ),
    ("view landmarks.goal=[0.4, 0.4, 0.0]", "landmarks.goal=[0.4,: expected one word; quote it: 'landmarks.goal=[0.4,"),
    ("""train 'scene.name="a[b"' task=Gird 'logger.project="c]d"'""", "task: expected one of apple, circle, drive"),
    ("train -seed=3", "-seed=3: expected seed=3, without -"),
    ("train -frob=3", "-frob=3: expected key=value, or an option that --hydra-help lists"),
    ("train landmarks.goal=[0.4,0.4", "landmarks.goal=[0.4,0.4: expected landmarks.goal=value with balanced brackets"),
    (
        "train 'landmarks.goal=0.4, 0.4, 0'",
        "landmarks.goal: expected one value, got 0.4, 0.4, 0; type 'landmarks.goal=[0.4, 0.4, 0]' for a list",
    ),
    (
        "train scene=yard:x",
        "scene: expected one of backyard, file, kitchen, many, town, yard, yards, one with a seed such as yard:3",
    ),
    ("train -m seed=0,x", "seed: expected a number such as 0, got 'x'"),
    # Values of the wrong type or out of range.
    ("train robot.height=abc", "robot.height: expected a number such as 0.4, got 'abc'"),
    ("train collector.total_frames=abc", "collector.total_frames: expected a number such as 60000, got 'abc'"),
    ("train collector.total_frames=0", "collector.total_frames: expected a whole number from 1 to"),
    ("train task.goal=abc", "task.goal: expected a list such as [0.6,0.4,0.0], got 'abc'"),
    ("train network.channels=3", "network.channels: expected a list such as [16,32], got 3"),
    ("train \"task.max_steps='20'\"", "task.max_steps: expected a number such as 200, got '20'"),
    ("train curriculum.threshold=null", "curriculum.threshold: expected a number such as 0.7, got null"),
    ("train loss.anneal_entropy=null", "loss.anneal_entropy: expected true or false, got null"),
    ("train device=null", "device: expected a single value such as auto, got null"),
    ("train transforms.order=null", "transforms.order: expected a list such as [pose_noise,latency,"),
    ("train logger.video=3", "logger.video: expected true or false, got 3"),
    (
        "train task=push 'task.motion.things={ball: ball, box: b.xml}'",
        "task.motion.things.box: no such key; to add one, type +task.motion.things.box='b.xml'",
    ),
    ("train -m curriculum=glob(z*)", "curriculum: expected a pattern that matches one of distance, none, got glob(z*)"),
    ("train -m seed=glob(*)", "seed: expected values such as 1,2, since glob(...) chooses from a group"),
    (
        "train -m 'optim.lr=interval(0.001,0.1)'",
        "optim.lr: expected values such as 0.001,0.01 or range(...), since interval(...) needs a sweeper such as hydra",
    ),
    ("train hydra/sweeper=foo", "hydra/sweeper: expected one of basic, got foo"),
    *(
        (
            f"train -m curriculum={choices} curriculum.threshold=0.5",
            "curriculum.threshold: no such key with curriculum=none; run that choice separately, without the key",
        )
        for choices in ("distance,none", "none,distance")
    ),
    ("train -m seed=0,1 +launcher=lsf", "launcher: expected one of ray, submitit_slurm, got lsf"),
    ("train robot.body=3", "robot.body: expected keys and values, such as robot.body.size=..., got 3"),
    ("train network._target_=my.net", "network._target_: expected a constructor that appears in conf/"),
    ("train network._target_=", "network._target_: expected a constructor that appears in conf/"),
    ("train evaluation.checkpoint=first", "evaluation.checkpoint: expected one of last, best, got first"),
    ("train logger.backend=foo", "logger.backend: expected one of csv, tensorboard, wandb, got foo"),
    ("train device=tpu", "device: expected auto, cpu, cuda or cuda:<number>, got tpu"),
    ("train resume=nowhere", "resume: expected a run folder with config.yaml, got nowhere"),
    ("train -m resume=nowhere,empty", "resume: expected a run folder with config.yaml, got nowhere"),
    ("train task", "task: expected key=value; did you mean task=...?"),
    ("train resume", "resume: expected key=value; did you mean resume=...?"),
    (
        "train motion@task.motin=drive",
        "motion@task.motin: expected motion@task.motion as the key, got",
    ),
    # Values that do not fit together.
    (f"train {ROOM} robot.height=-1.0", "robot.height: expected robots above"),
    (f"train {ROOM} robot.height=40", "robot.height: expected robots less than 4.01 m above the top"),
    (
        f"train {GRID} landmarks.goal=[9,9,0]",
        "task.goal: expected a point in the walkable area, x from -1 to 1 and",
    ),
    (f"train {ROOM} robot.body.size=[4.0,4.0,0.1]", "scene: expected free poses, got"),
    (
        "train scene=vast landmarks.goal=[0.5,1.0,0.0]",
        "task.motion: expected at most 16,777,216 states, got 160,003,200,016 (100,001 × 100,001 × 16) from "
        "[-10000.0, -10000.0] to [10000.0, 10000.0] m in steps of 0.2 m; choose a larger step or a smaller area",
    ),
    ("train task=fps scene=vast landmarks.goal=[0.5,1.0,0.0]", "task.motion: expected at most 16,777,216 states"),
    (f"train {ROOM} task.motion.step=0.3", "task.motion.step: bounds along x: expected a whole number of steps of 0.3"),
    (f"train task=apple {ROOM}", "drawing.size: expected at least 0.3 m, so that red fills 30%"),
    (f"train {ROOM} collision.occupancy.resolution=0", "collision.occupancy: resolution: expected 0.0001 to 1000"),
    (f"train {ROOM} scene.bounds=[[0,0,0],[0,0,0]]", "scene: bounds: expected lower below upper along x"),
    (
        f"train {ROOM} scene.world_from_splat.scale=-1",
        "scene: world_from_splat.scale: expected a number above 0",
    ),
    (f"train {ROOM} curriculum.stride=0", "curriculum.stride: expected a whole number of at least 1"),
    ("train task=gates +task.course.gate=3", "task.course.gate: no such key in TrackSettings"),
    ("train task=gates motion@task.motion=drive", "task.motion.things: no such key in DriveMotion; type motion@task"),
    (
        "train task=circle motion@task.motion=lattice",
        "task.motion.distance: no such key in LatticeMotion; type motion@task.motion=orbit",
    ),
    (
        "train task=polar_plane motion@task.motion=drive",
        "task.motion: expected a motion around an object, got DriveMotion; type motion@task.motion=orbit",
    ),
    (
        "train task=route task.later_rgb=[1,2,3]",
        "task.later_rgb: expected red, green and blue in [0, 1], got [1, 2, 3]",
    ),
    (
        "train task=push robot.body.size=[0.2,0.2,0.6]",
        "robot.body: expected a height below 0.54 m, so that the shape around the camera's body",
    ),
    (
        "train sensors=[imu]",
        "sensors.imu.path: expected a value for robot.path, found no such key; choose a robot=... that has it",
    ),
    # Keys that cannot be deleted.
    ("train ~task.gaol", "task.gaol: no such key, did you mean task.goal? Valid keys of task:"),
    ("train ~logger", "~logger: expected a key within a node, such as ~task.goal; all others are needed"),
    (
        "train ~transforms/sprite",
        "~transforms/sprite: expected another choice from this group; type transforms/sprite=",
    ),
    ("train ~transforms/skip", "~transforms/skip: expected another choice from this group; type transforms/skip=none"),
    ("train ~motion@task.motin", "motion@task.motin: no such key"),
    (
        "train ~evaluation.episodes",
        "~evaluation.episodes: expected a key with a value, which null is not; type evaluation.episodes=... instead",
    ),
    ("train resume=run ~loss.gamma", "resume=run: expected values for keys of the run, got ~loss.gamma"),
    ("evaluate run=run ~video", "~video: expected a key within a node, such as ~task.goal; all others are needed"),
    ("evaluate run=run ~checkpont", "checkpont: no such key, did you mean checkpoint?"),
    ("evaluate run=run ~evaluation", "evaluation: no such key. Valid keys at the top level: run, out, place,"),
    # The other commands.
    ("evaluate", "run: expected a value, got none; type run=<run folder>"),
    ("train task:fps", "task:fps: expected key=value; did you mean task=fps?"),
    ("evaluate nowhere", "nowhere: expected key=value; did you mean run=nowhere?"),
    ("evaluate run=empty +foo=3", "foo: no such key. Valid keys at the top level: run, out, place,"),
    ("clips run=empty ++checkpont=best", "checkpont: no such key, did you mean checkpoint?"),
    ("experiment name=grid +foo=3", "foo: no such key"),
    ("evaluate run=empty +memory=none", "memory: no such key. Valid keys at the top level: run, out, place,"),
    ("train motion=drive", "motion: expected motion@task.motion as the key, got motion"),
    (
        "evaluate run=empty place=[scene=kitchen,transforms/latency=none]",
        "place: expected each element in quotes: \"place=['scene=kitchen','transforms/latency=none']\"",
    ),
    ("evaluate run=empty", "run: expected a run folder with config.yaml, got empty"),
    ("clips run=nowhere clips=x", "run: expected a run folder with config.yaml, got nowhere"),
    ("experiment", "name: expected one of grid, fps, apple, sim2real, loop"),
    ("experiment name=gird", f"name: expected one of {', '.join(EXPERIMENTS)}, all, got gird; did you mean name=grid?"),
    ("experiment name=grid jobs=0", "jobs: expected a whole number of at least 1, got 0"),
    ("experiment name=grid seeds=abc", "seeds: expected whole numbers in brackets such as [0,1], got abc"),
    ("experiment name=grid scenes=[nowhere]", "scenes: expected names from "),
    ("experiment name=grid kitchen=no.spz", "kitchen: expected the path of an existing kitchen.spz, got no.spz"),
    (
        "experiment name=grid report_only=true folder=empty",
        "folder: expected a folder with finished trainings of grid, got empty",
    ),
    ("scene", "the following arguments are required: file"),
    ("scene nowhere.ply", "nowhere.ply: no such splat file"),
    ("scene bad/scene.yaml", "bad/gone.ply: no such splat file"),
    ("scene text.doc --out bad", "text.doc: expected a file with the extension .ply, "),
    ("gait --wide", "the following arguments are required: run; splatrl-gait --help lists the options"),
    ("scene room.ply --scale wide", "--scale: invalid float value: 'wide'"),
    ("scene room.ply --up q", "--up: expected one of x, -x, y, -y, z, -z, or 3 numbers, got 'q'"),
    ("capture", "expected a video or a folder of photos"),
    ("capture nowhere.mp4 --distance 1 2", "--distance: expected IMAGE X Y X Y M"),
]


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A working directory with a room, and with files and folders that are no scenes."""
    folder = tmp_path_factory.mktemp("places")
    write_gaussians(folder / "room.ply", tiny_gaussians())
    (folder / "text.ply").write_text("hello")
    for name in ("empty", "bad", "blank"):
        (folder / name).mkdir()
    (folder / "blank" / "scene.yaml").touch()
    (folder / "bad" / "scene.yaml").write_text("splat: gone.ply\n")
    (folder / "run").mkdir()
    save_config(load_config(), folder / "run")
    (folder / "vast").mkdir()
    write_gaussians(folder / "vast" / "room.ply", tiny_gaussians())
    walk = "walk: [[-1.0e+4, -1.0e+4], [1.0e+4, 1.0e+4]]"
    (folder / "vast" / "scene.yaml").write_text(f"splat: room.ply\nrobot_height: 0.5\n{walk}\n")
    return folder


@pytest.mark.parametrize(("typed", "said"), ERRORS, ids=[typed[:60] for typed, _ in ERRORS])
def test_a_mistyped_command_is_answered_in_one_line(
    typed: str, said: str, places: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    name, *arguments = shlex.split(typed)
    monkeypatch.chdir(places)
    monkeypatch.setattr(sys, "argv", [f"splatrl-{name}", *arguments])
    with pytest.raises(SystemExit) as ended:
        MAINS[name]()
    errors = [line for line in capsys.readouterr().err.splitlines() if "left out" not in line]
    if isinstance(ended.value.code, str):  # which Python itself prints
        errors.append(ended.value.code)
    assert ended.value.code not in (0, None)
    assert len(errors) == 1 and "\n" not in errors[0], errors
    assert errors[0].startswith(f"splatrl-{name}: {said}"), errors
    assert not (places / "nowhere").exists()
    assert not list(places.glob("outputs/*/*")), "a run that did not begin leaves nothing behind"


def test_a_folder_typed_alone_is_taken_for_a_scene_however_its_path_begins(
    places: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(places)
    for typed in ("bad", "./bad", str(places / "bad"), "../"):
        with pytest.raises(SystemExit) as ended:
            command_line("train", [typed])
        assert ended.value.code == f"splatrl-train: {typed}: expected key=value; did you mean scene={typed}?"


def test_unknown_keys_are_refused_before_yards_are_generated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splatrl.configuration.scene_files.make_yards", lambda seeds: pytest.fail("generated"))
    with pytest.raises(SystemExit, match=r"evaluation\.video: no such key"):
        command_line("train", ["scene=yards", "evaluation.video=false"])


@pytest.mark.parametrize("name", ["train", "scene"])
def test_every_command_prints_the_version_of_splatrl(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    entries.start(name, ["--version"])
    assert capsys.readouterr().out == f"splatrl {version('splatrl')}\n"


def test_a_refused_run_deletes_no_files_of_others(places: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(places)
    typed = shlex.split(f"splatrl-train {ROOM} collector.total_frames=10 hydra.run.dir=mine")
    monkeypatch.setattr(sys, "argv", typed)
    (places / "mine").mkdir()
    (places / "mine" / "notes.log").write_text("mine")
    with pytest.raises(SystemExit, match=r"collector\.total_frames: expected at least"):
        train.main()
    assert [path.name for path in (places / "mine").iterdir()] == ["notes.log"]
    (places / "mine" / "config.yaml").write_text("mine: 1\n")
    with pytest.raises(SystemExit, match=r"collector\.total_frames: expected at least"):
        train.main()
    assert (places / "mine" / "config.yaml").exists()
    (places / "mine" / "config.yaml").unlink()
    (places / "mine" / "checkpoints").mkdir()
    (places / "mine" / "checkpoints" / "last.pt").touch()
    (places / "mine" / ".hydra").mkdir(exist_ok=True)
    (places / "mine" / ".hydra" / "overrides.yaml").write_text("- seed=7\n")
    with pytest.raises(SystemExit, match=r"hydra\.run\.dir: expected a new folder, got a run"):
        train.main()
    assert (places / "mine" / "checkpoints" / "last.pt").exists()
    assert (places / "mine" / ".hydra" / "overrides.yaml").read_text() == "- seed=7\n"  # what its run was typed with


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("device=cpu", "outputs/.*: cannot write: Not a directory; choose another folder with hydra.run.dir="),
        (
            "hydra.run.dir=outputs/a",
            "outputs/a: cannot write: Not a directory; choose another folder with hydra.run.dir=",
        ),
        ("hydra.run.dir=/proc", "/proc: cannot write: .*; choose another folder with hydra.run.dir="),
        (
            "-m seed=0,1 hydra.sweep.dir=outputs",
            "outputs: cannot write: .*; choose another folder with hydra.sweep.dir=",
        ),
        ("-m seed=0,1", "multirun/.*: cannot write: Not a directory; choose another folder with hydra.sweep.dir="),
    ],
)
def test_a_run_folder_that_cannot_be_written_is_reported_in_one_line(
    typed: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("outputs", "multirun"):
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["splatrl-train", *typed.split()])
    with pytest.raises(SystemExit, match=f"^splatrl-train: {said}"):
        MAINS["train"]()
    assert not capsys.readouterr().err


def test_a_run_that_cannot_be_written_is_resumed_nowhere_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(folder: Path, needed: int) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    save_config(load_config(), tmp_path)
    monkeypatch.setattr(run_configs, "require_room", refused)
    monkeypatch.setattr(sys, "argv", ["splatrl-train", f"resume={tmp_path}"])
    with pytest.raises(SystemExit) as ended:
        MAINS["train"]()
    assert ended.value.code == f"splatrl-train: {tmp_path}: cannot write: Permission denied"


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("+launcher=ray", "hydra-ray-launcher is missing; pip install 'splatrl"),
        ("hydra/launcher=ray", "hydra-ray-launcher is missing; pip install 'splatrl"),
        ("hydra/sweeper=optuna", "hydra-optuna-sweeper is missing; pip install hydra-optuna-sweeper"),
    ],
)
def test_a_plugin_that_is_not_installed_is_reported_with_what_to_install(
    typed: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = {"launcher": ("ray",), "hydra/launcher": ("basic",), "hydra/sweeper": ("basic",)}
    monkeypatch.setattr("splatrl.configuration.typed_overrides.options", lambda group: found.get(group, ()))
    with pytest.raises(SystemExit) as ended:
        command_line("train", ["-m", "optim.lr=interval(0.001,0.1)", typed])
    assert str(ended.value.code).startswith(f"splatrl-train: {typed}: {said}")


def test_help_is_printed_whatever_the_encoding_of_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    printed = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(printed, encoding="ascii"))
    with pytest.raises(SystemExit) as ended:
        entries.start("train", ["--help"])
    sys.stdout.flush()
    assert not ended.value.code and b"0.4 ? 0.4" in printed.getvalue()


@pytest.mark.parametrize("buffered", [True, False])
@pytest.mark.parametrize("name", ["stdout", "stderr"])
def test_a_command_goes_on_when_the_reader_of_its_output_leaves(
    name: str, buffered: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    reading, writing = os.pipe()
    work = list[str]()

    def run(options: object) -> None:
        print("first", file=getattr(sys, name), flush=True)
        assert os.read(reading, 100) == b"first\n"
        os.close(reading)
        for text in ("second", "long" * 10**5, "last"):
            print(text, file=getattr(sys, name), flush=True)
            work.append(text[:6])

    with open(writing, "wb", -1 if buffered else 0) as buffer:
        stream = io.TextIOWrapper(buffer, write_through=not buffered)
        monkeypatch.setattr(sys, name, stream)
        monkeypatch.setattr(entries, "import_module", lambda module: SimpleNamespace(run=run))
        entries.start("gait", ["run"])
        getattr(sys, name).flush()
    assert work == ["second", "longlo", "last"]


def test_a_command_goes_on_when_the_reader_of_a_socket_leaves_with_output_unread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        writing = socket.create_connection(server.getsockname())
        reading = server.accept()[0]
    work = list[str]()

    def run(options: object) -> None:
        print("unread", flush=True)
        reading.close()  # which resets the connection
        for text in ("second", "last"):
            print(text, flush=True)
            work.append(text)

    with writing, open(writing.fileno(), "wb", closefd=False) as buffer:
        monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(buffer))
        monkeypatch.setattr(entries, "import_module", lambda module: SimpleNamespace(run=run))
        entries.start("gait", ["run"])
    assert work == ["second", "last"]


def test_the_list_of_errors_is_long_and_varied() -> None:
    assert len(ERRORS) >= 40 and len({said for _, said in ERRORS}) > 35


def test_the_traceback_of_an_error_can_be_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    @in_one_line("splatrl-train")
    def fails(error: Exception) -> None:
        raise error

    with pytest.raises(SystemExit, match="splatrl-train: a b"):
        fails(ValueError("a\n  b"))
    with pytest.raises(RuntimeError, match="ours"):  # not a mistake of the user
        fails(RuntimeError("ours"))
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    with pytest.raises(ValueError, match="a\n"):
        fails(ValueError("a\n  b"))


def test_an_evaluation_accepts_its_keys_under_their_names_in_a_training(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").touch()
    keys = ["evaluation.starts=64", "evaluation.repeats=2"]
    cfg = load_config(command_line("evaluate", [f"run='{tmp_path}'", *keys]), "evaluate")
    assert (cfg.starts, cfg.repeats, cfg.place) == (64, 2, [])
    there = command_line("evaluate", ["scene=backyard", f"run='{tmp_path}'", "task.max_steps=9"])
    assert load_config(there, "evaluate").place == ["scene=backyard", "task.max_steps=9"]


def test_a_warning_is_one_line_without_its_place_in_the_code() -> None:
    said: list[str] = []

    @in_one_line("splatrl-train")
    def warns(category: type[Warning]) -> None:
        said.append(warnings.formatwarning("mine: not\n  metric", category, "place.py", 7))

    warns(UserWarning)
    assert said == ["splatrl-train: mine: not metric\n"]
    warns(DeprecationWarning)  # not one of ours
    assert said[1].startswith("place.py:7: DeprecationWarning")
    assert warnings.formatwarning is formatted


def test_an_error_in_a_sweep_holds_no_reference_to_its_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    @in_one_line("splatrl-train")
    def fails() -> None:
        raise ValueError("seed: expected another")

    job = SimpleNamespace(mode=RunMode.MULTIRUN, job=SimpleNamespace(num=3))
    sweep = SimpleNamespace(initialized=lambda: True, get=lambda: job)
    monkeypatch.setattr(faults, "HydraConfig", sweep)
    with pytest.raises(CompactHydraException, match="splatrl-train: job #3: seed: expected another") as told:
        fails()
    assert told.value.__context__ is None and told.value.__cause__ is None


@pytest.mark.parametrize("name", ["record", "scene"])
def test_an_interrupt_prints_one_line_and_no_traceback(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(module: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(entries, "import_module", interrupted)
    monkeypatch.setattr(sys, "argv", [])
    with pytest.raises(SystemExit) as ended:
        entries.start(name, {"record": ["out=new"], "scene": ["room.ply"]}[name])
    assert ended.value.code == 130 and capsys.readouterr().err == f"\nsplatrl-{name}: interrupted\n"


@pytest.mark.parametrize(
    ("usual", "given"),
    [
        *((0.5, 1), (1, 0.5), (0.5, "${robot.height}"), (True, False), ("auto", 3), ("auto", False)),
        *(([1, 2], [3]), ([], [[[0, 0, 0], [1, 1, 1]]]), (None, [1]), ({"a": 1}, {"a": 2}), ({"a": 1}, None)),
    ],
)
def test_values_of_the_usual_type_references_and_null_for_nodes_are_accepted(usual: object, given: object) -> None:
    cfg = OmegaConf.create({"key": usual})
    check_kind("key", cfg.key, given, lambda key: False)


@pytest.mark.parametrize(
    ("usual", "given"),
    [
        (0.5, True),
        (0.5, "a"),
        (0.5, [1]),
        (True, 1),
        ([1, 2], ["a"]),
        ([1], 1),
        ({"a": 1}, 1),
        ("a", [1]),
        ({"a": 1}, {"a": "b"}),
        ({"a": 1}, {"a": None}),
        *((usual, None) for usual in (0.5, True, "a", [1])),
    ],
)
def test_values_of_another_type_are_refused(usual: object, given: object) -> None:
    cfg = OmegaConf.create({"key": usual})
    with pytest.raises(ValueError, match=r"key(\.a)?: expected"):
        check_kind("key", cfg.key, given, lambda key: False)
