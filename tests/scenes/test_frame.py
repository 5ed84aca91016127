import pytest
import torch

from splatrl.scenes.frame import similarity


def moved(transform: torch.Tensor, point: list[float]) -> list[float]:
    return (transform @ torch.tensor([*point, 1.0], dtype=torch.float64))[:3].tolist()


def test_without_arguments_splat_coordinates_are_world_metres() -> None:
    assert torch.equal(similarity(), torch.eye(4, dtype=torch.float64))


def test_axes_say_which_signed_splat_axis_gives_each_world_axis() -> None:
    assert moved(similarity(["x", "-z", "y"]), [1.0, 2.0, 3.0]) == [1.0, -3.0, 2.0]
    assert moved(similarity(["-y", "-z", "x"]), [1.0, 2.0, 3.0]) == [-2.0, -3.0, 1.0]


def test_the_scale_comes_before_the_translation() -> None:
    transform = similarity(["x", "-z", "y"], scale=2.0, translation=[10, 20.0, 30.0])
    assert moved(transform, [1.0, 2.0, 3.0]) == [12.0, 14.0, 34.0]


def test_a_matrix_replaces_axes_scale_and_translation() -> None:
    rows = [[0, -2, 0, 1], [2, 0, 0, 5], [0, 0, 2.0, 0], [0, 0, 0, 1]]
    assert moved(similarity(matrix=rows), [1.0, 0.0, 3.0]) == [1.0, 7.0, 6.0]
    assert torch.equal(similarity(matrix=torch.tensor(rows)), similarity(matrix=rows))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"axes": ["x", "z", "y"]}, "expected a rotation, got a reflection"),
        ({"axes": ["x", "y"]}, "axes: expected 3 of x, -x, y, -y, z, -z, got"),
        ({"axes": ["x", "y", "w"]}, "axes: expected 3 of"),
        ({"axes": ["x", "y", "-x"]}, "axes: expected each of x, y and z once"),
        ({"scale": 0.0}, "scale: expected a number above 0.0, got 0.0"),
        ({"scale": -1.0}, "scale: expected a number above 0.0"),
        ({"scale": float("nan")}, "scale: expected a number above 0.0"),
        ({"scale": [1.0, 1.0, 2.0]}, "scale: expected numbers, got"),
        ({"axes": 3}, "axes: expected 3 of"),
        ({"axes": "xyz"}, "axes: expected 3 of"),
        ({"translation": 5}, "translation: expected 3 numbers, got 5"),
        ({"matrix": 5}, "matrix: expected 4 rows of 4, got 5"),
        ({"matrix": [1, 2, 3, 4]}, "matrix: expected 4 rows of 4, got"),
        ({"translation": [1.0, 2.0]}, "translation: expected 3 numbers"),
        ({"translation": [1.0, 2.0, "z"]}, "translation: expected numbers, got 'z'"),
        ({"translation": [1.0, 2.0, float("inf")]}, "expected 4 by 4 finite numbers"),
        ({"matrix": [[1.0] * 4] * 3}, "matrix: expected 4 rows of 4, got"),
        ({"matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, True]]}, "matrix: expected numbers, got True"),
        ({"matrix": torch.eye(3)}, "expected 4 by 4 finite numbers"),
        ({"matrix": torch.diag(torch.tensor([1.0, 1, 1, 2]))}, "expected a last row of 0, 0, 0, 1"),
        ({"matrix": torch.diag(torch.tensor([1.0, 1, 1.01, 1]))}, "expected one positive scale for all axes"),
        ({"matrix": torch.diag(torch.tensor([0.0, 0, 0, 1]))}, "expected one positive scale for all axes"),
        ({"matrix": torch.diag(torch.tensor([1.0, 1, -1, 1]))}, "expected a rotation, got a reflection"),
        ({"matrix": [[1, 0.6, 0, 0], [0, 0.8, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}, "expected axes at right angles"),
        ({"matrix": torch.eye(4), "scale": 2.0}, "expected either a matrix or axes, scale and translation, got both"),
    ],
)
def test_arguments_that_give_no_similarity_are_refused_by_field(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=f"world_from_splat.*{message}"):
        similarity(**arguments)
