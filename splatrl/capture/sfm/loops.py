"""Loop closure: pairs of images that may show the same place although they were taken at different times.

Every image's SIFT descriptors are summarised in one vector (VLAD, Jégou et al. 2010): the sums of their residuals to
the nearest of a few visual words. The cosine of two such vectors tells how similar two images are.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

WORDS, ROUNDS, SAMPLE = 64, 8, 20_000
PARTNERS, APART = 6, 9
"""Number of partners per image, and their minimum distance in images: nearer ones are compared anyway."""


def loop_pairs(
    descriptors: list[NDArray[np.uint8]], partners: int = PARTNERS, apart: int = APART
) -> list[tuple[int, int]]:
    """Return pairs of images that look similar.

    Args:
        descriptors: descriptors of each image, [N, 128].
        partners: number of partners per image.
        apart: minimum difference of their indices.

    Returns:
        Indices of two images each, the smaller one first, ascending; the same for the same descriptors.
    """
    alike = likeness(descriptors)
    numbers = np.arange(len(alike))
    alike[np.abs(numbers[:, None] - numbers) < apart] = -np.inf
    chosen = set()
    for number in numbers.tolist():
        for other in np.argsort(-alike[number], kind="stable")[:partners].tolist():
            if np.isfinite(alike[number, other]):
                chosen.add((min(number, other), max(number, other)))
    return sorted(chosen)


def likeness(descriptors: list[NDArray[np.uint8]]) -> Floats:
    """Return the similarity of images, [M, M] float32 with ones on the diagonal; −∞ for images without descriptors."""
    values = [np.sqrt(one / np.maximum(one.sum(1, keepdims=True), 1.0), dtype=np.float32) for one in descriptors]
    every = np.concatenate(values)
    if len(every) < WORDS:
        return np.full((len(values), len(values)), -np.inf, np.float32)
    words = _words(every[:: max(1, len(every) // SAMPLE)])
    vectors = np.stack([_summed_up(one, words) for one in values])
    alike: Floats = vectors @ vectors.T
    empty = np.array([len(one) == 0 for one in values])
    alike[empty], alike[:, empty] = -np.inf, -np.inf
    return alike


def _words(values: Floats) -> Floats:
    """Return the visual words (typical descriptors), by k-means from evenly spaced descriptors."""
    words = values[np.linspace(0, len(values) - 1, WORDS).round().astype(int)].copy()
    for _ in range(ROUNDS):
        nearest = _nearest(values, words)
        for word in range(len(words)):
            members = values[nearest == word]
            if len(members):
                words[word] = members.mean(0)
    return words


def _nearest(values: Floats, words: Floats) -> NDArray[np.int_]:
    return np.asarray((values @ words.T - 0.5 * (words**2).sum(1)).argmax(1))


def _summed_up(values: Floats, words: Floats) -> Floats:
    result = np.zeros_like(words)
    nearest = _nearest(values, words)
    np.add.at(result, nearest, values - words[nearest])
    result /= np.maximum(np.linalg.norm(result, axis=1, keepdims=True), 1e-9)
    flat = result.reshape(-1)
    return np.asarray(flat / max(float(np.linalg.norm(flat)), 1e-9))
