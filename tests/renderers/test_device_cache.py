"""Views cached on a device, which are looked up without synchronising with the host."""

import pytest
import torch

from splatrl.cameras import Cameras
from splatrl.device_faults import Faulty
from splatrl.renderers import DeviceLatticeRenderer, LatticeRenderer
from splatrl.renderers.device_cache import WAYS, DeviceAlbum
from splatrl.renderers.one_scene import OneScene
from tests.envs.devices import NoHostReads, Painter
from tests.renderers.cases import TwoModels, random_cameras
from tests.renderers.parts_cases import at, placed, random_parts


def lattice_around(inner: TwoModels, max_bytes: int = 2**22) -> DeviceLatticeRenderer:
    return DeviceLatticeRenderer(inner, max_bytes)


def test_pixels_are_those_of_the_renderer_and_each_view_is_drawn_once() -> None:
    inner, cameras = TwoModels(), random_cameras(1, 20)
    lattice, expected = lattice_around(inner), inner.renderer.pixels(cameras)
    g = torch.Generator().manual_seed(2)
    for _ in range(30):
        rows = torch.randperm(20, generator=g)[:7]
        assert torch.equal(lattice.pixels(cameras[rows]), expected[rows])
    assert inner.rendered == len(lattice) == 20
    assert 0 < lattice.bytes_held() <= 2**22


def test_only_one_of_several_rows_with_the_same_view_is_cached() -> None:
    inner, cameras = TwoModels(), random_cameras(1, 3)
    lattice, rows = lattice_around(inner), torch.tensor([2, 0, 2, 2, 1, 0])
    for frames in (6, 6):
        assert torch.equal(lattice.pixels(cameras[rows]), inner.renderer.pixels(cameras[rows]))
        assert inner.rendered == frames
    assert len(lattice) == 3


def test_views_of_one_set_are_cached_one_per_batch_until_the_set_is_full() -> None:
    inner, cameras = TwoModels(), random_cameras(1, WAYS + 4)
    lattice, expected = lattice_around(inner, WAYS * (37 * 22 * 3 + 4 * 25)), inner.renderer.pixels(cameras)
    for turn in range(WAYS + 6):  # there is one set, so each batch stores one view
        assert torch.equal(lattice.pixels(cameras), expected)
        assert len(lattice) == min(turn + 1, WAYS)
    for rows, drawn in ((slice(0, WAYS), 0), (slice(WAYS, WAYS + 4), 4)):  # the first rows were stored first
        before = inner.rendered
        assert torch.equal(lattice.pixels(cameras[rows]), expected[rows])
        assert inner.rendered == before + drawn


def test_rows_that_are_not_asked_for_are_zero_and_not_cached() -> None:
    inner, cameras = TwoModels(), random_cameras(1, 4)
    lattice, expected = lattice_around(inner), inner.renderer.pixels(cameras)
    only = torch.tensor([True, False, True, False])
    for _ in range(2):
        assert torch.equal(lattice.pixels(cameras, only=only), expected * only.view(-1, 1, 1, 1))
    assert inner.rendered == len(lattice) == 2
    assert torch.equal(lattice.pixels(cameras), expected)
    assert torch.equal(lattice.pixels(cameras, only=~only), expected * ~only.view(-1, 1, 1, 1))
    assert inner.rendered == 4
    with pytest.raises(ValueError, match=r"only: expected \[4\] torch.bool"):
        lattice.pixels(cameras, only=only.long())


def test_another_lens_image_size_or_pose_of_a_part_is_another_view() -> None:
    inner, cameras = TwoModels(), random_cameras(1, 2, 16, 12)
    lattice = lattice_around(inner)
    wider = Cameras(cameras.camera_to_world, cameras.K, 17, 12)
    longer = Cameras(cameras.camera_to_world, cameras.K * torch.tensor([[1.1], [1.1], [1.0]]), 16, 12)
    shown = [(one, None) for one in (cameras, wider, longer)]
    shown += [(cameras, placed(2, (0, at(0.0)), (1, at(x)))) for x in (0.2, 0.3)]
    shown += [(cameras, placed(2, *((0, at(x)) for x in xs))) for xs in ((), (0.0,), (0.0, 0.2))]
    for number, (view, parts) in enumerate([*shown, *shown]):
        assert torch.equal(lattice.pixels(view, parts), inner.renderer.pixels(view, parts))
        assert inner.rendered == 2 * min(number + 1, len(shown))


def test_the_pose_of_an_absent_part_makes_no_difference_to_the_view() -> None:
    inner, cameras = TwoModels(), random_cameras(1, 3)
    lattice, parts = lattice_around(inner), placed(3, (1, at(0.1)), (-1, at(0.0)))
    expected = lattice.pixels(cameras, parts)
    parts.model_to_world[:, 1] = torch.nan
    assert torch.equal(lattice.pixels(cameras, parts), expected) and inner.rendered == 3
    with pytest.raises(ValueError, match=r"parts\.model: expected \[3, M\]"):
        lattice.pixels(cameras, random_parts(2, 4))


def test_without_memory_or_rows_the_cache_returns_what_the_renderer_draws() -> None:
    inner, cameras = TwoModels(), random_cameras(1, 3)
    for max_bytes in (0, 2**22):
        lattice = lattice_around(inner, max_bytes)
        assert lattice.pixels(cameras[:0]).shape == (0, 22, 37, 3)
        assert torch.equal(lattice.pixels(cameras), inner.renderer.pixels(cameras))
        assert len(lattice) == (3 if max_bytes else 0)


def test_the_cache_never_synchronises_with_the_host() -> None:
    lattice, cameras = DeviceLatticeRenderer(Painter(), 2**22), random_cameras(1, 9)
    expected = Painter().pixels(cameras)
    with NoHostReads():
        seen = [lattice.pixels(cameras), lattice.pixels(cameras, only=cameras.camera_to_world[:, 0, 3] > 0)]
    assert torch.equal(seen[0], expected) and torch.equal(lattice.pixels(cameras), expected)


def test_keys_with_the_same_hash_are_told_apart() -> None:
    album = DeviceAlbum(2, torch.zeros(1, 1, 3, dtype=torch.uint8), 10**4)
    album._factors.zero_()  # every key has the same hash
    keys, images = torch.arange(10, dtype=torch.int32).view(5, 2), torch.arange(15, dtype=torch.uint8).view(5, 1, 1, 3)
    for _ in range(5):
        places, known = album.find(keys)
        album.add(keys, places, images, ~known)
    places, known = album.find(keys)
    assert known.all() and torch.equal(album.images[places], images)
    assert not album.find(keys + 1)[1].any()


def test_wrappers_pass_on_the_faults_of_a_renderer_if_it_records_any() -> None:
    class Recording(Painter):
        def raise_faults(self) -> None:
            raise ValueError("cameras[3]")

    for around in (LatticeRenderer, DeviceLatticeRenderer, lambda renderer: OneScene(renderer, 0)):
        assert not isinstance(around(Painter()), Faulty)  # or its env's steps would be captured in graphs
        with pytest.raises(ValueError, match="3"):
            around(Recording()).raise_faults()
