"""Scenes in blocks are drawn as if they were whole, whichever blocks are in memory."""

import functools
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.geometry import axis_rotations, rigid
from splatrl.renderers import BlockRenderer, NativeRenderer, Parts, block_needs, blocks, packed_blocks
from splatrl.scenes import Scene
from splatrl.scenes.blocks import BlockScene
from tests.renderers.cases import random_gaussians
from tests.renderers.hills import SIZE, hills, in_blocks, walkers
from tests.renderers.parts_cases import at, placed


@pytest.fixture(scope="module")
def whole() -> Scene:
    return hills()


@pytest.fixture(scope="module")
def town(whole: Scene, tmp_path_factory: pytest.TempPathFactory) -> BlockScene:
    scene = in_blocks(tmp_path_factory.mktemp("town"), whole, 4.0)
    assert len(scene.blocks) == 24
    return scene


@pytest.fixture(autouse=True)
def small_tops(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep tops small, since those of blocks of 500 Gaussians would otherwise be the whole blocks."""
    monkeypatch.setattr(blocks, "TOP_GROUPS", 20)


@pytest.fixture(scope="module")
def all_in_memory(town: BlockScene) -> Callable[[Cameras, float], Tensor]:
    """A function that draws every block whole, as a part, with a given tolerance."""
    models = [block.read() for block in town.blocks]
    made = functools.cache(lambda tolerance: NativeRenderer(models, tolerance=tolerance))
    count = len(models)

    def pixels(cameras: Cameras, tolerance: float) -> Tensor:
        model = torch.arange(count).expand(len(cameras), count).contiguous()
        drawn: Tensor = made(tolerance).pixels(cameras, Parts(model, torch.eye(4).expand(len(cameras), count, 4, 4)))
        return drawn

    return pixels


def room_for(renderer: BlockRenderer, count: int) -> int:
    """Return a budget for the tops and ``count`` whole blocks."""
    return renderer._tops + count * max(kept.bytes for kept in renderer._whole.values())


@pytest.mark.parametrize("antialiased", [True, False])
def test_exact_images_across_borders_match_those_of_one_merged_file(
    whole: Scene, town: BlockScene, antialiased: bool
) -> None:
    cameras = walkers()
    renderer = BlockRenderer(town, antialiased, background=(0.2, 0.4, 0.6))
    merged = NativeRenderer(whole.gaussians, antialiased, background=(0.2, 0.4, 0.6))
    drawn, expected = renderer.pixels(cameras), merged.pixels(cameras)
    assert (drawn != expected).float().mean() < 1e-4
    assert expected.float().std() > 20
    for ours, theirs in zip(renderer.render(cameras), merged.render(cameras), strict=True):
        apart = ~torch.isclose(ours, theirs, atol=5e-3, rtol=5e-3)  # files round, and ties are broken differently
        assert apart.float().mean() < 1e-4


@pytest.mark.parametrize("tolerance", [0.0, 1.0, 3.0])
def test_images_have_the_same_bytes_as_with_all_blocks_in_memory(
    town: BlockScene, all_in_memory: Callable[[Cameras, float], Tensor], tolerance: float
) -> None:
    cameras = walkers()
    assert torch.equal(BlockRenderer(town, tolerance=tolerance).pixels(cameras), all_in_memory(cameras, tolerance))


def test_distant_blocks_are_shown_by_merged_gaussians_that_stay_in_memory(
    town: BlockScene, all_in_memory: Callable[[Cameras, float], Tensor]
) -> None:
    above = Cameras(look_at([12.0, 8.0, 90.0], [12.0, 8.1, 0.0])[None], intrinsics(0.3, *SIZE), *SIZE)
    renderer = BlockRenderer(town, tolerance=1.0)
    assert renderer.bytes_held == renderer._tops > 0
    assert torch.equal(renderer.pixels(above), all_in_memory(above, 1.0))
    assert renderer.bytes_held == renderer._tops
    near = walkers(batch=1)
    renderer.pixels(near)
    assert 0 < renderer.bytes_held - renderer._tops < sum(kept.bytes for kept in renderer._whole.values()) // 2


@pytest.mark.parametrize("groups", [1, 5, 14])
def test_a_top_may_end_above_the_node_over_the_whole_block(
    town: BlockScene,
    all_in_memory: Callable[[Cameras, float], Tensor],
    groups: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(blocks, "TOP_GROUPS", groups)
    renderer = BlockRenderer(town, tolerance=1.0)
    above = [[12.0, 8.0, height] for height in (20.0, 60.0, 200.0, 2000.0)]
    cameras = Cameras(look_at(above, [12.0, 8.1, 0.0]), intrinsics(0.3, *SIZE), *SIZE)
    assert torch.equal(renderer.pixels(cameras), all_in_memory(cameras, 1.0))
    read = [sum(slot in renderer._whole for slot in row) for row in slots_of(renderer, cameras)]
    assert read[0] > 0 and read[3] == 0


def test_a_frame_has_the_same_bytes_in_any_batch_and_order_and_whatever_is_in_memory(town: BlockScene) -> None:
    cameras, g = walkers(), torch.Generator().manual_seed(3)
    roomy = BlockRenderer(town, tolerance=3.0)
    expected, depths = roomy.pixels(cameras), roomy.render(cameras).depth
    most = max(len([slot for slot in row if slot in roomy._whole]) for row in slots_of(roomy, cameras))
    assert most > 1
    tight = BlockRenderer(town, tolerance=3.0, budget=room_for(roomy, most))
    for _ in range(12):
        rows = torch.randint(0, len(cameras), (int(torch.randint(1, 9, (), generator=g)),), generator=g)
        assert torch.equal(tight.pixels(cameras[rows]), expected[rows])
        assert tight.bytes_held <= room_for(roomy, most)
    assert torch.equal(tight.pixels(cameras), expected)
    assert torch.equal(tight.render(cameras).depth, depths)
    assert len(tight._held) < len(roomy._held)


def slots_of(renderer: BlockRenderer, cameras: Cameras) -> list[list[int]]:
    """Return the slots of the core that each row draws."""
    seen = Parts(torch.zeros(len(cameras), 1, dtype=torch.int64), torch.eye(4).expand(len(cameras), 1, 4, 4))
    slots: list[list[int]] = renderer._placed_blocks(cameras, seen).model.tolist()
    return slots


def test_the_image_of_a_camera_that_needs_more_than_fits_does_not_depend_on_earlier_images(
    town: BlockScene,
) -> None:
    cameras = walkers()
    full = BlockRenderer(town, tolerance=1.0)
    budget = room_for(full, 1)
    fresh = torch.cat(
        [BlockRenderer(town, tolerance=1.0, budget=budget).pixels(cameras[row : row + 1]) for row in range(6)]
    )
    used = BlockRenderer(town, tolerance=1.0, budget=budget)
    for order in ([5, 4, 3, 2, 1, 0], [0, 2, 4, 1, 3, 5]):
        assert torch.equal(used.pixels(cameras[torch.tensor(order)]), fresh[order])
    assert used.bytes_held <= budget
    exact = full.pixels(cameras[:6])
    assert not torch.equal(fresh, exact)  # some blocks are shown by merged Gaussians
    assert (fresh.float() - exact.float()).abs().mean() < 10


def test_the_least_recently_used_block_is_evicted(town: BlockScene) -> None:
    renderer = BlockRenderer(town, tolerance=1.0)
    a, b, c = sorted(renderer._whole)[:3]
    tight = BlockRenderer(town, tolerance=1.0, budget=room_for(renderer, 2))
    for needed, held in (({a}, [a]), ({b}, [a, b]), ({a}, [b, a]), ({c}, [a, c]), ({b, c}, [c, b])):
        tight._keep(needed)
        assert list(tight._held) == held


def test_a_batch_that_does_not_fit_is_drawn_in_groups(town: BlockScene) -> None:
    cameras = walkers()
    roomy = BlockRenderer(town, tolerance=3.0)
    whole = [frozenset(slot for slot in row if slot in roomy._whole) for row in slots_of(roomy, cameras)]
    room = max(block_needs.size(row, roomy._whole) for row in whole)
    groups = list(block_needs.groups(whole, roomy._whole, room))
    assert 1 < len(groups) < len(cameras)
    assert sorted(row for group in groups for row in group) == list(range(len(cameras)))
    assert all(
        block_needs.size(frozenset().union(*(whole[row] for row in group)), roomy._whole) <= room for group in groups
    )


def test_a_scene_in_blocks_can_be_placed_beside_other_models(town: BlockScene, whole: Scene) -> None:
    ball, cameras = random_gaussians(9, 60), walkers(batch=2)
    pose = rigid(axis_rotations(2, torch.tensor(0.7)), torch.tensor([3.0, -2.0, 0.5]))
    parts = placed(2, (1, pose), (0, at(12.0, 8.0, 0.5)))
    mixed = BlockRenderer([ball, town], background=(0.2, 0.4, 0.6)).pixels(cameras, parts)
    expected = NativeRenderer([ball, whole.gaussians], background=(0.2, 0.4, 0.6)).pixels(cameras, parts)
    assert (mixed != expected).float().mean() < 1e-4
    only = torch.tensor([False, True])
    drawn = BlockRenderer([town, ball]).pixels(cameras, only=only)
    assert not drawn[0].any()
    assert torch.equal(drawn[1], BlockRenderer(town).pixels(cameras)[1])
    assert BlockRenderer(town).pixels(cameras[:0]).shape == (0, SIZE[1], SIZE[0], 3)


def test_a_pickled_renderer_draws_the_same(town: BlockScene) -> None:
    renderer, cameras = BlockRenderer(town, tolerance=1.0, budget=1e8), walkers(batch=3)
    again = pickle.loads(pickle.dumps(renderer))
    assert torch.equal(again.pixels(cameras), renderer.pixels(cameras))
    assert again._room == renderer._room


def test_a_row_that_sees_several_scenes_in_blocks_keeps_to_the_budget(town: BlockScene) -> None:
    cameras, two = walkers(batch=2), Parts(torch.tensor([[0, 1], [1, 0]]), torch.eye(4).expand(2, 2, 4, 4).contiguous())
    alone = BlockRenderer(town, tolerance=0.05)
    most = max(len(set(row) & alone._whole.keys()) for row in slots_of(alone, cameras))
    assert most >= 2
    roomy = BlockRenderer([town, town], tolerance=0.05)
    budget = room_for(roomy, most)
    tight = BlockRenderer([town, town], tolerance=0.05, budget=budget)
    tight.pixels(cameras, two)
    assert tight.bytes_held <= budget
    roomy.pixels(cameras, two)
    assert roomy.bytes_held > budget
    with pytest.raises(ValueError, match=r"expected at least [0-9,]+ bytes for the \d+ blocks that one camera sees"):
        BlockRenderer([town, town], tolerance=0.0, budget=room_for(BlockRenderer([town, town]), most)).pixels(
            cameras, two
        )


def test_a_budget_that_is_too_small_is_refused_with_the_bytes_that_are_needed(town: BlockScene) -> None:
    with pytest.raises(
        ValueError, match=r"renderer.budget: expected at least [0-9,]+ bytes, for the top of each block's tree"
    ):
        BlockRenderer(town, tolerance=1.0, budget=1e4)
    renderer = BlockRenderer(town, budget=room_for(BlockRenderer(town), 1))
    with pytest.raises(
        ValueError, match=r"renderer.budget: expected at least [0-9,]+ bytes for the \d+ blocks that one camera sees"
    ):
        renderer.pixels(walkers())
    with pytest.raises(ValueError, match=r"camera_to_world\[1\]: expected"):
        cameras = walkers(batch=3)
        cameras.camera_to_world[1] *= 2
        renderer.pixels(cameras)


def test_blocks_are_packed_once(town: BlockScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path))
    BlockRenderer(town, tolerance=1.0)
    assert len(list(tmp_path.glob("packed-*"))) == len(list(tmp_path.glob("top-*"))) == 24

    def repacked(*_: Any, **__: Any) -> None:
        raise RuntimeError("packed again")

    monkeypatch.setattr(packed_blocks, "packed_model", repacked)
    renderer = BlockRenderer(town, tolerance=1.0)
    renderer.pixels(walkers(batch=2))
    for damaged in tmp_path.glob("packed-*"):
        damaged.write_bytes(b"damaged")
    with (
        pytest.warns(UserWarning, match="expected a complete"),
        pytest.raises(RuntimeError, match="packed again"),
    ):
        BlockRenderer(town, tolerance=1.0).pixels(walkers(batch=2))
