import threading

import pytest
import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.renderers import DeviceLatticeRenderer, LatticeRenderer, Parts
from tests.renderers.cases import TwoModels, random_cameras
from tests.renderers.parts_cases import at, placed, random_parts


class Counting(TwoModels):
    """Counts the frames that it draws, and accepts no mask, so the batch must hold only frames that are needed."""

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        assert only is None, "the cache asks only for what it lacks"
        return super().pixels(cameras, parts)


def test_pixels_are_those_of_the_renderer_and_each_view_is_rendered_once() -> None:
    inner, cameras = Counting(), random_cameras(1, 20)
    lattice, expected = LatticeRenderer(inner), inner.renderer.pixels(cameras)
    g = torch.Generator().manual_seed(2)
    for _ in range(30):
        rows = torch.randint(0, 20, (7,), generator=g)
        assert torch.equal(lattice.pixels(cameras[rows]), expected[rows])
    assert inner.rendered == len(lattice) == 20


def test_duplicates_within_a_batch_are_rendered_once() -> None:
    inner, cameras = Counting(), random_cameras(1, 3)
    rows = torch.tensor([2, 0, 2, 2, 1, 0])
    assert torch.equal(LatticeRenderer(inner).pixels(cameras[rows]), inner.renderer.pixels(cameras[rows]))
    assert inner.rendered == 3


def test_a_full_cache_still_gives_the_right_bytes_and_grows_no_further() -> None:
    inner, cameras = Counting(), random_cameras(1, 12)
    image_bytes = 37 * 22 * 3
    lattice, expected = LatticeRenderer(inner, max_bytes=5 * image_bytes + 1), inner.renderer.pixels(cameras)
    for start in (0, 4, 8, 0, 2):
        rows = torch.arange(start, min(start + 6, 12))
        assert torch.equal(lattice.pixels(cameras[rows]), expected[rows])
    assert len(lattice) == 5
    assert lattice.bytes_held() <= 5 * image_bytes
    before = inner.rendered
    lattice.pixels(cameras)
    assert inner.rendered == before + 7


def test_without_memory_every_view_is_rendered_each_time() -> None:
    inner, cameras = Counting(), random_cameras(1, 4)
    lattice = LatticeRenderer(inner, max_bytes=0)
    for _ in range(2):
        assert torch.equal(lattice.pixels(cameras), inner.renderer.pixels(cameras))
    assert len(lattice) == 0 and inner.rendered == 8


def test_another_lens_or_image_size_is_another_view() -> None:
    inner, cameras = Counting(), random_cameras(1, 2, 16, 12)
    lattice = LatticeRenderer(inner)
    wider = Cameras(cameras.camera_to_world, cameras.K, 17, 12)
    longer = Cameras(cameras.camera_to_world, cameras.K * torch.tensor([[1.1], [1.1], [1.0]]), 16, 12)
    for view in (cameras, wider, longer, wider, cameras):
        assert torch.equal(lattice.pixels(view), inner.renderer.pixels(view))
    assert inner.rendered == 6


def test_all_image_sizes_share_one_memory_bound() -> None:
    inner = Counting()
    lattice = LatticeRenderer(inner, max_bytes=3000)
    for width in (8, 9, 10):
        lattice.pixels(random_cameras(1, 4, width, 12))
    assert lattice.bytes_held() <= 3000
    assert 0 < len(lattice) < 12


def test_changes_that_the_caller_makes_to_images_are_not_cached() -> None:
    lattice, cameras = LatticeRenderer(Counting()), random_cameras(1, 3)
    first = lattice.pixels(cameras)
    expected = first.clone()
    first.zero_()
    second = lattice.pixels(cameras)
    second.zero_()
    assert torch.equal(lattice.pixels(cameras), expected)


class Interrupted(TwoModels):
    """While it draws the first batch, another thread asks the cache for a view of that batch."""

    other: threading.Thread | None = None

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        drawn = super().pixels(cameras, parts, only)
        if self.other is not None and self.other.ident is None:
            self.other.start()
            self.other.join(0.2)
        return drawn


@pytest.mark.parametrize("kind", [LatticeRenderer, DeviceLatticeRenderer])
def test_threads_that_share_a_cache_see_the_views_of_the_renderer(kind: type[LatticeRenderer]) -> None:
    inner, cameras = Interrupted(), random_cameras(1, 3)
    expected, lattice = inner.renderer.pixels(cameras), kind(inner)
    inner.other = threading.Thread(target=lattice.pixels, args=(cameras[:1],))
    first = lattice.pixels(cameras)
    inner.other.join()
    assert torch.equal(first, expected) and torch.equal(lattice.pixels(cameras), expected)
    assert inner.rendered == len(lattice) == 3


def test_render_bypasses_the_cache() -> None:
    inner, cameras = Counting(), random_cameras(1, 3)
    views = LatticeRenderer(inner).render(cameras)
    assert all(torch.equal(a, b) for a, b in zip(views, inner.render(cameras), strict=True))


def test_an_empty_batch_gives_no_images() -> None:
    lattice, cameras = LatticeRenderer(Counting()), random_cameras(1, 3)
    assert lattice.pixels(cameras[:0]).shape == (0, 22, 37, 3)
    lattice.pixels(cameras)
    assert lattice.pixels(cameras[:0]).shape == (0, 22, 37, 3)


def test_a_negative_memory_bound_is_refused() -> None:
    with pytest.raises(ValueError, match="max_bytes"):
        LatticeRenderer(Counting(), max_bytes=-1)


def test_another_part_or_another_pose_of_it_is_another_view() -> None:
    inner, cameras = Counting(), random_cameras(1, 2)
    lattice = LatticeRenderer(inner)
    here, there = placed(2, (0, at(0.0)), (1, at(0.2))), placed(2, (0, at(0.0)), (1, at(0.3)))
    other, none = placed(2, (0, at(0.0)), (0, at(0.2))), placed(2)
    shown = [None, here, there, other, none, placed(2, (0, at(0.0))), placed(2, (0, at(0.0)), (-1, at(0.2)))]
    for number, parts in enumerate([*shown, *shown]):
        assert torch.equal(lattice.pixels(cameras, parts), inner.renderer.pixels(cameras, parts))
        assert inner.rendered == 2 * min(number + 1, len(shown))


def test_the_pose_of_an_absent_part_makes_no_difference_to_the_view() -> None:
    inner, cameras = Counting(), random_cameras(1, 3)
    lattice, parts = LatticeRenderer(inner), placed(3, (1, at(0.1)), (-1, at(0.0)))
    expected = lattice.pixels(cameras, parts)
    parts.model_to_world[:, 1] = torch.nan
    assert torch.equal(lattice.pixels(cameras, parts), expected) and inner.rendered == 3


def test_views_with_parts_are_cached_across_batches() -> None:
    inner, cameras, parts = Counting(), random_cameras(1, 12), random_parts(2, 12, models=2)
    lattice, expected = LatticeRenderer(inner), inner.renderer.pixels(cameras, parts)
    g = torch.Generator().manual_seed(2)
    for _ in range(20):
        rows = torch.randint(0, 12, (7,), generator=g)
        assert torch.equal(lattice.pixels(cameras[rows], parts.rows(rows)), expected[rows])
    assert inner.rendered == len(lattice) == 12
    only = torch.arange(12) % 2 == 0
    assert torch.equal(lattice.pixels(cameras, parts, only), expected * only.view(-1, 1, 1, 1))
    views = zip(lattice.render(cameras, parts), inner.render(cameras, parts), strict=True)
    assert all(torch.equal(a, b) for a, b in views)


def test_parts_of_another_batch_are_refused_before_they_are_looked_up() -> None:
    with pytest.raises(ValueError, match=r"parts\.model: expected \[3, M\]"):
        LatticeRenderer(Counting()).pixels(random_cameras(1, 3), random_parts(2, 4))
