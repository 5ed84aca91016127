"""Models, placements and metrics that the tests of parts share, for any renderer."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.geometry import quats_to_rotations, rigid
from splatrl.renderers import ABSENT, NativeRenderer, Parts, ReferenceRenderer, Renderer, RenderOutput
from splatrl.scenes import Gaussians
from tests.renderers.cases import double, gaussians, random_gaussians

BACKGROUND = (0.2, 0.4, 0.6)
IDENTITY = torch.eye(4)


class Maker(NamedTuple):
    """A constructor of renderers, and how closely parts must match the same Gaussians moved to the world.

    Attributes:
        make: takes models, ``antialiased`` and ``background``, and the renderer's own settings by keyword.
        rgb: maximum difference of a colour.
        share: maximum fraction of bytes that differ, by one grey level.
        turned_share: the same if harmonics are rotated, since a renderer may store them rounded.
    """

    make: Callable[..., Renderer]
    rgb: float = 1e-3
    share: float = 1e-4
    turned_share: float = 1e-4


def make_reference(
    models: Sequence[Gaussians], antialiased: bool = True, background: Sequence[float] = BACKGROUND
) -> Renderer:
    """Make the readable twin, in double precision."""
    return ReferenceRenderer([double(model) for model in models], antialiased, background)


def make_native(
    models: Sequence[Gaussians],
    antialiased: bool = True,
    background: Sequence[float] = BACKGROUND,
    **settings: Any,
) -> Renderer:
    """Make the renderer for CPUs."""
    return NativeRenderer(models, antialiased, background, **settings)


MAKERS = {"reference": Maker(make_reference), "native": Maker(make_native, turned_share=0.02)}


def random_models(degrees: Sequence[int], counts: Sequence[int] = (250, 90, 40)) -> list[Gaussians]:
    """Return clouds, each half the size of the one before it, in float32."""
    models = []
    for order, (degree, count) in enumerate(zip(degrees, counts, strict=True)):
        cloud = random_gaussians(20 + order, count, degree)
        cloud.means, cloud.scales = cloud.means * 0.5**order, cloud.scales * 0.5**order
        models.append(cloud)
    return models


def random_poses(seed: int, *shape: int, spread: float = 0.7) -> Tensor:
    """Return model_to_world [*shape, 4, 4], randomly rotated and placed around the origin."""
    g = torch.Generator().manual_seed(seed)
    turns = quats_to_rotations(torch.randn(*shape, 4, generator=g, dtype=torch.float64))
    return rigid(turns, spread * torch.randn(*shape, 3, generator=g, dtype=torch.float64)).float()


def random_parts(seed: int, batch: int, most: int = 4, models: int = 3) -> Parts:
    """Return parts of which some are absent, with invalid poses; the first part of each row is present."""
    g = torch.Generator().manual_seed(seed)
    model = torch.randint(ABSENT, models, (batch, most), generator=g)
    model[:, 0] = torch.randint(0, models, (batch,), generator=g)
    poses = random_poses(seed, batch, most)
    poses[model == ABSENT] = torch.nan
    return Parts(model, poses)


def placed(batch: int, *parts: tuple[int, Tensor]) -> Parts:
    """Return the same parts in every row, from models and their poses [4, 4]."""
    model = torch.tensor([model for model, _ in parts], dtype=torch.int64)
    poses = torch.stack([pose for _, pose in parts]) if parts else torch.zeros(0, 4, 4)
    return Parts(model.repeat(batch, 1), poses.repeat(batch, 1, 1, 1))


def in_world(models: Sequence[Gaussians], parts: Parts, row: int) -> Gaussians:
    """Return all Gaussians of a row as one model in the world frame, of the highest degree among them."""
    harmonics = max(model.sh.shape[1] for model in models)
    moved = []
    for number, pose in zip(parts.model[row].tolist(), parts.model_to_world[row], strict=True):
        if number != ABSENT:
            at_home = torch.equal(pose, IDENTITY)
            model = models[number] if at_home else models[number].transformed(pose)
            missing = model.sh.new_zeros(len(model.means), harmonics - model.sh.shape[1], 3)
            moved.append((model.means, model.quats, model.scales, model.opacities, torch.cat([model.sh, missing], 1)))
    fields = [torch.cat(values) for values in zip(*moved, strict=True)]
    return Gaussians(*fields, batch_size=[len(fields[0])])


def drawn_in_world(
    make: Callable[[list[Gaussians]], Renderer], models: Sequence[Gaussians], cameras: Cameras, parts: Parts
) -> tuple[RenderOutput, Tensor]:
    """Return what ``render`` and ``pixels`` should give: each row is drawn from one model in the world."""
    images, pixels = [], []
    for row in range(len(cameras)):
        renderer, camera = make([in_world(models, parts, row)]), cameras[row : row + 1]
        images.append(renderer.render(camera))
        pixels.append(renderer.pixels(camera))
    return RenderOutput(*(torch.cat(values) for values in zip(*images, strict=True))), torch.cat(pixels)


def assert_like(image: RenderOutput, expected: RenderOutput, rgb: float) -> None:
    """Check colours and alphas to within ``rgb``, and relative depth to ten times that where pixels are covered."""
    assert (image.rgb - expected.rgb).abs().max() <= rgb
    assert (image.alpha - expected.alpha).abs().max() <= rgb
    covered = expected.alpha > 0.05  # mean depth is unstable where almost nothing is blended
    assert covered.any()
    assert ((image.depth - expected.depth).abs() / expected.depth)[covered].max() <= 10 * rgb


def assert_same_bytes(pixels: Tensor, expected: Tensor, share: float) -> None:
    """Check that at most a fraction ``share`` of the bytes differs, by one grey level."""
    apart = (pixels.int() - expected.int()).abs()
    assert apart.max() <= 1 and (apart > 0).double().mean() <= share


def walls(*colors: Sequence[float]) -> list[Gaussians]:
    """Return models, each one opaque disc of a colour across the x axis, which hides what is behind it."""
    return [gaussians([[0.0, 0.0, 0.0]], [list(color)], [1e-4, 5.0, 5.0], 0.999).float() for color in colors]


def at(x: float, y: float = 0.0, z: float = 0.0) -> Tensor:
    """Return the pose [4, 4] of a model at a position, not rotated."""
    return rigid(torch.eye(3), torch.tensor([x, y, z]))
