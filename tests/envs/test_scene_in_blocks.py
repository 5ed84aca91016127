"""Robots in a scene that is cut into blocks behave as in the whole scene."""

from pathlib import Path

import numpy as np
import pytest
import torch

from splatrl.building import build_world
from splatrl.configuration import load_config
from splatrl.curriculum import Curriculum
from splatrl.envs.world import World
from splatrl.renderers import BlockRenderer, CudaRenderer
from splatrl.scenes import read_scene
from splatrl.scenes.description import read_description
from splatrl.scenes.splitting import write_split
from tests.two_rooms import overrides, two_rooms


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A room as one splat, and in blocks whose borders robots cross."""
    west, _ = two_rooms(tmp_path_factory.mktemp("rooms"))
    blocks = tmp_path_factory.mktemp("blocks")
    proposals = {key: value for key, value in read_description(west).items() if key != "splat"}
    assert len(write_split(blocks, read_scene(west), 1.1, proposals=proposals)) > 8
    return west, blocks


def world_in(folder: Path, *words: str) -> World:
    world = build_world(load_config([*overrides(), f"scene={folder}", "renderer.cache=null", *words]))
    assert isinstance(world, World)
    return world


def test_voxels_paths_and_episodes_equal_those_of_the_whole_scene(folders: tuple[Path, Path]) -> None:
    whole, cut = (world_in(folder, "renderer.tolerance=0") for folder in folders)
    assert isinstance(cut.drawing.renderer, BlockRenderer)
    assert np.array_equal(whole.occupancy.keys(), cut.occupancy.keys())
    assert whole.occupancy.count > 100
    assert torch.equal(whole.plan.distance, cut.plan.distance)
    assert torch.equal(whole.plan.start_rows, cut.plan.start_rows)
    rollouts = []
    for world in (whole, cut):
        torch.manual_seed(0)
        env = world.env(6, Curriculum([world.plan], first=None), seed=0)
        rollouts.append(env.rollout(40, break_when_any_done=False))
    for key in ("state", "action", ("next", "reward"), ("next", "done")):
        assert torch.equal(rollouts[0][key], rollouts[1][key]), key
    pixels = [rollout["pixels"] for rollout in rollouts]
    assert (pixels[0] != pixels[1]).float().mean() < 1e-4
    assert pixels[0].float().std() > 10


@pytest.mark.parametrize("budget", [1e3, 0, "much"])
def test_an_invalid_budget_is_refused_by_its_key(folders: tuple[Path, Path], budget: object) -> None:
    with pytest.raises(ValueError, match=r"renderer.budget: expected"):
        world_in(folders[1], f"renderer.budget={budget}")


def test_a_folder_of_blocks_is_drawn_in_blocks_unless_another_renderer_is_chosen(folders: tuple[Path, Path]) -> None:
    whole, cut = folders
    words = [
        ([f"scene={cut}"], "BlockRenderer"),
        ([f"scene={cut}", "renderer=reference"], "ReferenceRenderer"),
        ([f"scene={whole}"], "NativeRenderer"),
        (["scene=town"], "BlockRenderer"),
        (["scene=town", "renderer=auto"], "NativeRenderer"),
        (["scene=many", "scene.paths=[yard:1,town]"], "BlockRenderer"),
        (["scene=many", "scene.paths=[yard:1,backyard]"], "NativeRenderer"),
        (["scene=many", f"scene.paths=[{cut},{whole}]", "renderer=reference"], "ReferenceRenderer"),
        (["scene=many", f"scene.paths=[{cut},town,{whole}]"], "BlockRenderer"),
    ]
    for typed, renderer in words:
        cfg = load_config(typed)
        assert cfg.renderer.cpu._target_ == f"splatrl.renderers.{renderer}", typed
    stated = load_config([f"scene={cut}"])
    assert stated.landmarks.goal == [0.5, 1.0, 0.0]
    assert stated.robot.height == 0.5
    targets = [place.scene._target_.removeprefix("splatrl.") for place in cfg.scene.places]
    assert targets == ["read_scene", "town", "read_scene"]


def test_scenes_in_blocks_and_others_share_a_batch(folders: tuple[Path, Path]) -> None:
    whole, cut = folders
    words = [*overrides(), "scene=many", f"scene.paths=[{cut},{whole}]", "renderer.tolerance=0"]
    world = build_world(load_config(words))
    env = world.env(4, seed=0)
    rollout = env.rollout(12, break_when_any_done=False)
    assert rollout["scene"].unique().tolist() == [0, 1]
    start = rollout[:, 0].select("state", "scene")
    swapped = start.clone()
    swapped["scene"] = 1 - start["scene"]
    here, there = (env.reset(given, set_state=True)["pixels"] for given in (start, swapped))
    assert (here != there).float().mean() < 1e-3


@pytest.mark.parametrize("many", [False, True])
def test_robots_in_blocks_see_the_same_with_the_gpu_renderer(folders: tuple[Path, Path], many: bool) -> None:
    whole, cut = folders
    scene = ["scene=many", f"scene.paths=[{cut},{whole}]"] if many else [f"scene={cut}"]
    cfg = load_config([*overrides(), *scene, "renderer.cache=null", "allow_targets=[tests]"])
    assert cfg.renderer.cuda._target_ == "splatrl.renderers.CudaRenderer"
    emulated = {**cfg.renderer.cuda, "_target_": "tests.renderers.test_cuda.emulated_renderer"}
    rollouts = []
    for node in (cfg.renderer.cpu, emulated):
        cfg.renderer.cpu = node
        world = build_world(cfg)
        torch.manual_seed(0)
        rollouts.append(world.env(4, seed=0).rollout(8, break_when_any_done=False))
        assert isinstance(world.drawing.renderer, CudaRenderer) == (node is emulated)
    assert torch.equal(rollouts[0]["state"], rollouts[1]["state"])
    pixels = [rollout["pixels"].float() for rollout in rollouts]
    assert ((pixels[0] - pixels[1]).abs() <= 1).float().mean() >= 0.999
    assert pixels[0].std() > 10
