"""Cached configs equal those that Hydra composes, and each caller gets its own copy."""

import pytest
from hydra import compose
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf

from splatrl.configuration import load_config
from splatrl.configuration.search_path import composed, config_loader


def by_hydra(overrides: list[str], name: str) -> DictConfig:
    with config_loader():
        return compose(name, overrides)


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("train", []),
        ("train", ["task=fps", "seed=3", "robot.height=0.4", "scene=yard"]),
        ("train", ["seed=3", "task=fps", "seed=4", "motion@task.motion=drive", "task.motion.lower=[-1,-2]"]),
        ("train", ["robot.body.size=[0.1,0.2,0.3]", "transforms/skip=four", "landmarks.goal=null", "demos='a b'"]),
        ("train", ["robot.height=${task.motion.step}"]),
        ("train", ["+own.key=1", "own.key=2", "~curriculum"]),
        ("train", ["robot={height: 0.7}", "renderer.threads=2"]),
        ("evaluate", ["run=a/b"]),
        ("experiment", ["name=grid"]),
    ],
)
def test_a_config_is_what_hydra_composes(name: str, overrides: list[str]) -> None:
    for _ in range(2):
        got, expected = (make(overrides, name) for make in (composed, by_hydra))
        assert got == expected and OmegaConf.to_yaml(got) == OmegaConf.to_yaml(expected)
        assert OmegaConf.is_struct(got) == OmegaConf.is_struct(expected)


def test_changes_to_a_config_do_not_affect_the_next_one() -> None:
    first = load_config(["task=fps", "seed=5"])
    first.robot.height, first.task.motion.step = 9.0, 9.0
    second = load_config(["task=fps"])
    assert second.seed == 0 and second.robot.height != 9.0 and second.task.motion.step != 9.0


@pytest.mark.parametrize(
    "override", ["robot.hight=1", "task=nothing", "seed=1,2", "robot@height=one", "seed.a=1", "transforms/skip=[a,b]"]
)
def test_invalid_overrides_raise_the_same_errors_as_in_hydra(override: str) -> None:
    said = []
    for make in (composed, by_hydra):
        with pytest.raises(HydraException) as error:
            make([override], "train")
        said.append(str(error.value))
    assert said[0] == said[1]
