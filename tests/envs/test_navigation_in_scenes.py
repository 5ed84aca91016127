"""Navigation and sensors with several scenes in one batch: each row equals the same row in its scene alone."""

import gzip
import json
from pathlib import Path

import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import check_env_specs

import splatrl
from splatrl.building import build_world
from splatrl.configuration import load_config
from splatrl.envs.world import World, Worlds
from splatrl.evaluation.evaluate import EvaluationSettings, Policy, evaluate
from splatrl.evaluation.pictures import Pictures
from splatrl.evaluation.recording import Recording, record_episodes
from splatrl.evaluation.rollouts import run_episodes
from splatrl.evaluation.starts import Chosen, given_episodes, save_episodes, spread_starts
from tests.two_rooms import in_both, overrides, two_rooms

FEW = ["task.goals=5", "task.test_goals=4", "task.nearest=0.3", "task.cell=0.1", "robot.body.radius=0.1"]
FEW += ["sensors=[depth,gps,lidar,pointgoal,imagegoal]", "sensors.lidar.beams=6"]


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> World | Worlds:
    return build_world(load_config([*in_both(tmp_path_factory.mktemp("both"), "pointnav"), *FEW]))


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> list[EnvBase]:
    rooms = two_rooms(tmp_path_factory.mktemp("alone"))
    return [splatrl.make_env([*overrides("pointnav"), f"scene={room}", *FEW], [1]) for room in rooms]


def test_every_row_is_what_it_would_be_in_its_scene_alone(both: World | Worlds, alone: list[EnvBase]) -> None:
    env = both.env(8, seed=3)
    check_env_specs(env, seed=0)
    torch.manual_seed(0)
    mixed = env.rollout(6, break_when_any_done=False)
    assert set(mixed["scene"].flatten().tolist()) == {0, 1}
    begins = both.task.geodesics.begins
    for step in mixed[:, ::2].flatten():
        scene = int(step["scene"])
        given = step.unsqueeze(0).exclude("next", "scene").clone()
        given["goal_row"] = given["goal_row"] - begins[scene]
        now = alone[scene].reset(given, set_state=True)
        for key in ("depth", "gps", "lidar", "pointgoal_with_gps_compass", "imagegoal"):
            assert torch.equal(now[key][0], step[key]), key
        now["action"] = step["action"].unsqueeze(0)
        after = alone[scene].step(now)["next"]
        for key in ("reward", "distance_to_goal", "path_length", "collisions", "lidar", "terminated"):
            assert torch.equal(after[key][0], step["next", key]), key


def test_episodes_are_drawn_in_each_scene_written_and_read_back(both: World | Worlds, tmp_path: Path) -> None:
    chosen = spread_starts(both, 6)
    assert chosen.scene is not None and chosen.scene.tolist() == [0, 0, 0, 1, 1, 1]
    path = tmp_path / "episodes.json.gz"
    save_episodes(path, both, chosen, 0.2)
    rows = json.loads(gzip.decompress(path.read_bytes()))["episodes"]
    assert [round(row["start_position"][1], 3) for row in rows] == [0.5] * 3 + [0.65] * 3
    world, again = given_episodes(both, path)
    torch.testing.assert_close(again.memory["start_distance"], chosen.memory["start_distance"], atol=1e-4, rtol=0)
    torch.testing.assert_close(again.memory["goal"], chosen.memory["goal"], atol=1e-4, rtol=0)

    def ahead(td):
        return td.set("action", torch.ones(len(td), dtype=torch.int64))

    one = run_episodes(both.env(4), ahead, chosen.state, scene=chosen.scene, memory=chosen.memory)
    other = run_episodes(world.env(4), ahead, again.state, scene=again.scene, memory=again.memory)
    torch.testing.assert_close(one.measures["distance_to_goal"], other.measures["distance_to_goal"], atol=1e-3, rtol=0)
    assert set(one.of(1).measures) == set(one.measures) and len(one.of(1).measures["collisions"]) == 3


def test_an_evaluation_shows_some_of_the_episodes_of_a_file_in_the_scenes_that_have_any(
    both: World | Worlds, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = spread_starts(both, 20)
    assert drawn.scene is not None
    order = (drawn.scene == 1).nonzero().flatten()[[9, 3, 5, 1, 8, 2, 7]]
    memory = {key: value[order] for key, value in drawn.memory.items()}
    chosen = Chosen(drawn.state[order], drawn.scene[order], drawn.distance[order], memory)
    save_episodes(tmp_path / "east.json.gz", both, chosen, 0.2)
    shown: list[tuple[Path, list[Recording], Chosen]] = []

    def video(pictures: Pictures, env: EnvBase, policy: Policy, seed: int, frames: int, chosen: Chosen) -> Path:
        recordings = record_episodes(env, policy, chosen.state, seed=seed, memory=chosen.memory)
        shown.append((pictures.folder, recordings, chosen))
        return pictures.folder / "rollouts.mp4"

    def ahead(td: TensorDictBase) -> TensorDictBase:
        return td.set("action", torch.ones(len(td), dtype=torch.int64))

    monkeypatch.setattr(Pictures, "video", video)
    checkpoint = {"ppo": {"frames": 8}, "seconds": 1.0, "history": [{"frames": 8}]}
    settings = EvaluationSettings("last", 20, 1, 4, 0, str(tmp_path / "east.json.gz"))
    summary, _ = evaluate(both, ahead, checkpoint, tmp_path, settings, seed=0)
    assert [(row["scene"], row["episodes"]) for row in summary["scenes"]] == [(both.names[1], 7)]
    assert json.loads((tmp_path / "evaluation.json").read_text(), parse_constant=pytest.fail) == summary
    ((folder, recordings, some),) = shown
    assert folder == tmp_path / "scenes" / f"1-{both.names[1]}" and len(recordings) == 4
    rows = torch.tensor([0, 2, 4, 6])
    torch.testing.assert_close(some.state, chosen.state[rows], atol=1e-4, rtol=0)
    torch.testing.assert_close(some.memory["goal"], memory["goal"][rows], atol=1e-4, rtol=0)
    torch.testing.assert_close(some.memory["start_distance"], memory["start_distance"][rows], atol=1e-4, rtol=0)


def test_scenes_with_the_same_name_keep_their_episodes_apart(tmp_path: Path) -> None:
    words = [*in_both(tmp_path, "pointnav"), *FEW]
    for place in ("west", "east"):
        with (tmp_path / place / "scene.yaml").open("a") as stream:
            stream.write("name: garden\n")
    world = build_world(load_config(words))
    assert world.names == ["garden", "garden-2"]
    chosen, path = spread_starts(world, 6), tmp_path / "episodes.json.gz"
    save_episodes(path, world, chosen, 0.2)
    _, again = given_episodes(world, path)
    assert again.scene is not None and again.scene.tolist() == [0, 0, 0, 1, 1, 1]
    chosen.state[4, 0] = 100.0
    save_episodes(path, world, chosen, 0.2)
    with pytest.raises(ValueError, match=r"gz: episode 4: expected a start .* got \[100.0, .*\] in scene garden-2"):
        given_episodes(world, path)
