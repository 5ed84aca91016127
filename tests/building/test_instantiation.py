"""Errors of constructors are those that they raise, in one line with the key."""

import pytest
from hydra.errors import InstantiationException

import splatrl
from splatrl.building.instantiation import line


def test_newer_pythons_guess_at_an_argument_is_left_out() -> None:
    cause = TypeError("TrackSettings.__init__() got an unexpected keyword argument 'gate'. Did you mean 'gates'?")
    error = InstantiationException("Error in call\nfull_key: task.course")
    error.__cause__ = cause
    assert line(error) == "task.course.gate: no such key in TrackSettings"


@pytest.mark.parametrize(
    ("override", "kind", "said"),
    [
        ("task.motion.step=0.3", ValueError, "task.motion.step: bounds along x: expected a whole number of steps"),
        ("robot.fov_deg=0", ValueError, "robot.fov_deg: expected"),
        ("+task.motion.speed=1", ValueError, "task.motion.speed: no such key in LatticeMotion"),
        ("robot=mjcf robot.path=nowhere.xml robot.camera=eye", FileNotFoundError, "nowhere.xml: "),
    ],
)
def test_make_env_raises_what_a_constructor_refuses_in_the_words_of_the_commands(
    override: str, kind: type[Exception], said: str
) -> None:
    with pytest.raises(kind, match=said) as refused:
        splatrl.make_env(["task=grid", *override.split()], [1])
    assert type(refused.value) is kind and refused.value.__cause__ is not None
    assert "\n" not in str(refused.value)
