"""Finding frames with identical inputs."""

import torch

from splatrl.training.repeats import first_alike


def test_each_frame_gets_the_index_of_the_first_identical_frame() -> None:
    images = torch.rand(3, 4, 5, 2)
    seen = images[[0, 1, 0, 2, 1, 0]]
    alike = first_alike(seen)
    assert alike is not None and alike.tolist() == [0, 1, 0, 3, 1, 0]


def test_frames_are_identical_only_if_all_their_inputs_are() -> None:
    images = torch.rand(2, 4, 5, 2)[[0, 0, 1, 0, 0]]
    vectors = torch.tensor([[1.0], [2.0], [1.0], [1.0], [-0.0]])
    alike = first_alike(images, vectors)
    assert alike is not None and alike.tolist() == [0, 1, 2, 0, 4]


def test_frames_that_hardly_repeat_are_not_deduplicated() -> None:
    images = torch.rand(1000, 2, 2, 3)
    assert first_alike(images) is None
    images[::2] = images[0]
    assert first_alike(images) is not None
