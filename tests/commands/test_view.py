"""End-to-end tests of ``splatrl-view``, ``splatrl-train view=true`` and ``splatrl-record by=keys``."""

import errno
import io
import re
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import pytest
from omegaconf import DictConfig, OmegaConf

from splatrl.building import build_world
from splatrl.commands import record, view
from splatrl.commands.view import furnish, place_values
from splatrl.configuration import command_line, load_config
from splatrl.configuration.spelling import with_key
from splatrl.datasets import Demonstrations, planner_episodes, read_demonstrations
from splatrl.envs.world import World
from splatrl.scenes import write_gaussians
from splatrl.viewer.driver import Driver
from splatrl.viewer.markdown import plain
from splatrl.viewer.page import Page
from tests.commands.test_train import SETTINGS, command, finish
from tests.configuration.test_elsewhere import trained
from tests.preloaded import Process
from tests.tiny import tiny_gaussians, tiny_overrides
from tests.viewer.conftest import SCENE
from tests.viewer.visitor import Visitor, until

GRID = ["task=grid", "robot.body.size=[0.3,0.3,0.2]", "task.motion.angle_step_deg=45.0"]
GRID += ["device=cpu", "robot.image_width=16", "robot.image_height=12", "network.pool=1"]


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """The room as a scene folder."""
    folder = tmp_path / "my place"
    folder.mkdir()
    write_gaussians(folder / "splat.ply", tiny_gaussians())
    (folder / "scene.yaml").write_text(SCENE)
    return folder


def page_of(process: Process) -> Visitor:
    """Open the page whose address a command prints."""
    assert process.stdout is not None
    lines: list[str] = []
    while not (found := re.search(r"http://[\d.]+:\d+", line := process.stdout.readline())):
        lines.append(line)
        assert line, "".join(lines)
    return Visitor(found[0])


def test_a_folder_is_viewed_and_its_goal_edited_until_an_interrupt(place: Path) -> None:
    process = command("view", str(place), *GRID, "port=0")
    visitor = page_of(process)
    visitor.find("GaussianSplatsMessage")
    visitor.field("save to scene.yaml")
    visitor.drag("/place/goal", (-0.5, 1.0, 0.5))
    visitor.find("GuiUpdateMessage", lambda m: "not saved yet: goal" in str(m["updates"]))
    visitor.click("save to scene.yaml")
    until(lambda: "goal: [-0.5, 1.0, 0.0]  # looks at the red thing" in (place / "scene.yaml").read_text(), "the goal")
    visitor.close()
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 0 and "Traceback" not in output, output


def test_a_goal_outside_the_walkable_area_is_refused_with_a_message(place: Path) -> None:
    cfg = load_config([*GRID, f"scene='{place}'"], "view")
    page = Page(view.instantiate(cfg.scene), port=0)
    stop = furnish(page, cfg)
    visitor = Visitor(page.address)
    visitor.drag("/place/goal", (9.0, 1.0, 0.5))
    until(lambda: visitor.field("save to scene.yaml"), "the button")
    visitor.find("GuiUpdateMessage", lambda m: "not saved yet: goal" in str(m["updates"]))
    visitor.click("save to scene.yaml")
    told = visitor.find("GuiUpdateMessage", lambda m: "**not saved**" in str(m["updates"]))
    expected = "task.goal: expected a point in the walkable area, x from -1 to 1"
    assert plain(expected) in told["updates"]["_markdown"]
    assert (place / "scene.yaml").read_text() == SCENE
    visitor.close()
    stop()
    page.close()


def test_a_bare_splat_is_shown_without_a_robot_to_drive(tmp_path: Path) -> None:
    write_gaussians(tmp_path / "room.ply", tiny_gaussians())
    cfg = load_config([f"scene={tmp_path / 'room.ply'}"], "view")
    page = Page(view.instantiate(cfg.scene), port=0)
    furnish(page, cfg)()
    visitor = Visitor(page.address)
    visitor.find("GaussianSplatsMessage")
    visitor.field("solid")
    found = [message["props"]["_markdown"] for message in visitor.messages if message["type"] == "GuiMarkdownMessage"]
    assert any(plain("robot.height: expected a value, got none") in text for text in found), found
    visitor.close()
    page.close()


def test_the_page_opens_even_for_a_robot_that_keys_cannot_drive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mujoco", reason="needs the extra physics")
    gates = tiny_overrides(tmp_path, "gates")
    monkeypatch.setattr(sys, "argv", ["splatrl-record", *gates, "by=keys", "port=70000", f"out={tmp_path}/new"])
    told = "task: expected actions that keys can express, a speed and a turn, got 4 numbers per action"
    with pytest.raises(SystemExit, match=told):
        record.main()
    cfg = load_config(gates, "view")
    page = Page(view.instantiate(cfg.scene), port=0)
    furnish(page, cfg)()
    visitor = Visitor(page.address)
    visitor.field("save to scene.yaml")
    found = [message["props"]["_markdown"] for message in visitor.messages if message["type"] == "GuiMarkdownMessage"]
    assert f"Driving is not available: {plain(told)}" in found
    visitor.close()
    page.close()


def test_the_values_that_can_be_dragged_come_from_the_config(place: Path) -> None:
    cfg = load_config([*GRID, f"scene='{place}'"], "view")
    values = place_values(cfg, view.instantiate(cfg.scene))
    assert values == {
        "goal": [0.5, 1.0, 0.0],
        "object": [0.75, 1.0, 0.5],
        "walk": [[-1.0, -1.5], [1.0, 1.5]],
        "bounds": [[-1.7, -2.2, -0.1], [1.7, 2.2, 1.3]],
    }
    circle = load_config(["task=circle", f"scene='{place}'"], "view")
    assert place_values(circle, view.instantiate(circle.scene))["walk"] is None


def test_a_word_without_a_key_is_a_scene_or_a_run(tmp_path: Path) -> None:
    (tmp_path / "a run").mkdir()
    (tmp_path / "a run" / "config.yaml").write_text("")
    assert with_key(["kitchen", "scene.path=k.spz"]) == ["scene=kitchen", "scene.path=k.spz"]
    assert with_key(["task=fps", "a b/c.ply"]) == ["task=fps", "scene='a b/c.ply'"]
    assert with_key([str(tmp_path / "a run"), "port=0"]) == [f"run='{tmp_path / 'a run'}'", "port=0"]
    assert with_key(["--help"]) == ["--help"]


def test_a_run_is_viewed_in_the_place_that_is_typed_for_instance_where_its_scene_has_moved(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run = trained(tmp_path / "run", [f"scene='{place}'", "robot.fov_deg=70"])
    moved = place.rename(tmp_path / "moved")

    def viewed(*words: str) -> DictConfig:
        return view.config_of_run(load_config(command_line("view", words), "view"), words)[0]

    cfg = viewed(str(run), "scene.path=moved", "port=0")
    assert (Path(cfg.scene.path).absolute(), cfg.robot.height, cfg.robot.fov_deg) == (moved, 0.5, 70)
    assert list(cfg.landmarks.goal) == [0.5, 1.0, 0.0]
    cfg = viewed("scene=backyard", f"run={run}", "robot.fov_deg=50")
    assert (cfg.scene["_target_"], cfg.robot.fov_deg) == ("splatrl.backyard", 50)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "splatrl-view: scene: expected one of backyard, .*or an existing path, got nowhere"),
        (["nowhere.ply"], "splatrl-view: scene: expected .* an existing path, got nowhere.ply"),
        (["kitchen"], "splatrl-view: scene.path: expected a value, got none"),
        (["run=nowhere"], "splatrl-view: run: expected a run folder with config.yaml, got nowhere"),
        (
            ["run=mine", "seed=3", "task=fps", "scene=yard:3"],
            "splatrl-view: run=mine: expected only .*, got task=fps, seed=3$",
        ),
        (["place=['scene=yard:3']"], "splatrl-view: place: expected a run with it, got"),
        (["backyard", "port=70000"], "splatrl-view: port: expected a whole number from 0 to 65535"),
        (["backyard", "host=192.0.2.1"], "splatrl-view: host: expected an address of this machine"),
        (["backyard", "prot=1"], "splatrl-view: prot: no such key, did you mean port"),
    ],
)
def test_invalid_arguments_are_reported_in_one_line(
    arguments: list[str], message: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["splatrl-view", *arguments])
    with pytest.raises(SystemExit) as error:
        view.main()
    assert re.match(message, str(error.value)) and "\n" not in str(error.value), error.value


def test_a_training_can_be_watched_and_its_run_viewed_afterwards(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    scene = tiny_overrides(tmp_path)
    quick = ["evaluation.starts=8", "logger.video=false", f"hydra.run.dir={folder}"]
    training = command("train", *scene, *SETTINGS, *quick, "view=true")
    visitor = page_of(training)
    visitor.find("BatchedMeshesMessage")
    finish(training)
    visitor.close()
    looking = command("view", str(folder), "port=0")
    visitor = page_of(looking)
    visitor.find("GuiUpdateMessage", lambda m: "step 1" in str(m["updates"]))
    visitor.close()
    looking.send_signal(signal.SIGINT)
    output, _ = looking.communicate(timeout=60)
    assert looking.returncode == 0 and "Traceback" not in output, output
    refused = command("view", str(folder), "task=fps")
    output, _ = refused.communicate(timeout=60)
    assert "expected only run, evaluation.checkpoint, host, port, device, allow_targets, and a place such as" in output


def test_ctrl_c_ends_a_watched_training_like_any_other(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    many = ["collector.total_frames=1000000", f"hydra.run.dir={folder}", "view=true"]
    training = command("train", *tiny_overrides(tmp_path), *SETTINGS, *many)
    visitor = page_of(training)
    visitor.find("GuiUpdateMessage", lambda m: "- frames" in str(m["updates"]))
    training.send_signal(signal.SIGINT)
    output, _ = training.communicate(timeout=60)
    assert training.returncode == 130 and "continue with: splatrl-train" in output and "Traceback" not in output, output
    visitor.close()


def drive(visitor: Visitor, driver: Driver) -> None:
    """Drive to the goal as a person would, along the plan of a local driver that draws the same starts."""
    names = driver.world.task.motion.action_names
    while not driver.done:
        best = int(driver.world.plan.optimal(driver.state)[0].nonzero()[0, 0])
        seen = len(visitor.messages)
        driver.act(driver.world.plan.actions[best])
        visitor.press(names[best])
        told = f"step {driver.steps} ·"
        if not driver.done:  # the page may be gone
            until(lambda: any(told in str(m) for m in visitor.messages[seen:]), told)  # noqa: B023
    driver.begin()


def test_episodes_driven_by_keys_are_a_dataset_like_the_planners_even_after_a_kill(tmp_path: Path) -> None:
    scene, out, takes = tiny_overrides(tmp_path), tmp_path / "demos", tmp_path / "demos.takes"
    words = ["record", *scene, "by=keys", "episodes=2", f"out={out}/", "port=0"]
    recording, world = command(*words), build_world(load_config(scene))
    visitor = page_of(recording)
    visitor.field("save the kept episodes and stop")
    drive(visitor, Driver(world))
    visitor.find("GuiUpdateMessage", lambda m: "any key starts" in str(m) and "kept 1 of 2" in str(m))
    recording.kill()
    recording.communicate()
    visitor.close()
    assert [path.name for path in takes.iterdir()] == ["1.pt"] and not out.exists()
    recording = command(*words)
    visitor = page_of(recording)
    visitor.find("GuiUpdateMessage", lambda m: "step 0" in str(m) and "kept 1 of 2" in str(m))
    drive(visitor, Driver(world, 1))
    output = finish(recording)
    assert f"{out}: 2 episodes, {len(read_demonstrations(out))} frames" in output and not takes.exists()
    assert "are identical, byte for byte" in finish(command("replay", f"demos={out}"))


def test_nothing_interrupts_the_writing_of_driven_episodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    finished = threading.Event()
    finished.set()
    for name, made in (
        ("Page", SimpleNamespace(address="here", close=lambda: None)),
        ("Driving", SimpleNamespace(finished=finished)),
        ("Takes", SimpleNamespace(demonstrations=lambda: "episodes", episodes=[], forget=lambda: None)),
        ("made_with", None),
    ):
        monkeypatch.setattr(record, name, lambda *_, made=made: made)
    monkeypatch.setattr(record, "keys_of", lambda motion: ())
    world = SimpleNamespace(scene=None, digest="", task=SimpleNamespace(motion=None))
    cfg = {"episodes": 1, "host": "", "port": 0, "seed": 0, "out": str(tmp_path / "demos")}
    with record.driven(OmegaConf.create(cfg), world) as found:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is not signal.SIG_IGN:
                pytest.fail(f"{number!r} would interrupt")
    assert found == "episodes"


def test_driven_episodes_are_kept_while_a_disk_is_full(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(record, "PAUSE", 0.0)
    tried = list[int]()

    def write() -> str:
        tried.append(len(tried))
        if len(tried) < 3:
            raise OSError(errno.ENOSPC, "cannot write: No space left on device", "demos")
        return "written"

    assert record.patiently(write) == "written"
    said = capsys.readouterr().err.splitlines()
    assert len(tried) == 3 and len(said) == 2
    assert "cannot write: No space left on device: 'demos'; the episodes are kept, and written in 0 s" in said[0]


def test_driven_episodes_are_written_once_into_each_folder_though_the_terminal_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Closed(io.StringIO):
        def write(self, text: str) -> int:
            raise OSError(errno.EIO, "Input/output error")

    @contextmanager
    def driven(cfg: DictConfig, world: World) -> Iterator[Demonstrations]:
        found = planner_episodes(world, 1)
        for name in ("stdout", "stderr"):
            monkeypatch.setattr(sys, name, Closed())
        yield found

    really, room = record.write_demonstrations, iter([False, True])

    def write_demonstrations(*given: Any) -> None:
        if not next(room):  # a second copy would be one too many
            raise OSError(errno.ENOSPC, "No space left on device")
        really(*given)

    for name, made in (("driven", driven), ("write_demonstrations", write_demonstrations), ("PAUSE", 0.0)):
        monkeypatch.setattr(record, name, made)
    out, lerobot = tmp_path / "demos", tmp_path / "lerobot"
    words = ["by=keys", f"out={out}", f"lerobot={lerobot}"]
    record.run(load_config([*tiny_overrides(tmp_path), *words], "record"))
    assert len(read_demonstrations(out).starts) == 1 and (lerobot / "meta" / "info.json").is_file()


def test_a_recording_without_episodes_writes_nothing(tmp_path: Path) -> None:
    scene = tiny_overrides(tmp_path)
    recording = command("record", *scene, "by=keys", "episodes=2", f"out={tmp_path / 'demos'}", "port=0")
    visitor = page_of(recording)
    visitor.click("save the kept episodes and stop")
    output, _ = recording.communicate(timeout=60)
    assert recording.returncode == 1
    assert "splatrl-record: by=keys: expected at least one episode that reached the goal, got none" in output
    assert not (tmp_path / "demos").exists()
    visitor.close()


def test_a_folder_that_cannot_be_written_is_refused_before_the_page_opens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuses(dir: Path) -> NoReturn:
        raise PermissionError(errno.EACCES, "of a folder for reading", str(dir))

    monkeypatch.setattr(tempfile, "TemporaryFile", refuses)
    monkeypatch.setattr(sys, "argv", ["splatrl-record", "by=keys", "port=70000", f"out={tmp_path / 'new'}"])
    with pytest.raises(SystemExit, match=f"cannot write: Permission denied: '{tmp_path}'"):
        record.main()


def test_an_invalid_value_of_by_is_refused_with_the_choices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["splatrl-record", "by=me", f"out={tmp_path / 'new'}"])
    with pytest.raises(SystemExit, match="by: expected planner, teacher or keys, got me"):
        record.main()
