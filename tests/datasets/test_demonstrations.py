"""Demonstrations are recorded on shortest paths, saved and read back, and replayed byte for byte."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from PIL import Image
from tensordict import TensorDict
from torchrl.data import SliceSampler, TensorDictReplayBuffer, TensorStorage

from splatrl.building import build_world
from splatrl.configuration import load_config
from splatrl.datasets import (
    Demonstrations,
    planner_episodes,
    read_demonstrations,
    replay,
    teacher_episodes,
    write_demonstrations,
)
from splatrl.envs.tasks import Outcome
from splatrl.envs.world import World
from tests.tiny import LONG_STEPS, tiny_overrides

EPISODES = 40
SENSING = ["sensors=[rgb,depth,gps,compass,contact,lidar]"]
SHAKEN = ["transforms/pose_noise=unsteady", "memory=stack"]
TWICE = ["transforms/skip=four", "transforms.skip.steps=2"]
LATE = ["transforms/latency=varied", "transforms/appearance=varied", "transforms.appearance.noise=0"]


def make_world(folder: Path, task: str = "grid", *more: str) -> World:
    return build_world(load_config([*tiny_overrides(folder, task), *more]))


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> World:
    return make_world(tmp_path_factory.mktemp("world"))


@pytest.fixture(scope="module")
def shown(world: World) -> Demonstrations:
    return planner_episodes(world, EPISODES, seed=3)


@pytest.fixture(scope="module")
def folder(shown: Demonstrations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("demos")
    write_demonstrations(path, shown, {"by": "planner"})
    return path


def test_the_planner_walks_shortest_paths_to_the_goal(world: World, shown: Demonstrations) -> None:
    shown.check()
    assert len(shown.starts) == EPISODES and int(shown.lengths.sum()) == len(shown)
    begun = shown.frames["state"][shown.starts]
    assert torch.equal(world.plan.cost_to_go(begun).long(), shown.lengths)
    ends = shown.starts + shown.lengths - 1
    assert (shown.frames["next", "outcome"][ends] == Outcome.GOAL).all()
    assert not shown.frames["next", "done"][:-1][shown.frames["frame"][1:] > 0].any()
    assert len(torch.unique(begun, dim=0)) == EPISODES, "no start is repeated while others are left"
    best = world.plan.optimal(shown.frames["state"])
    assert best.gather(1, shown.frames["action"].unsqueeze(1)).all()
    assert torch.equal(shown.frames["optimal"], best)
    assert shown.frames["pixels"].shape == (len(shown), 12, 16, 3)


def test_the_same_seed_gives_the_same_bytes(world: World, shown: Demonstrations) -> None:
    again, other = (planner_episodes(world, EPISODES, seed=seed) for seed in (3, 4))
    assert (again.frames == shown.frames).all()
    assert not torch.equal(other.frames["state"][:5], shown.frames["state"][:5])


def test_demonstrations_are_read_back_by_splatrl_tensordict_and_torchrl(shown: Demonstrations, folder: Path) -> None:
    found = read_demonstrations(folder)
    assert (found.frames == shown.frames).all() and found.action_names == shown.action_names
    frames = TensorDict.load_memmap(folder / "memmap")
    assert (frames == shown.frames).all()
    sampler = SliceSampler(num_slices=4, traj_key="episode", strict_length=False)
    buffer = TensorDictReplayBuffer(storage=TensorStorage(frames), sampler=sampler, batch_size=16)
    assert buffer.sample()["pixels"].shape[1:] == (12, 16, 3)


def test_a_replay_gives_the_same_bytes(world: World, folder: Path) -> None:
    found = read_demonstrations(folder)
    counted: list[int] = []
    different, views = replay(world, found, counted.append)
    assert different == [] and views == len(found) == sum(counted)


@pytest.mark.parametrize(
    ("key", "line"),
    [
        ("action", "state: differs in"),
        (("next", "reward"), "next.reward: differs in 1 frames"),
        (("next", "state"), "next.state: differs in 1 frames"),
        ("pixels", ""),
    ],
)
def test_a_replay_detects_changed_frames(
    world: World, shown: Demonstrations, key: str | tuple[str, str], line: str
) -> None:
    frames = shown.frames.clone()
    row = int(shown.lengths.argmax())
    at = int(shown.starts[row])
    changed = frames[key][at]
    frames[key][at] = (changed + 2) % 6 if key == "action" else changed + 1
    different, views = replay(world, Demonstrations(frames, shown.action_names))
    if line:
        assert any(found.startswith(line) for found in different)
    else:
        assert different == [] and views == len(frames) - 1


@pytest.mark.parametrize(
    ("task", "more"),
    [
        *[("drive", LATE), ("grid", SHAKEN), ("grid", SENSING), ("grid", TWICE)],
        *[pytest.param(task, [], marks=pytest.mark.slow) for task in ("fps", "apple")],
        *[("grid", [*LATE, f"transforms.latency.action={delays}"]) for delays in ("[0,0]", "[1,1]", "[0,1]")],
    ],
)
def test_other_tasks_are_recorded_and_replayed(task: str, more: list[str], tmp_path: Path) -> None:
    coarse = ["task.motion.spacing=0.5"] if task != "grid" else []
    turns = ["task.motion.angle_step_deg=45.0", "task.motion.step=0.25"] if task in ("fps", "apple") else []
    world = make_world(tmp_path, task, *coarse, *turns, "task.max_steps=40", *more)
    shown = planner_episodes(world, 5)
    shown.check()
    assert shown.frames["pixels"].shape[1:] == (12, 16, 3)
    write_demonstrations(tmp_path, shown)
    different, views = replay(world, read_demonstrations(tmp_path))
    assert different == [] and (views == len(shown)) == (more != SHAKEN), "pose noise is drawn anew in a replay"
    assert read_demonstrations(tmp_path).repeats == world.repeats == (2 if more == TWICE else 1)
    if more == SENSING:
        assert {"depth", "gps", "compass", "contact", "lidar"} <= set(read_demonstrations(tmp_path).frames.keys())


@pytest.mark.parametrize(
    ("task", "more"),
    [
        *[("pointnav", ["motion@task.motion=drive"]), ("imagenav", LATE), ("route", ["task.motion.time_step=0.05"])],
        *[pytest.param(task, [], marks=pytest.mark.slow) for task in ("gates", "push", "walk")],
    ],
)
def test_teachers_are_recorded_and_replayed_in_batches_of_any_size(task: str, more: list[str], tmp_path: Path) -> None:
    if task not in ("pointnav", "imagenav"):
        pytest.importorskip("mujoco", reason="needs the extra physics")
    world = make_world(tmp_path, task, *more, "task.max_steps=90")
    counted: list[int] = []
    shown = teacher_episodes(world, 4, 1, counted.append)
    shown.check()
    assert len(shown.starts) == sum(counted) == 4
    ends = shown.starts + shown.lengths - 1
    assert shown.frames["next", "success"][ends].all()
    assert shown.fps == {"gates": 20, "imagenav": 10, "route": 20}.get(task, 5)
    memory = {key: shown.frames[key] for key in world.task.memory_spec}
    taught = world.task.teach(shown.frames["state"], memory)
    assert taught is not None and torch.equal(taught.to(shown.frames["action"].dtype), shown.frames["action"])
    write_demonstrations(tmp_path, shown)
    assert replay(world, read_demonstrations(tmp_path)) == ([], len(shown))
    if task == "pointnav":
        longer = teacher_episodes(world, 6, seed=1)
        assert (longer.frames[: len(shown)] == shown.frames).all(), "how many are asked for changes none of them"


def test_a_teacher_that_fails_or_does_not_exist_is_refused(world: World, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="teacher: expected a task with a teacher of its own, got Grid"):
        teacher_episodes(world, 1)
    hurried = make_world(tmp_path, "pointnav", "task.max_steps=1")
    with pytest.raises(ValueError, match="of PointNav succeeds, got only 0 of 128; the others ended 128 in timeout"):
        teacher_episodes(hurried, 3)


def test_stacked_frames_match_those_of_the_env(tmp_path: Path) -> None:
    world = make_world(tmp_path, "grid", "memory=stack")
    shown = planner_episodes(world, 6)
    stacked = shown.stacked(4)
    env = world.env(1)
    for start, length in zip(shown.starts.tolist(), shown.lengths.tolist(), strict=True):
        now = env.reset(TensorDict({"state": shown.frames["state"][start : start + 1]}, [1]), set_state=True)
        for row in range(start, start + length):
            assert torch.equal(now["pixels"][0], stacked[row])
            now = env.step_mdp(env.step(now.set("action", shown.frames["action"][row : row + 1])))


def test_returns_are_discounted_to_the_end_of_each_episode(shown: Demonstrations) -> None:
    returns, reward = shown.returns(0.5), shown.frames["next", "reward"].squeeze(1)
    start, length = int(shown.starts[1]), int(shown.lengths[1])
    expected = sum(float(reward[start + step]) * 0.5**step for step in range(length))
    assert float(returns[start]) == pytest.approx(expected)
    assert torch.equal(returns[shown.starts + shown.lengths - 1], reward[shown.starts + shown.lengths - 1])


def test_demonstrations_begin_where_an_episode_is_long_enough_for_them(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="training leaves them out"):
        world = make_world(tmp_path, "grid", "task.max_steps=1")
    assert planner_episodes(world, 60).lengths.tolist() == [1] * 60


def test_a_task_without_goal_states_has_no_planner(world: World) -> None:
    aimless = replace(world, plan=replace(world.plan, field=None))
    with pytest.raises(ValueError, match="planner: expected a task whose episodes end at goal states, got Grid"):
        planner_episodes(aimless, 1)


def test_the_planner_says_that_the_goal_was_never_in_view_where_its_paths_end(tmp_path: Path) -> None:
    Image.new("RGBA", (8, 8), (0, 200, 0, 255)).save(tmp_path / "green.png")
    green = [*LONG_STEPS, f"drawing.sprite={tmp_path / 'green.png'}", "task.sprite_share=0.3", "drawing.size=0.5"]
    assert len(planner_episodes(make_world(tmp_path, "apple", *green), 3).starts) == 3
    elsewhere = make_world(tmp_path, "apple", *green, "drawing.position=[0,0,-9]")
    with pytest.raises(ValueError, match=r"got only 0 of 128; [1-9]\d* stood where paths end, but the task did not"):
        planner_episodes(elsewhere, 3)


def test_the_required_disk_space_is_enough_for_all_files(
    shown: Demonstrations, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []
    monkeypatch.setattr("splatrl.datasets.folder.require_room", lambda path, size: asked.append(size))
    write_demonstrations(tmp_path, shown)
    blocks = sum(512 * path.stat().st_blocks for path in tmp_path.rglob("*"))
    assert asked[0] >= blocks


def edit(name: str, change: Callable[[dict], object]) -> Callable[[Path], None]:
    """Return a function that changes a JSON file in a folder."""

    def done(folder: Path) -> None:
        content = json.loads((folder / name).read_text())
        change(content)
        (folder / name).write_text(json.dumps(content))

    return done


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / "demonstrations.json").unlink(), "expected a folder of demonstrations"),
        (edit("demonstrations.json", lambda facts: facts.update(version=1)), "version 3, got 1; record them again"),
        (edit("demonstrations.json", lambda facts: facts.update(action_names=3)), "a list of names under action_names"),
        (
            edit("demonstrations.json", lambda facts: facts.update(fps=0)),
            "fps: expected a whole number from 1 to 1000, got 0",
        ),
        (edit("demonstrations.json", lambda facts: facts.update(scene=[1])), "a fingerprint under scene, got .1."),
        (edit("demonstrations.json", lambda facts: facts.pop("repeats")), "repeats: .* from 1 to 1000, got None"),
        (edit("memmap/meta.json", lambda meta: meta.pop("action")), "expected entries for action"),
        (edit("memmap/meta.json", lambda meta: meta["pixels"].update(shape=[2**40, 3])), "pixels.memmap: expected"),
        (edit("memmap/meta.json", lambda meta: meta["pixels"].update(shape=[-1])), "expected a shape"),
        (edit("memmap/meta.json", lambda meta: meta["action"].update(dtype="torch.load")), "expected a shape"),
        (edit("memmap/meta.json", lambda meta: meta.update({"../x": meta["action"]})), "expected a name"),
        (edit("demonstrations.json", lambda facts: facts.update(action_names=["go"])), "optimal as torch.bool .N, 1."),
        (edit("memmap/next/meta.json", lambda meta: meta.pop("done")), "expected entries for done, found none"),
        (lambda folder: (folder / "memmap" / "action.memmap").write_bytes(b"12345678"), "action.memmap: expected"),
        (lambda folder: (folder / "memmap" / "state.memmap").unlink(), "state.memmap: expected a file"),
        (lambda folder: zeroed(folder / "memmap" / "frame.memmap"), "expected complete episodes"),
        (lambda folder: zeroed(folder / "memmap" / "next" / "done.memmap"), "expected complete episodes"),
        (edit("memmap/meta.json", lambda meta: meta["pixels"]["shape"].insert(1, 1)), "expected the shapes and dtypes"),
    ],
)
def test_a_damaged_folder_is_refused(
    folder: Path, damage: Callable[[Path], None], message: str, tmp_path: Path
) -> None:
    other = tmp_path / "demos"
    shutil.copytree(folder, other)
    damage(other)
    with pytest.raises((ValueError, FileNotFoundError), match=message) as raised:
        read_demonstrations(other)
    assert str(other) in str(raised.value)


def zeroed(path: Path) -> None:
    path.write_bytes(bytes(path.stat().st_size))
