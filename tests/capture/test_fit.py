"""Fits: views and gradients against the reference, the loss against torch, and tiny fits from end to end."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from PIL import Image
from torch import Tensor

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.capture.base import CaptureError, Reconstruction
from splatrl.capture.fitting.cameras import turned
from splatrl.capture.fitting.fit import FitSettings, Fitting, fit, held_out
from splatrl.capture.fitting.model import share
from splatrl.capture.stereo import IGNORED
from splatrl.native import _core
from splatrl.renderers import NativeRenderer, ReferenceRenderer
from splatrl.renderers.reference import blend
from splatrl.scenes.gaussians import INVISIBLE, Gaussians
from tests.renderers.cases import LIKENESS, random_cameras, random_gaussians

COUNT, STRIDE, WIDTH, HEIGHT = 203, 208, 37, 22
SEAM, INVERSE_DEPTH = 19, (0.5, 0.3)
GROUPS = {"means": (0, 3), "log-scales": (3, 6), "quats": (6, 10), "logits": (10, 11), "sh": (11, 59)}
SETTINGS = FitSettings(
    width=48, cap=600, views=240, sh_degree=0, levels=((0.0, 0.5), (0.3, 1.0)), refine_every=20, threads=1
)


def random_values(degree: int) -> Tensor:
    """Return raw parameters of random Gaussians, with quaternions that are not normalised: [R, STRIDE]."""
    cloud = random_gaussians(3, COUNT, degree)
    values = torch.zeros(11 + 3 * (degree + 1) ** 2, STRIDE)
    values[0:3, :COUNT] = cloud.means.T
    values[3:6, :COUNT] = cloud.scales.log().T
    values[6:10, :COUNT] = 1.7 * cloud.quats.T
    values[10, :COUNT] = cloud.opacities.clamp(0.01, 0.99).logit()
    values[11:, :COUNT] = 0.3 * cloud.sh.flatten(1).T
    return values


def activated(values: Tensor) -> Gaussians:
    """Return the Gaussians that raw parameters [R, n] describe."""
    return Gaussians(
        means=values[0:3].T,
        quats=torch.nn.functional.normalize(values[6:10].T, dim=1),
        scales=values[3:6].T.exp(),
        opacities=values[10].sigmoid(),
        sh=values[11:].T.reshape(values.shape[1], -1, 3),
        batch_size=[values.shape[1]],
    )


def reference_images(gaussians: Gaussians, cameras: Cameras) -> Tensor:
    """Return the reference's colour, agreement with ``known_depths`` and alpha, unclamped: [B, H, W, 5]."""
    reference = ReferenceRenderer(gaussians)
    images = []
    for row in range(len(cameras)):
        seen = reference.project(gaussians, cameras, row)
        agreeing = seen._replace(depths=(1 - (seen.depths * INVERSE_DEPTH[row] - 1).abs()).clamp_min(0))
        left = blend(agreeing, 0, 0, SEAM, cameras.height, INVISIBLE)
        right = blend(seen._replace(depths=0 * seen.depths), SEAM, 0, cameras.width, cameras.height, INVISIBLE)
        images.append(torch.cat([left, right], 1))
    return torch.stack(images)


def known_depths(count: int) -> Tensor:
    """Return inverse depths that are known left of the seam and 0 elsewhere: [count, H, W]."""
    known = torch.zeros(count, HEIGHT, WIDTH)
    known[:, :, :SEAM] = torch.tensor(INVERSE_DEPTH[:count])[:, None, None]
    return known


def moved_cameras(cameras: Cameras, moves: Tensor) -> Cameras:
    """Return cameras turned in place by small angles about the world's axes, then shifted; moves: [B, 6] float64."""
    zero = torch.zeros(len(moves), dtype=torch.float64)
    x, y, z = moves[:, :3].unbind(1)
    turn = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).view(-1, 3, 3)
    pose = cameras.camera_to_world.double()
    rotations = pose[:, :3, :3] + turn @ pose[:, :3, :3]
    places = pose[:, :3, 3] + moves[:, 3:]
    last = pose[:, 3:]
    upper = torch.cat([rotations, places.unsqueeze(-1)], -1)
    return Cameras(torch.cat([upper, last], 1), cameras.K, cameras.width, cameras.height)


def cosine(a: Tensor, b: Tensor) -> float:
    a, b = a.double().flatten(), b.double().flatten()
    return float(a @ b / (a.norm() * b.norm()))


@pytest.fixture(params=_core.supported_isas())
def fitter(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> _core.Fitter:
    monkeypatch.setenv("SPLATRL_ISA", request.param)
    return _core.Fitter()


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_views_and_gradients_match_the_reference_under_autograd(fitter: _core.Fitter, degree: int) -> None:
    values, cameras = random_values(degree), random_cameras(5, 2, WIDTH, HEIGHT)
    leaf = values[:, :COUNT].double().requires_grad_()
    moves = torch.zeros(2, 6, dtype=torch.float64, requires_grad=True)
    known = known_depths(2)
    expected = reference_images(activated(leaf), moved_cameras(cameras, moves))
    slopes = torch.randn(expected.shape, generator=torch.Generator().manual_seed(1))
    (expected * slopes).sum().backward()
    rgb, agreement, alpha = torch.empty(2, HEIGHT, WIDTH, 3), *(torch.empty(2, HEIGHT, WIDTH) for _ in range(2))
    gradients, moved = torch.zeros(2, *values.shape), torch.empty(2, 6)
    K = cameras.K.contiguous()
    fitter.render(values, COUNT, 0.01, cameras.camera_to_world, K, known, rgb, agreement, alpha, 1)
    fitter.pull(values, COUNT, 0.01, cameras.camera_to_world, K, known, slopes, gradients, moved, 1)
    assert -10 * (rgb - expected.detach()[..., :3]).square().mean().log10() > LIKENESS
    assert torch.allclose(agreement.double(), expected.detach()[..., 3], atol=1e-3)
    assert agreement[:, :, :SEAM].amax() > 0.3
    assert (agreement[:, :, SEAM:] == 0).all()
    assert torch.allclose(alpha.double(), expected.detach()[..., 4], atol=1e-4)
    assert leaf.grad is not None and moves.grad is not None
    assert cosine(moved, moves.grad) > 0.9999
    assert torch.allclose(moved.double(), moves.grad, rtol=1e-3, atol=1e-3 * float(moves.grad.abs().max()))
    for name, (first, last) in GROUPS.items():
        found, truth = gradients.sum(0)[first:last, :COUNT], leaf.grad[first:last]
        assert cosine(found, truth) > 0.9999, name
        assert float(found.norm() / truth.norm()) == pytest.approx(1.0, abs=1e-3), name


def torch_loss(images: Tensor, photo: Tensor, exposure: Tensor, ignored: Tensor) -> Tensor:
    """Return L1 and structural dissimilarity, padded window, of [H, W, 3] images; some pixels [H, W] are ignored."""
    x, t = (images * exposure[:, 0] + exposure[:, 1]).movedim(-1, 0), photo.movedim(-1, 0)
    x, t = torch.where(ignored, x.detach(), x), torch.where(ignored, x.detach(), t)
    distance = torch.arange(-5.0, 6.0, dtype=torch.float64)
    window = torch.exp(-(distance**2) / (2 * 1.5**2))
    kernel = torch.outer(window, window)[None, None] / window.sum() ** 2

    def smooth(plane: Tensor) -> Tensor:
        return torch.nn.functional.conv2d(plane.unsqueeze(1), kernel, padding=5)

    mx, mt = smooth(x), smooth(t)
    top = (2 * mx * mt + 1e-4) * (2 * (smooth(x * t) - mx * mt) + 9e-4)
    similar = top / ((mx**2 + mt**2 + 1e-4) * (smooth(x * x) - mx**2 + smooth(t * t) - mt**2 + 9e-4))
    return 0.8 * (x - t).abs().mean() + 0.2 * (1 - similar.mean())


@pytest.mark.parametrize("ignored", [slice(0, 0), slice(6, 15)], ids=["every pixel counts", "some pixels are ignored"])
def test_the_loss_and_its_gradients_match_torch(fitter: _core.Fitter, ignored: slice) -> None:
    values, cameras = random_values(1), random_cameras(5, 1, WIDTH, HEIGHT)
    random = torch.Generator().manual_seed(2)
    photos = torch.randint(0, 256, (3, HEIGHT, WIDTH, 3), dtype=torch.uint8, generator=random)
    exposure = torch.tensor([[[1.0, 0.0]] * 3, [[1.0, 0.0]] * 3, [[1.1, 0.02], [0.9, -0.01], [1.2, 0.0]]])
    known = torch.cat([known_depths(1) * 0 + 9.0] * 2 + [known_depths(1)])
    known[2, 4:, ignored] = IGNORED
    leaf, light = values[:, :COUNT].double().requires_grad_(), exposure[2].double().requires_grad_()
    image = reference_images(activated(leaf), cameras)[0]
    apart = torch.where(known[2] > 0, 1 - image[..., 3], 0.0).sum() / (HEIGHT * WIDTH)
    expected = torch_loss(image[..., :3], photos[2].double() / 255, light, known[2] == IGNORED) + 0.3 * apart
    expected.backward()
    gradients, losses = torch.zeros(1, *values.shape), torch.empty(1, 16)
    fitter.compare(
        values, COUNT, 0.01, cameras.camera_to_world, cameras.K.contiguous(), photos, known, torch.tensor([2]),
        exposure, 0.2, 0.3, gradients, losses, 1,
    )  # fmt: skip
    assert float(losses[0, 0]) == pytest.approx(float(expected.detach()), abs=1e-5)
    assert leaf.grad is not None and light.grad is not None
    for name, (first, last) in GROUPS.items():
        assert cosine(gradients[0, first:last, :COUNT], leaf.grad[first:last]) > 0.9999, name
    assert cosine(losses[0, 4:10], light.grad) > 0.9999


def test_copies_of_a_gaussian_blend_to_its_original_opacity() -> None:
    opacities, factors = share(torch.tensor([0.9, 0.5, 0.2]).double(), torch.tensor([1, 3, 51]))
    assert torch.allclose(1 - (1 - opacities) ** torch.tensor([1, 3, 51]), torch.tensor([0.9, 0.5, 0.2]).double())
    assert float(factors[0]) == pytest.approx(1.0)
    assert (factors[1:] < 1.0).all()


def tiny_capture(folder: Path) -> Reconstruction:
    """Return twenty photos of 40 coloured blobs, taken from a ring around them."""
    blobs = random_gaussians(7, 40)
    blobs.scales.clamp_(min=0.08, max=0.3)
    blobs.opacities.clamp_(min=0.8)
    turn = torch.arange(20) / 20 * 6.2832
    poses = look_at(torch.stack([4 * turn.cos(), 4 * turn.sin(), 0.5 * (2 * turn).sin()], 1), (0.0, 0.0, 0.0))
    K = intrinsics(0.9, 48, 36)
    images = NativeRenderer(blobs, threads=1).pixels(Cameras(poses, K, 48, 36))
    paths = []
    for row, image in enumerate(images):
        paths.append(folder / f"{row:02d}.png")
        Image.fromarray(image.numpy()).save(paths[-1])
    colors = (0.5 + 0.28209479 * blobs.sh[:, 0]).clamp(0, 1)
    return Reconstruction(
        paths=paths,
        width=48,
        height=36,
        K=K.double(),
        camera_to_world=poses.double(),
        points=blobs.means.double(),
        colors=(255 * colors).byte(),
        seen_point=torch.arange(40).repeat(20),
        seen_by=torch.arange(20).repeat_interleave(40),
    )


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Reconstruction:
    return tiny_capture(tmp_path_factory.mktemp("photos"))


def held_out_psnr(gaussians: Gaussians, capture: Reconstruction) -> float:
    """Return the mean PSNR over the held-out views, dB."""
    rows = held_out(len(capture.paths))
    cameras = Cameras(capture.camera_to_world[rows].float(), capture.K.float(), capture.width, capture.height)
    photos = torch.stack([torch.tensor(list(Image.open(capture.paths[row]).tobytes())) for row in rows.tolist()])
    views = NativeRenderer(gaussians, threads=1).render(cameras).rgb
    return float(-10 * (views.flatten(1) - photos / 255).square().mean(1).log10().mean())


def same_bytes(a: Gaussians, b: Gaussians) -> bool:
    return all(
        torch.equal(getattr(a, name), getattr(b, name)) for name in ("means", "quats", "scales", "opacities", "sh")
    )


def test_a_tiny_fit_looks_like_its_held_out_photos(capture: Reconstruction) -> None:
    heard: list[tuple[int, int, float]] = []
    fitted = fit(capture, SETTINGS, lambda *state: heard.append(state))
    assert held_out_psnr(fitted, capture) > 25.0
    assert heard[-1][:2] == (240, 240) and heard[-1][2] < 0.5 * heard[0][2]
    assert fitted.sh_degree == 0 and len(fitted) <= SETTINGS.cap


def test_a_fit_depends_on_its_seed_and_not_on_the_number_of_threads(capture: Reconstruction) -> None:
    short = replace(SETTINGS, views=90, sh_degree=1)
    assert same_bytes(fit(capture, short), fit(capture, replace(short, threads=2)))
    assert not same_bytes(fit(capture, short), fit(capture, replace(short, seed=1)))


def test_held_out_photos_never_influence_a_fit(capture: Reconstruction, tmp_path: Path) -> None:
    paths = list(capture.paths)
    for row in held_out(len(paths)).tolist():
        paths[row] = tmp_path / f"{row}.png"
        Image.new("RGB", (capture.width, capture.height), (255, 0, 255)).save(paths[row])
    short = replace(SETTINGS, views=60)
    assert same_bytes(fit(capture, short), fit(replace(capture, paths=paths), short))


def test_a_fit_works_in_any_unit_and_far_from_the_origin(capture: Reconstruction) -> None:
    moved = torch.tensor([100.0, -50.0, 3.0]).double()
    poses = capture.camera_to_world.clone()
    poses[:, :3, 3] = 7 * poses[:, :3, 3] + moved
    far = replace(capture, camera_to_world=poses, points=7 * capture.points + moved)
    assert held_out_psnr(fit(far, SETTINGS), far) > 25.0


def test_small_errors_of_the_poses_are_corrected(capture: Reconstruction) -> None:
    off = 0.02 * torch.randn(20, 6, generator=torch.Generator().manual_seed(3))
    off[held_out(20)] = 0.0
    fitting = Fitting(
        replace(capture, camera_to_world=turned(capture.camera_to_world, off)), replace(SETTINGS, poses=1e-3)
    )
    for step in range(320):
        fitting.step(step, 320)
    rows = fitting.trained

    def error(moves: Tensor) -> float:  # norm of the rotation errors, apart from what all cameras share
        left = (off + moves)[rows, :3]
        return float((left - left.mean(0)).norm())

    assert error(fitting.moves.values) < 0.5 * error(torch.zeros(20, 6))


def test_invalid_settings_and_captures_are_refused_in_one_line(capture: Reconstruction) -> None:
    with pytest.raises(ValueError, match=r"^sh_degree: expected a whole number from 0 to 3, got 4$"):
        FitSettings(sh_degree=4)
    with pytest.raises(ValueError, match=r"^cap: expected a whole number of at least 1, got 0$"):
        FitSettings(cap=0)
    with pytest.raises(CaptureError, match=r"^points: expected at least one"):
        fit(replace(capture, points=capture.points[:0], seen_point=capture.seen_point[:0],
                    seen_by=capture.seen_by[:0]), SETTINGS)  # fmt: skip
    with pytest.raises(CaptureError, match=r"expected 49 × 36 pixels, got 48 × 36$"):
        fit(replace(capture, width=49), SETTINGS)
    one = replace(capture, paths=capture.paths[:1], camera_to_world=capture.camera_to_world[:1])
    with pytest.raises(CaptureError, match=r"^paths: expected at least 2 photos, got 1$"):
        fit(one, SETTINGS)
