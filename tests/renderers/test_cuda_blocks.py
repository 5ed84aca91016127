"""Scenes in blocks on a GPU: the kernels' own source, emulated on the CPU and, where there is a GPU, run on it."""

from collections.abc import Callable
from typing import Any

import pytest
import torch

from splatrl.renderers import NativeRenderer, Parts
from splatrl.renderers.cuda import CudaRenderer
from splatrl.scenes.blocks import BlockScene
from tests.emulator import emulated
from tests.renderers.hills import hills, in_blocks, walkers
from tests.renderers.parts_cases import BACKGROUND, IDENTITY

Make = Callable[..., CudaRenderer]


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> BlockScene:
    scene = in_blocks(tmp_path_factory.mktemp("town"), hills(5000), 9.0)
    assert len(scene.blocks) == 6
    return scene


@pytest.fixture(params=["emulated", pytest.param("gpu", marks=pytest.mark.gpu)])
def make(request: pytest.FixtureRequest) -> Make:
    """Makes renderers on either machine."""
    where = {"load": emulated} if request.param == "emulated" else {"device": request.getfixturevalue("cuda_device")}

    def make_there(scenes: Any, **settings: Any) -> CudaRenderer:
        return CudaRenderer(scenes, background=BACKGROUND, **where, **settings)

    return make_there


def all_blocks(town: BlockScene, rows: int) -> Parts:
    """Rows that draw models 0, 1, … as the blocks, where they stand."""
    count = len(town.blocks)
    model = torch.arange(count).expand(rows, count).contiguous()
    return Parts(model, IDENTITY.expand(rows, count, 4, 4))


@pytest.mark.parametrize("tolerance", [0.0, 1.0])
def test_pictures_have_the_bytes_of_every_block_as_a_part(make: Make, town: BlockScene, tolerance: float) -> None:
    cameras = walkers(batch=4)
    renderer = make(town, tolerance=tolerance)
    parts = make([block.read() for block in town.blocks], tolerance=tolerance)
    for drawn, expected in zip(renderer.render(cameras), parts.render(cameras, all_blocks(town, 4)), strict=True):
        assert torch.equal(drawn, expected)
    renderer.raise_faults()


@pytest.mark.parametrize(("tolerance", "antialiased"), [(0.0, True), (1.0, True), (1.0, False)])
def test_pictures_look_as_on_the_cpu_with_all_blocks_in_memory(
    make: Make, town: BlockScene, tolerance: float, antialiased: bool
) -> None:
    cameras, settings = walkers(batch=6), {"tolerance": tolerance, "antialiased": antialiased}
    pixels = make(town, **settings).pixels(cameras)
    native = NativeRenderer([block.read() for block in town.blocks], background=BACKGROUND, **settings)
    expected = native.pixels(cameras, all_blocks(town, 6))
    assert ((pixels.int() - expected.int()).abs() <= 1).float().mean() >= 0.999
    if tolerance == 0.0:  # those of the merged scene
        merged = make(town.gaussians).pixels(cameras)
        assert (pixels != merged).float().mean() < 1e-4
    assert expected.float().std() > 20
