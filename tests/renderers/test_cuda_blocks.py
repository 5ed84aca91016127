"""Scenes in blocks on a GPU: the kernels' own source, emulated on the CPU and, if there is a GPU, run on that too."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from splatrl.native.cuda.compiler import NATIVE
from splatrl.renderers import ABSENT, NativeRenderer, Parts, cuda_models
from splatrl.renderers import cuda as cuda_module
from splatrl.renderers.cuda import CudaRenderer
from splatrl.renderers.cuda_trees import CLUSTER, Tree, joined
from splatrl.scenes import write_gaussians
from splatrl.scenes.blocks import Block, BlockScene
from tests.emulator import emulated
from tests.renderers.cases import random_gaussians
from tests.renderers.hills import hills, in_blocks, walkers
from tests.renderers.parts_cases import BACKGROUND, IDENTITY, at, placed, random_poses

Make = Callable[..., CudaRenderer]


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> BlockScene:
    scene = in_blocks(tmp_path_factory.mktemp("town"), hills(5000), 9.0)
    assert len(scene.blocks) == 6
    return scene


@pytest.fixture(params=["emulated", pytest.param("gpu", marks=pytest.mark.gpu)])
def make(request: pytest.FixtureRequest) -> Make:
    """A function that makes renderers, emulated or on a GPU."""
    where = {"load": emulated} if request.param == "emulated" else {"device": request.getfixturevalue("cuda_device")}

    def make_there(scenes: Any, **settings: Any) -> CudaRenderer:
        return CudaRenderer(scenes, background=BACKGROUND, **where, **settings)

    return make_there


def all_blocks(town: BlockScene, rows: int) -> Parts:
    """Return rows that draw the blocks as models 0, 1, …, where they stand."""
    count = len(town.blocks)
    model = torch.arange(count).expand(rows, count).contiguous()
    return Parts(model, IDENTITY.expand(rows, count, 4, 4))


@pytest.mark.parametrize("tolerance", [0.0, 1.0])
def test_images_have_the_same_bytes_as_with_every_block_drawn_as_a_part(
    make: Make, town: BlockScene, tolerance: float
) -> None:
    cameras = walkers(batch=4)
    renderer = make(town, tolerance=tolerance)
    parts = make([block.read() for block in town.blocks], tolerance=tolerance)
    for drawn, expected in zip(renderer.render(cameras), parts.render(cameras, all_blocks(town, 4)), strict=True):
        assert torch.equal(drawn, expected)
    renderer.raise_faults()


@pytest.mark.parametrize(("tolerance", "antialiased"), [(0.0, True), (1.0, True), (1.0, False)])
def test_images_look_the_same_as_on_the_cpu_with_all_blocks_in_memory(
    make: Make, town: BlockScene, tolerance: float, antialiased: bool
) -> None:
    cameras, settings = walkers(batch=6), {"tolerance": tolerance, "antialiased": antialiased}
    pixels = make(town, **settings).pixels(cameras)
    native = NativeRenderer([block.read() for block in town.blocks], background=BACKGROUND, **settings)
    expected = native.pixels(cameras, all_blocks(town, 6))
    assert ((pixels.int() - expected.int()).abs() <= 1).float().mean() >= 0.999
    if tolerance == 0.0:  # the merged scene looks the same, too
        merged = make(town.gaussians).pixels(cameras)
        assert (pixels != merged).float().mean() < 1e-4
    assert expected.float().std() > 20


def test_a_scene_in_blocks_shares_a_batch_with_others_and_models_move_through_it(make: Make, town: BlockScene) -> None:
    ball, cameras = random_gaussians(9, 60), walkers(batch=4)
    whole = [random_gaussians(5, 300), town, ball]
    moving = random_poses(3, 4, 2)
    moving[:, 1, :3, 3] = cameras.camera_to_world[:, :3, 3] + 3.0 * cameras.camera_to_world[:, :3, 2]
    parts = Parts(torch.tensor([[0, 2], [1, 2], [1, -1], [1, 2]]), moving)
    parts.model_to_world[1:3, 0] = IDENTITY  # in the last row the town itself is moved
    drawn = make(whole, tolerance=1.0).pixels(cameras, parts)
    native = NativeRenderer([whole[0], *(block.read() for block in town.blocks), ball], True, BACKGROUND, tolerance=1.0)
    count = len(town.blocks)
    model = torch.full((4, count + 1), ABSENT)
    model[0, 0] = 0
    model[1:, :count] = torch.arange(1, count + 1)
    model[:, -1] = torch.tensor([count + 1, count + 1, ABSENT, count + 1])
    poses = torch.cat([moving[:, :1].expand(4, count, 4, 4), moving[:, 1:]], 1)
    expected = native.pixels(cameras, Parts(model, poses))
    assert ((drawn.int() - expected.int()).abs() <= 1).float().mean() >= 0.999
    assert torch.equal(drawn[2:3], make(town, tolerance=1.0).pixels(cameras[2:3]))


def test_blocks_of_different_degrees_are_drawn_as_one_model(make: Make, tmp_path: Path) -> None:
    blocks = []
    for number, degree in enumerate((0, 2, 1)):
        cloud = random_gaussians(40 + number, 200, degree)
        cloud.means[:, 0] += 2.0 * number
        cloud.opacities.clamp_(min=0.1)
        write_gaussians(tmp_path / f"{number}.ply", cloud)
        blocks.append(Block(tmp_path / f"{number}.ply", ((2.0 * number, -1, -1), (2.0 * number + 2, 1, 1))))
    scene, cameras = BlockScene("mixed", blocks), walkers(batch=2)
    expected = make([block.read() for block in blocks]).render(cameras, all_blocks(scene, 2))
    for _ in range(2):  # first packed, then read from the cache
        for drawn, one in zip(make(scene).render(cameras), expected, strict=True):
            assert torch.equal(drawn, one)


@pytest.mark.parametrize("memory", [1, 12_000])  # room for one block of threads, and for two
@pytest.mark.parametrize("with_parts", [False, True])
def test_tiles_with_more_candidates_than_a_thread_block_has_room_for_are_drawn_correctly(
    make: Make, town: BlockScene, memory: int, with_parts: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    cameras = walkers(batch=4)
    parts = placed(4, (0, IDENTITY), (1, at(6.0, 4.0))) if with_parts else None
    models = [town, random_gaussians(9, 60)]
    roomy = make(models)
    expected, efforts = roomy.render(cameras, parts), roomy.efforts(cameras, parts)
    monkeypatch.setattr(cuda_module, "LEAST_KEYS", 300)
    tight = make(models, memory=memory)
    assert all(torch.equal(a, b) for a, b in zip(tight.render(cameras, parts), expected, strict=True))
    assert torch.equal(tight.efforts(cameras, parts), efforts)
    (working,) = tight._working.values()
    assert efforts[:, 0].max() > 4 * working.key_capacity  # one of a view's four tiles has more candidates than room
    only = torch.tensor([True, False, True, False])
    pixels = tight.pixels(cameras, parts, only)
    assert torch.equal(pixels[only], roomy.pixels(cameras, parts)[only]) and not pixels[~only].any()


def test_more_gaussians_than_the_index_in_a_key_can_address_are_refused(
    town: BlockScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cuda_models, "MOST_INDICES", 4000)
    message = (
        r"scene\[1\]: expected at most 4,000 Gaussians, merged ones included, got [45],\d{3} in its first [4-6] blocks"
    )
    with pytest.raises(ValueError, match=message):
        CudaRenderer([random_gaussians(0, 9), town], load=emulated)
    with pytest.raises(ValueError, match="tolerance: expected a finite number of pixels, at least 0, got -1"):
        CudaRenderer(town, tolerance=-1, load=emulated)


def test_the_index_in_a_key_has_as_many_bits_as_the_limit_on_gaussians_needs() -> None:
    assert f"INDEX_BITS = {cuda_models.MOST_INDICES.bit_length() - 1};" in (NATIVE / "cuda" / "tile.h").read_text()


def test_a_tree_joined_from_several_trees_bounds_and_reaches_each_of_them() -> None:
    trees = []
    for number, nodes in enumerate((1, 3, 1, 5, 1)):
        clusters = np.zeros(nodes, CLUSTER)
        clusters["center"][:, 0], clusters["radius"] = 10.0 * number, 1.0 + number
        clusters["reach"], clusters["reach_scale"] = 3.0 - 0.5 * number, 0.1 * number
        clusters["skip"], clusters["groups"] = np.arange(1, nodes + 1), 1
        clusters["skip"][0] = nodes
        clusters["first_group"] = number
        trees.append(Tree(clusters, np.full((nodes, 8), number, np.uint8)))
    clusters, group_bounds = joined(trees)
    roots, opened = [], [0]
    while opened:
        node = opened.pop()
        if clusters["groups"][node]:
            roots.append(node)
            continue
        assert clusters["error"][node] == np.inf and not group_bounds[node].any()
        below = [node + 1, clusters["skip"][node + 1]]
        assert clusters["skip"][below[1]] == clusters["skip"][node]
        for child in below:
            apart = np.linalg.norm(clusters["center"][child] - clusters["center"][node])
            assert apart + clusters["radius"][child] <= clusters["radius"][node]
            assert clusters["reach"][child] <= clusters["reach"][node]
            assert clusters["reach_scale"][child] <= clusters["reach_scale"][node]
        opened += below[::-1]
    assert clusters["radius"][0] < 40.0
    assert clusters["first_group"][roots].tolist() == group_bounds[roots, 0].tolist() == [0, 1, 2, 3, 4]
    assert [clusters["skip"][root] - root for root in roots] == [1, 3, 1, 5, 1]
