"""Images that look alike are paired, however far apart they were taken."""

import numpy as np

from splatrl.capture.sfm.loops import likeness, loop_pairs

RANDOM = np.random.default_rng(0)


def seen(place: int) -> np.ndarray:
    """Return descriptors of an image of a place: noisy copies of those that all its images share, and new ones."""
    common = np.random.default_rng(place).gamma(0.6, 30, (120, 128))
    own = RANDOM.gamma(0.6, 30, (60, 128))
    return np.concatenate([common + RANDOM.normal(0, 8, common.shape), own]).clip(0, 255).astype(np.uint8)


def test_images_of_the_same_place_are_paired_and_neighbours_are_not() -> None:
    places = [*range(30), *range(30)]
    images = [seen(place) for place in places]
    assert loop_pairs(images, partners=1, apart=9) == [(place, place + 30) for place in range(30)]
    assert loop_pairs(images, partners=1, apart=9) == loop_pairs(images, partners=1, apart=9)
    near = loop_pairs(images, partners=3, apart=9)
    assert all(second - first >= 9 for first, second in near) and len(near) >= 45


def test_an_image_resembles_itself_and_one_without_features_resembles_none() -> None:
    images = [seen(0), seen(1), np.zeros((0, 128), np.uint8)]
    alike = likeness(images)
    np.testing.assert_allclose(np.diag(alike)[:2], 1.0, atol=1e-5)
    assert alike[0, 1] < 0.5 and np.isneginf(alike[2]).all()
    assert loop_pairs(images, partners=2, apart=1) == [(0, 1)]
    assert loop_pairs([np.zeros((0, 128), np.uint8)] * 3) == []
