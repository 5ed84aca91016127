import torch

from splatrl.evaluation.walk_looks import Lens, photographed

CLEAR = Lens(exposure=0.0, tint=0.0, blur=0.0, noise=0.0)


def frames(level: int = 120) -> torch.Tensor:
    return torch.full((3, 8, 10, 3), level, dtype=torch.uint8)


def photo(lens: Lens, seed: int = 0, pixels: torch.Tensor | None = None) -> torch.Tensor:
    return photographed(frames() if pixels is None else pixels, lens, torch.Generator().manual_seed(seed))


def test_a_perfect_camera_changes_nothing() -> None:
    pixels = torch.randint(0, 256, (2, 5, 7, 3), dtype=torch.uint8)
    assert torch.equal(photo(CLEAR, pixels=pixels), pixels)


def test_exposure_is_constant_in_a_clip_and_differs_between_clips() -> None:
    levels = [photo(Lens(1.0, 0.0, 0.0, 0.0), seed).unique().tolist() for seed in range(40)]
    assert all(len(level) == 1 for level in levels)
    light = torch.tensor(levels).flatten() / 120
    assert light.min() < 0.8 and light.max() > 1.25
    assert light.min() > 0.72 and light.max() < 1.38  # a stop is a factor of 2 ** (1 / 2.2) in stored values


def test_a_tint_is_constant_in_a_clip_and_differs_between_channels() -> None:
    tinted = photo(Lens(0.0, 0.2, 0.0, 0.0))
    assert len(tinted.flatten(0, 2).unique(dim=0)) == 1
    assert len(tinted[0, 0, 0].unique()) == 3


def test_blur_spreads_a_point_within_its_frame_and_keeps_its_light() -> None:
    pixels = torch.zeros(2, 21, 21, 3, dtype=torch.uint8)
    pixels[0, 10, 10] = 255
    spread = photo(Lens(0.0, 0.0, 0.1, 0.0), 3, pixels)
    assert not spread[1].any()
    lit = spread[0, :, :, 0] > 0
    assert 9 <= lit.sum() < 21 * 21 and lit[9:12, 9:12].all()
    assert torch.equal(lit, lit.T) and torch.equal(lit, lit.flip(0))
    assert abs(((spread[0, :, :, 1] / 255) ** 2.2).sum() - 1) < 0.1


def test_noise_differs_between_frames_and_keeps_the_mean_level() -> None:
    noisy = photographed(
        torch.full((2, 50, 50, 3), 120, dtype=torch.uint8),
        Lens(0.0, 0.0, 0.0, 8.0),
        torch.Generator().manual_seed(2),
    ).float()
    assert not torch.equal(noisy[0], noisy[1])
    assert abs(noisy.mean() - 120) < 0.5
    assert 0.5 < noisy.std() < 8.5
