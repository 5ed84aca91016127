"""With full disks and read-only folders, commands work, or fail with one line that names the path."""

import os
import shlex
import shutil
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from splatrl.commands import clips, entries, evaluate, experiment, export, record, replay, scene, train
from splatrl.export import onnx_file
from splatrl.files import new_folder
from splatrl.scenes import cache, write_gaussians
from splatrl.scenes.editing import edit_description
from tests.tiny import tiny_gaussians

COMMANDS: dict[str, Callable[[], object]] = {
    name: module.main
    for name, module in {
        "train": train,
        "scene": scene,
        "evaluate": evaluate,
        "clips": clips,
        "record": record,
        "replay": replay,
        "export": export,
        "experiment": experiment,
    }.items()
}
ROOM = (
    "scene=garden/ device=cpu robot.height=0.5 landmarks.goal=[0.5,1.0,0.0] robot.image_width=16 "
    "robot.image_height=12 network.pool=1 robot.body.size=[0.3,0.3,0.2] task.motion.step=0.5 "
    "task.motion.lower=[-1.0,-1.5] task.motion.upper=[1.0,1.5]"
)
SMALL = (
    f"train {ROOM} collector.total_frames=128 collector.frames_per_batch=128 env.num_envs=16 "
    "evaluation.batch_size=32 evaluation.starts=16 hydra.run.dir=run"
)
DEMOS = f"record {ROOM} by=planner episodes=2 out=new/demos"
FULL, READ_ONLY = (28, "No space left on device"), (30, "Read-only file system")
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")


def make_garden(folder: Path) -> Path:
    (folder / "garden").mkdir()
    write_gaussians(folder / "garden" / "splat.ply", tiny_gaussians())
    (folder / "garden" / "scene.yaml").write_text("splat: splat.ply\n")
    return folder / "garden"


@pytest.fixture
def garden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scene folder in the working directory, and an empty cache."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path / "cache"))
    cache._warn_unwritable.cache_clear()
    return make_garden(tmp_path)


@dataclass
class Training:
    """A run in such a scene, trained where no cache can be created.

    Attributes:
        folder: the folder with the scene, ``garden``, and the run, ``run``.
        before: contents of the scene folder before the training.
        after: contents of the scene folder after the training.
        said: warnings of the training.
    """

    folder: Path
    before: dict[str, tuple[int, int]]
    after: dict[str, tuple[int, int]]
    said: list[str]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Training:
    folder = tmp_path_factory.mktemp("made")
    garden = make_garden(folder)
    (folder / "cache").write_text("a file, where no folder can be made")
    before = listing(garden)
    cache._warn_unwritable.cache_clear()
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        patch.chdir(folder)
        patch.setenv("SPLATRL_CACHE", str(folder / "cache"))
        run(patch, SMALL)
    return Training(folder, before, listing(garden), [str(warning.message) for warning in caught])


@pytest.fixture(scope="module")
def made(trained: Training) -> Path:
    """A folder with the scene, its run, demonstrations and clips."""
    folder = trained.folder
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        run(patch, DEMOS)
        run(patch, "clips run=run record=walks clips=walks out=walked count=1 height=12")
    return folder


def run(monkeypatch: pytest.MonkeyPatch, typed: str) -> None:
    words = shlex.split(typed)
    monkeypatch.setattr(sys, "argv", [f"splatrl-{words[0]}", *words[1:]])
    COMMANDS[words[0]]()


def listing(folder: Path) -> dict[str, tuple[int, int]]:
    return {str(path): (path.stat().st_size, path.stat().st_mtime_ns) for path in [folder, *folder.rglob("*")]}


def break_disk(monkeypatch: pytest.MonkeyPatch, path: str, code: int, reason: str) -> None:
    """Make all attempts to flush or allocate files below a path fail."""
    for name in ("fsync", "posix_fallocate"):
        monkeypatch.setattr(os, name, _failing(getattr(os, name), path, code, reason))


def _failing(works: Callable[..., None], path: str, code: int, reason: str) -> Callable[..., None]:
    def fails(descriptor: int, *rest: int) -> None:
        if path in os.readlink(f"/proc/self/fd/{descriptor}"):
            raise OSError(code, reason)
        works(descriptor, *rest)

    return fails


def test_a_training_writes_nothing_into_its_scene_and_needs_no_cache(trained: Training) -> None:
    assert trained.after == trained.before and (trained.folder / "run" / "evaluation.json").exists()
    said = [each for each in trained.said if "cannot write the cache here" in each]
    assert len(said) == 1 and said[0].startswith(str(trained.folder / "cache"))


def test_a_replay_writes_nothing(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(made)
    before = listing(made)
    run(monkeypatch, "replay demos=new/demos")
    assert listing(made) == before


@linux
@pytest.mark.parametrize(
    ("typed", "path"), [(SMALL, "run"), ("scene garden/splat.ply --height 0.5 --out mine", "mine")]
)
@pytest.mark.parametrize(("code", "reason"), [FULL, READ_ONLY])
def test_a_full_or_read_only_disk_is_reported_in_one_line_that_names_the_path(
    garden: Path, monkeypatch: pytest.MonkeyPatch, typed: str, path: str, code: int, reason: str
) -> None:
    break_disk(monkeypatch, path, code, reason)
    says_so(monkeypatch, typed, path, reason)
    assert not list(garden.parent.rglob("*.tmp"))


@linux
def test_too_little_room_for_the_configs_of_a_run_is_reported_before_it_starts(
    garden: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(descriptor: int, start: int, size: int) -> None:
        if size > 20_000:
            raise OSError(*FULL)

    monkeypatch.setattr(os, "posix_fallocate", fails)
    says_so(monkeypatch, SMALL, "run", FULL[1])
    assert not list(Path("run").iterdir())


def says_so(monkeypatch: pytest.MonkeyPatch, typed: str, path: str, reason: str) -> None:
    with pytest.raises(SystemExit) as ended:
        run(monkeypatch, typed)
    said = str(ended.value.code)
    assert said.startswith(f"splatrl-{typed.split()[0]}: ") and "\n" not in said
    assert f"cannot write: {reason}" in said and path in said


@linux
@pytest.mark.parametrize(
    ("typed", "path", "code", "reason"),
    [
        ("evaluate run=run", "run", *FULL),
        ("evaluate run=run", "run", *READ_ONLY),
        ("clips run=run clips=walks out=out", "out", *FULL),
        ("clips run=run film=walks/walk-00 out=out", "out", *FULL),
        ("export run=run frames=2", "export", *FULL),
        (DEMOS.replace("new/", "other/"), "other", *FULL),
        ("experiment name=grid folder=found report_only=true", "found", *FULL),
    ],
)
def test_a_full_or_read_only_disk_loses_no_file_and_leaves_none_half_written(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, typed: str, path: str, code: int, reason: str
) -> None:
    for name in ("garden", "run", "walks"):
        shutil.copytree(made / name, tmp_path / name)
    (tmp_path / "found" / "grid").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(onnx_file, "onnx_bytes", lambda *_: b"a policy")
    monkeypatch.setattr(onnx_file, "largest_difference", lambda *_: 0.0)
    before = {name: content for name, content in listing(tmp_path).items() if Path(name).is_file()}
    break_disk(monkeypatch, path, code, reason)
    says_so(monkeypatch, typed, path, reason)
    after = {name: content for name, content in listing(tmp_path).items() if Path(name).is_file()}
    assert after == before


@linux
def test_an_evaluation_that_cannot_be_written_is_refused_before_its_episodes(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(made / "run", tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(evaluate, "evaluate", lambda *_: pytest.fail("episodes were evaluated"))
    break_disk(monkeypatch, "run", *READ_ONLY)
    says_so(monkeypatch, "evaluate run=run", "run: ", f"{READ_ONLY[1]}; choose another folder with out=")


@linux
@pytest.mark.parametrize(("code", "reason"), [FULL, READ_ONLY])
def test_a_failed_edit_of_a_scene_in_the_viewer_leaves_it_unchanged(
    garden: Path, monkeypatch: pytest.MonkeyPatch, code: int, reason: str
) -> None:
    before = listing(garden)
    break_disk(monkeypatch, "garden", code, reason)
    with pytest.raises(OSError, match=rf"cannot write: {reason}.*scene\.yaml"):
        edit_description(garden, {"goal": [0.5, 1.0, 0.0]})
    assert {key: size for key, (size, _) in listing(garden).items()} == {key: size for key, (size, _) in before.items()}


def test_an_error_in_a_new_folder_names_it_by_its_final_name(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"cannot write: No space left.*demos"), new_folder(tmp_path / "demos"):
        raise OSError(28, "Error writing bytes to file")
    with pytest.raises(FileNotFoundError, match=r"'.*/absent/demos'$"), new_folder(tmp_path / "absent" / "demos"):
        pass
    with pytest.raises(OSError, match=r"demos/a/b\.bin'$"), new_folder(tmp_path / "demos") as made:
        raise OSError(28, "cannot write: No space left on device", str(made / "a" / "b.bin"))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("variables", "kept"), [({}, "mine/matplotlib"), ({"MPLCONFIGDIR": "theirs"}, "theirs")])
def test_with_a_read_only_home_matplotlib_keeps_its_fonts_in_our_cache(
    variables: dict[str, str], kept: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "environ", {"HOME": str(tmp_path / "home"), "SPLATRL_CACHE": "mine", **variables})
    writable = [True]
    monkeypatch.setattr(os, "access", lambda path, mode: writable[0] and path == tmp_path / "home")
    entries.keep_fonts()
    assert os.environ.get("MPLCONFIGDIR") == variables.get("MPLCONFIGDIR")
    writable[0] = False
    entries.keep_fonts()
    assert Path(os.environ["MPLCONFIGDIR"]) == (Path(kept) if variables else tmp_path / kept)
