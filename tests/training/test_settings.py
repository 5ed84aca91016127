"""Settings refuse invalid values."""

from dataclasses import replace

import pytest

from tests.training.test_ppo import LOSS, OPTIM


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("gamma", 1.01, "number from 0.0 to 1.0"),
        ("gamma", "abc", "number from 0.0 to 1.0"),
        ("gae_lambda", -0.1, "number from 0.0 to 1.0"),
        ("clip_epsilon", -1, "number of at least 0.0"),
        ("reward_scale", float("nan"), "number of at least 0.0"),
        ("ppo_epochs", 0, "whole number of at least 1"),
        ("mini_batch_size", 1.5, "whole number of at least 1"),
        ("critic_coeff", True, "number of at least 0.0"),
    ],
)
def test_a_loss_setting_out_of_range_is_named(name: str, value: object, expected: str) -> None:
    with pytest.raises(ValueError, match=rf"loss\.{name}: expected a {expected}, got {value!r}"):
        replace(LOSS, **{name: value})


@pytest.mark.parametrize("name", ["lr", "eps", "max_grad_norm"])
def test_an_optimiser_setting_out_of_range_is_named(name: str) -> None:
    with pytest.raises(ValueError, match=rf"optim\.{name}: expected a number of at least 0.0, got -1"):
        replace(OPTIM, **{name: -1})
