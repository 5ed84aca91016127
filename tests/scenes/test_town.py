"""The generated town: its plan, its things and its cache."""

import os
import time
from pathlib import Path

import numpy as np
import pytest
import torch

import splatrl
from splatrl.building import build_world
from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.configuration import load_config
from splatrl.renderers import NativeRenderer
from splatrl.scenes.blocks import BlockScene
from splatrl.scenes.cache import DAY, cached_arrays
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.town import source
from splatrl.scenes.town.build import STEP, around_gaussians, block_gaussians, crossing, house, lawn, streets, things
from splatrl.scenes.town.plan import SIZE, STREET, drawn_plot, house_solids
from splatrl.scenes.yard.generator import to_gaussians
from splatrl.scenes.yard.surfels import join

CORNERS = [(column, row) for column in (-1, 0) for row in (-1, 0)]


def paved(seed: int, column: int, row: int) -> Gaussians:
    """Return a block with only its streets and the things on its crossing, which is quick to generate."""
    plot = drawn_plot(seed, column, row)
    return to_gaussians(join([streets(plot, seed), *crossing(plot, seed)]))


@pytest.fixture
def quick(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make towns of coarse streets only, and return the folder of a cache of their own."""
    monkeypatch.setattr("splatrl.scenes.town.build.STEP", 0.4)
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path))
    monkeypatch.setattr(source, "block_gaussians", paved)
    return tmp_path


@pytest.mark.parametrize("place", [(0, 0), (-3, 2), (4, -5)])
def test_houses_yard_and_streets_of_a_block_do_not_overlap(place: tuple[int, int]) -> None:
    plot = drawn_plot(5, *place)
    low, high = np.array(plot.corner) + STREET, np.array(plot.corner) + SIZE - STREET
    rects = [(*solid.low[:2], *solid.high[:2]) for solid in house_solids(plot)]
    x, y = plot.garden
    x0, y0, x1, y1 = plot.yard.laid.outline
    rects.append((x0 + x, y0 + y, x1 + x, y1 + y))
    for a, b, c, d in rects:
        assert low[0] < a < c < high[0] and low[1] < b < d < high[1]
    for first, (a, b, c, d) in enumerate(rects):
        for e, f, g, h in rects[:first]:
            assert c <= e or g <= a or d <= f or h <= b
    for solid in things(plot):
        assert solid.high[0] < plot.corner[0] + SIZE and solid.low[0] > plot.corner[0]


def test_a_plan_depends_only_on_its_seed_and_place() -> None:
    again = drawn_plot.__wrapped__(0, 1, 2)
    assert (again.houses, again.trees) == (drawn_plot(0, 1, 2).houses, drawn_plot(0, 1, 2).trees)
    assert drawn_plot(0, 1, 2).houses != drawn_plot(1, 1, 2).houses
    assert drawn_plot(0, 1, 2).style.light.sun.tolist() == drawn_plot(0, 7, 7).style.light.sun.tolist()


def test_streets_continue_across_block_borders_without_a_gap_or_a_step() -> None:
    here, there = (streets(drawn_plot(3, column, 0), 3) for column in (-1, 0))
    beside = [part.means[np.abs(part.means[:, 0]) < STEP] for part in (here, there)]
    assert [np.round(np.abs(means[:, 0]), 6).tolist() for means in beside] == [[STEP / 2] * 250] * 2
    assert np.allclose(beside[0][:, 1], beside[1][:, 1])
    colors = [part.colors[np.abs(part.means[:, 0]) < STEP] for part in (here, there)]
    smooth = [part.reshape(25, 10, 3).mean((1, 2)) for part in colors]  # averages out the grain
    assert np.corrcoef(*smooth)[0, 1] > 0.7


def test_the_red_egg_is_in_view_from_the_goal_and_things_lie_across_borders() -> None:
    parts = {place: join(crossing(drawn_plot(0, *place), 0)) for place in CORNERS}
    assert sum(len(part) > 300 for part in parts.values()) >= 3
    assert crossing(drawn_plot(0, 2, 0), 0) == []
    cfg = load_config(["scene=town"])
    x, y, yaw = cfg.landmarks.goal
    eye = [x, y, cfg.robot.height]
    away = [x + np.cos(np.radians(yaw)), y + np.sin(np.radians(yaw)), cfg.robot.height]
    cameras = Cameras(look_at(eye, away)[None], intrinsics(1.2, 64, 64), 64, 64)
    red, green, blue = NativeRenderer(to_gaussians(join(parts.values()))).pixels(cameras)[0].float().unbind(2)
    middle = ((red > 120) & (green < 60) & (blue < 60))[16:48, 16:48]
    assert middle.float().mean() > 0.05


def test_a_town_is_generated_once_and_resumes_where_it_was_interrupted(
    quick: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = splatrl.town(seed=3, blocks=2)
    assert isinstance(scene, BlockScene)
    assert len(scene.blocks) == 5
    assert scene.bounds == source.MIDDLE
    means = scene.gaussians.means
    assert means[:, :2].abs().max() > 2 * SIZE  # the country around it
    (folder,) = quick.iterdir()
    kept = {path.name: path.read_bytes() for path in folder.iterdir()}
    monkeypatch.setattr(source, "block_gaussians", None)
    assert splatrl.town(seed=3, blocks=2, bounds=[[0, 0, 0], [1, 1, 1]]).bounds == ((0, 0, 0), (1, 1, 1))
    for name in ("blocks.yaml", source.DIGESTS, "block+0-1.spz"):
        (folder / name).unlink()
    monkeypatch.setattr(source, "block_gaussians", paved)
    splatrl.town(seed=3, blocks=2)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == kept


@pytest.mark.parametrize("damage", ["flipped", "cut", "removed", "emptied list", "emptied digests", "no digests"])
def test_what_is_damaged_in_the_cache_is_made_again_with_a_warning(
    quick: Path, monkeypatch: pytest.MonkeyPatch, damage: str
) -> None:
    splatrl.town(seed=3, blocks=1)
    (folder,) = quick.iterdir()
    kept = {path.name: path.read_bytes() for path in folder.iterdir()}
    block, content = folder / "block+0+0.spz", bytearray(kept["block+0+0.spz"])
    content[len(content) // 2] ^= 1
    made: list[tuple[int, ...]] = []
    monkeypatch.setattr(source, "block_gaussians", lambda *which: made.append(which) or paved(*which))
    if damage == "flipped":
        block.write_bytes(content)
    elif damage == "cut":
        block.write_bytes(content[:1000])
    elif damage == "removed":
        block.unlink()
    elif damage == "no digests":
        (folder / source.DIGESTS).write_text("{}")
    else:
        (folder / ("blocks.yaml" if damage == "emptied list" else source.DIGESTS)).write_text("")
    with pytest.warns(UserWarning, match=r"as it was written, got .* damaged or missing; making them again"):
        scene = splatrl.town(seed=3, blocks=1)
    assert len(scene.gaussians) > 0
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == kept
    assert made == ([] if damage == "emptied list" else [(3, 0, 0)])
    splatrl.town(seed=3, blocks=1)  # without a warning


def test_a_town_that_is_not_used_makes_room_in_the_cache(quick: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    splatrl.town(seed=3, blocks=1)
    (folder,) = quick.iterdir()
    then = time.time() - 2 * DAY
    os.utime(folder, (then, then))
    splatrl.town(seed=3, blocks=1)
    assert folder.stat().st_mtime > then + DAY  # marked as used
    os.utime(folder, (then, then))
    monkeypatch.setenv("SPLATRL_CACHE_GB", "0")
    cached_arrays(f"levels-{0:032x}", lambda: {"a": np.zeros(9)})
    assert [path.name for path in quick.iterdir()] == [f"levels-{0:032x}.npz"]


@pytest.mark.parametrize("wrong", [{"blocks": 0}, {"blocks": 32}, {"blocks": 2.5}, {"seed": -1}])
def test_numbers_out_of_range_are_refused_by_key(quick: Path, wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=rf"scene.{next(iter(wrong))}: expected a whole number"):
        splatrl.town(**wrong)  # type: ignore[arg-type]
    assert not list(quick.iterdir())


def test_a_cache_that_cannot_be_written_is_named_with_what_to_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path / "file" / "cache"))
    told = r"file/cache: cannot write the town here: Not a directory; set SPLATRL_CACHE to another folder"
    with pytest.raises(OSError, match=told):
        splatrl.town(blocks=1)


def test_starts_in_all_four_blocks_lead_to_the_goal_across_their_borders(quick: Path) -> None:
    words = ["scene=town", "scene.blocks=2", "task=grid", "device=cpu", "collision.occupancy.resolution=0.1"]
    world = build_world(load_config([*words, "scene.bounds=[[-2,-2,0],[2,2,1]]"]))
    places = world.worlds[0].task.motion.planar(world.worlds[0].plan.states)[world.worlds[0].plan.start_rows]
    assert {(bool(x > 0), bool(y > 0)) for x, y, _ in places.tolist()} == {
        (a, b) for a in (False, True) for b in (False, True)
    }
    assert world.worlds[0].occupancy.count > 500
    assert not world.worlds[0].plan.free.all()
    env = world.env(4, seed=0)
    pixels = env.rollout(5)["pixels"]
    assert pixels.float().std() > 10


def test_houses_stand_on_the_ground_and_grass_grows_around_them() -> None:
    plot, rng = drawn_plot(0, 0, 0), np.random.default_rng(0)
    size = plot.houses[0].size
    walls = house(size, plot.style, rng, plot.style.plaster[0])
    assert walls.means[:, 2].min() > 0.0
    assert walls.means[:, 2].max() > size[2] + 1.0
    green = lawn(plot, rng)
    for place in plot.houses:
        (a, b, _), (c, d, _) = place.solid.low, place.solid.high
        x, y = green.means[:, 0], green.means[:, 1]
        assert not ((x > a + 0.1) & (x < c - 0.1) & (y > b + 0.1) & (y < d - 0.1)).any()
    sky = around_gaussians(0, range(-5, 5), range(-5, 5))
    assert sky.means.norm(dim=1).max() > 200.0


@pytest.mark.slow
def test_a_full_block_has_over_a_hundred_thousand_gaussians_and_is_reproducible() -> None:
    block = block_gaussians(0, 0, 0)
    assert len(block) > 100_000
    assert torch.equal(block.means, block_gaussians(0, 0, 0).means)
