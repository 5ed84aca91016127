"""The renderer for GPUs: its kernels' own source is emulated on the CPU and, if there is a GPU, run on that as well."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from splatrl import backyard
from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.renderers import NativeRenderer, RenderOutput, cuda
from splatrl.renderers.cuda import CudaRenderer, heaviest_first
from splatrl.scenes import Gaussians, Scene
from tests.emulator import emulated
from tests.renderers.cases import LIKENESS, ahead, ball, dust, gaussians, psnr, random_cameras, random_gaussians

Make = Callable[..., CudaRenderer]


@pytest.fixture(params=["emulated", pytest.param("gpu", marks=pytest.mark.gpu)])
def make(request: pytest.FixtureRequest) -> Make:
    """A function that makes renderers, emulated or on a GPU."""
    if request.param == "gpu":
        device = request.getfixturevalue("cuda_device")
        return lambda scene, *args, **options: CudaRenderer(scene, *args, device=device, **options)
    return emulated_renderer


def emulated_renderer(scene: Scene | Gaussians, *args: Any, **options: Any) -> CudaRenderer:
    """Return a renderer whose kernels are emulated on the CPU."""
    return CudaRenderer(scene, *args, load=emulated, **options)


def on(renderer: CudaRenderer, cameras: Cameras) -> Cameras:
    """Return the cameras on the renderer's device."""
    return Cameras(
        cameras.camera_to_world.to(renderer.device), cameras.K.to(renderer.device), cameras.width, cameras.height
    )


def assert_like_native(renderer: CudaRenderer, native: NativeRenderer, cameras: Cameras) -> None:
    """Check the promised agreement: 999 of 1000 bytes within one grey level, and at least 60 dB."""
    views = on(renderer, cameras)
    pixels, expected = renderer.pixels(views).cpu(), native.pixels(cameras)
    assert float(((pixels.int() - expected.int()).abs() <= 1).float().mean()) >= 0.999
    image, truth = RenderOutput(*(part.cpu() for part in renderer.render(views))), native.render(cameras)
    assert psnr(image.rgb, truth.rgb) >= LIKENESS
    assert psnr(image.alpha, truth.alpha) >= LIKENESS
    covered = truth.alpha > 0.05
    errors = ((image.depth - truth.depth).abs() / truth.depth)[covered]
    assert errors.numel() == 0 or errors.mean() < 1e-4
    assert torch.equal(pixels, (255 * image.rgb + 0.5).floor().to(torch.uint8))


@pytest.mark.parametrize(
    ("antialiased", "degree"),
    [
        pytest.param(True, 0, marks=pytest.mark.slow),
        (False, 1),
        pytest.param(True, 2, marks=pytest.mark.slow),
        (False, 3),
    ],
)
def test_any_scene_and_camera_look_the_same_as_on_the_cpu(make: Make, antialiased: bool, degree: int) -> None:
    for seed, size in ((degree, (37, 22)), (10 + degree, (31, 65)), (20 + degree, (1, 3))):
        scene, cameras = random_gaussians(seed, 700, degree), random_cameras(seed + 1, 2, *size)
        background = (0.2, 0.5, 0.9)
        assert_like_native(
            make(scene, antialiased, background), NativeRenderer(scene, antialiased, background), cameras
        )


@pytest.mark.parametrize(
    ("tolerance", "antialiased"),
    [
        pytest.param(0.0, True, marks=pytest.mark.slow),
        (0.5, True),
        pytest.param(0.5, False, marks=pytest.mark.slow),
        (2.0, False),
    ],
)
def test_a_yard_looks_the_same_as_on_the_cpu_at_every_level_of_detail(
    make: Make, tolerance: float, antialiased: bool
) -> None:
    scene = backyard()
    cameras = Cameras(
        look_at([[0.3, -1.0, 0.5], [-1.8, 1.2, 0.6]], [[1.0, 0.4, 0.3], [2.0, -2.0, 0.4]]),
        intrinsics(1.5, 36, 30),
        36,
        30,
    )
    native = NativeRenderer(scene, antialiased, tolerance=tolerance)
    assert_like_native(make(scene, antialiased, tolerance=tolerance), native, cameras)


@pytest.mark.parametrize("antialiased", [True, False])
@pytest.mark.parametrize(("opacity", "scale"), [(0.9, 1e-4), (0.5, 1e-3), (0.02, 1e-3)])
def test_merged_dust_looks_the_same_as_on_the_cpu(make: Make, antialiased: bool, opacity: float, scale: float) -> None:
    scene = dust(0, opacity, scale)
    renderer = make(scene, antialiased, tolerance=64.0)
    aims = [[20.0, (-1) ** k * k * 0.35, k * 0.33] for k in range(6)]
    cameras = Cameras(look_at([[0.0, 0.0, 0.0]] * 6, aims), intrinsics(1.57, 64, 64), 64, 64)
    assert_like_native(renderer, NativeRenderer(scene, antialiased, tolerance=64.0), cameras)


@pytest.mark.parametrize("count", [200, 800])
def test_a_small_model_looks_the_same_as_on_the_cpu_from_any_distance(make: Make, count: int) -> None:
    poses = look_at([[-away, 0.1 * away, 0.2 * away] for away in (0.5, 1.0, 2.0, 4.0, 8.0)], [0.0, 0.0, 0.0])
    cameras = Cameras(poses, intrinsics(1.57, 48, 40), 48, 40)
    assert_like_native(make(ball(count), tolerance=0.5), NativeRenderer(ball(count), tolerance=0.5), cameras)


def test_a_captured_room_looks_the_same_as_on_the_cpu(make: Make, kitchen: Gaussians) -> None:
    cameras = Cameras(look_at([0.2, -0.1, 1.05], [1.0, 0.6, 1.0])[None], intrinsics(1.57, 40, 40), 40, 40)
    assert_like_native(make(kitchen), NativeRenderer(kitchen), cameras)


def test_a_sky_of_gaussians_of_a_hundred_kilometres_looks_the_same_as_on_the_cpu(make: Make) -> None:
    sky = random_gaussians(9, 60)
    sky.means *= 3e5
    sky.scales.fill_(1e5)
    scene, cameras = torch.cat([random_gaussians(0, 200), sky]), random_cameras(1, 2, 33, 17)
    assert_like_native(make(scene), NativeRenderer(scene), cameras)


def test_a_frame_has_the_same_bytes_alone_and_in_any_batch_and_order(make: Make) -> None:
    scene = random_gaussians(3, 1500, 2)
    renderer = make(scene, memory=1)  # a single thread block draws everything
    cameras = on(renderer, random_cameras(4, 5, 50, 33))
    together, views = renderer.pixels(cameras), renderer.render(cameras)
    order = torch.tensor([3, 0, 4, 2, 1], device=renderer.device)
    others = make(scene)
    assert torch.equal(others.pixels(cameras[order]), together[order])
    assert all(torch.equal(a, b[order]) for a, b in zip(others.render(cameras[order]), views, strict=True))
    for row in range(5):
        assert torch.equal(renderer.pixels(cameras[row : row + 1]), together[row : row + 1])


@pytest.mark.parametrize(("tolerance", "launches"), [(0.0, 1), (0.5, 0)])
def test_the_heaviest_tiles_of_exact_images_are_drawn_first(
    monkeypatch: pytest.MonkeyPatch, tolerance: float, launches: int
) -> None:
    renderer = emulated_renderer(random_gaussians(2), tolerance=tolerance)  # its blocks have two tiles at a time
    towards, away = look_at([-3.0, 0.0, 0.0], [0.0, 0.0, 0.0]), look_at([-3.0, 0.0, 0.0], [-6.0, 0.0, 0.0])
    poses = torch.stack([away, towards, towards, away])
    cameras = Cameras(poses, intrinsics(1.0, 32, 32).expand(4, 3, 3), 32, 32)
    alone = torch.cat([renderer.pixels(cameras[row : row + 1]) for row in range(4)])
    found: list[Tensor] = []
    monkeypatch.setattr(cuda, "heaviest_first", lambda weights: found.append(weights) or heaviest_first(weights))
    assert torch.equal(renderer.pixels(cameras), alone)
    assert len(found) == launches
    for weights in found:
        assert weights[1] == weights[2] > weights[0] == weights[3] == 0
        assert heaviest_first(weights).tolist()[0] == 4
        assert set(heaviest_first(weights).tolist()[1:3]) == {1, 2}


@pytest.mark.gpu
def test_thousands_of_frames_have_the_same_bytes_as_each_alone(cuda_device: torch.device) -> None:
    renderer = CudaRenderer(backyard(), tolerance=1.0, device=cuda_device)
    cameras = on(renderer, random_cameras(4, 64, 64, 64))
    rows = torch.randint(64, (4096,), generator=torch.Generator().manual_seed(0)).to(cuda_device)
    assert torch.equal(renderer.pixels(cameras[rows]), renderer.pixels(cameras)[rows])
    again = [renderer.pixels(cameras[row : row + 1]) for row in range(64)]
    assert torch.equal(torch.cat(again), renderer.pixels(cameras))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_order_of_threads_between_barriers_changes_nothing(seed: int) -> None:
    scene, cameras = wall_of_equal_depths(1400), ahead()
    renderer = emulated_renderer(scene)
    expected = renderer.pixels(cameras)
    renderer._kernels.seed = seed  # type: ignore[attr-defined]
    assert torch.equal(renderer.pixels(cameras), expected)


def wall_of_equal_depths(count: int, degree: int = 0) -> Gaussians:
    """Return Gaussians at one depth from a camera at the origin, in no spatial order, with some nearer and farther."""
    scene = random_gaussians(6, count, degree)
    scene.means[:, 0] = 2.0
    scene.means[: count // 50, 0] = torch.linspace(0.5, 900.0, count // 50)
    return scene


@pytest.mark.parametrize("count", [500, 512, 513, 1500, 4000])
def test_gaussians_of_equal_depth_are_blended_in_the_order_of_the_scene(make: Make, count: int) -> None:
    scene = wall_of_equal_depths(count)
    assert_like_native(make(scene), NativeRenderer(scene), ahead())


def test_depths_far_apart_and_close_together_are_sorted_correctly(make: Make) -> None:
    scene = random_gaussians(7, 3000)
    scene.means[:, 0] = 2.0 + 1e-9 * torch.randperm(3000, generator=torch.Generator().manual_seed(0))
    scene.means[:40, 0] = torch.logspace(-1.5, 6, 40)
    assert_like_native(make(scene), NativeRenderer(scene), ahead())


def test_large_images_drawn_in_tiles_look_the_same_as_on_the_cpu(make: Make) -> None:
    scene, cameras = random_gaussians(3, 300, 2), random_cameras(8, 1, 150, 101)
    renderer = make(scene)
    assert_like_native(renderer, NativeRenderer(scene), cameras)
    assert renderer.efforts(on(renderer, cameras))[0, 0] > len(scene.means)  # many are counted on several tiles


def test_only_the_rows_that_are_asked_for_are_drawn(make: Make) -> None:
    renderer = make(random_gaussians(3, 300), background=(1.0, 1.0, 1.0))
    cameras, only = on(renderer, random_cameras(4, 4)), torch.tensor([True, False, False, True]).to(renderer.device)
    pixels, whole = renderer.pixels(cameras, only=only), renderer.pixels(cameras)
    assert torch.equal(pixels[only], whole[only]) and not pixels[~only].any()
    image, whole_image = renderer.render(cameras, only=only), renderer.render(cameras)
    for part, whole_part in zip(image, whole_image, strict=True):
        assert torch.equal(part[only], whole_part[only]) and not part[~only].any()
    with pytest.raises(ValueError, match=r"only: expected \[4\] torch.bool, got \[4\] torch.int64"):
        renderer.pixels(cameras, only=only.long())


@pytest.mark.parametrize("fault", ["pose", "K", "focal", "scaled", "mirrored", "skew"])
def test_the_image_of_an_invalid_camera_is_black_and_the_fault_is_reported_later(make: Make, fault: str) -> None:
    renderer = make(random_gaussians(3, 300), background=(1.0, 1.0, 1.0))
    cameras = random_cameras(4, 4)
    pose, K = cameras.camera_to_world[2], cameras.K[2]
    if fault in ("pose", "K"):
        (pose if fault == "pose" else K)[0, 0] = torch.nan
    elif fault == "focal":
        K[0, 0] = -1.0
    elif fault == "skew":
        K[0, 1] = 0.5
    else:
        pose[:3, :1] *= {"scaled": 2.0, "mirrored": -1.0}[fault]
    pixels = renderer.pixels(on(renderer, cameras))
    assert not pixels[2].any() and pixels[[0, 1, 3]].flatten(1).any(1).all()
    with pytest.raises(
        ValueError, match=r"cameras\[2\]: expected rigid camera_to_world and K with positive focal lengths"
    ):
        renderer.raise_faults()
    renderer.raise_faults()  # a fault is reported once


def test_an_empty_batch_and_a_camera_that_sees_nothing_can_be_drawn(make: Make) -> None:
    renderer = make(gaussians([[-5.0, 0.0, 0.0]]), background=(0.0, 1.0, 0.0))
    empty = renderer.pixels(on(renderer, random_cameras(1, 0)))
    assert empty.shape == (0, 22, 37, 3)
    unseen = renderer.pixels(on(renderer, ahead()))  # the Gaussian is behind the camera
    assert (unseen == torch.tensor([0, 255, 0]).to(unseen)).all()


def test_efforts_count_projected_visible_and_blended_gaussians(make: Make) -> None:
    renderer = make(gaussians([[2.0, 0.0, 0.0], [3.0, 0.3, 0.0], [-2.0, 0.0, 0.0]], scale=0.01))
    projected, visible, blended = renderer.efforts(on(renderer, ahead()))[0].tolist()
    assert 2 <= visible <= projected <= 8  # each is counted on up to four tiles
    assert visible <= blended <= 4 * visible


def test_a_negative_tolerance_is_refused() -> None:
    with pytest.raises(ValueError, match="tolerance: expected a finite number of pixels, at least 0, got -1"):
        emulated_renderer(random_gaussians(0, 10), tolerance=-1)


def test_gaussians_that_are_not_finite_are_refused() -> None:
    scene = random_gaussians(0, 10)
    scene.means[3, 1] = torch.nan
    with pytest.raises(ValueError, match=r"gaussians\.means\[3\]: expected finite coordinates in metres"):
        emulated_renderer(scene)
