"""Which transforms only a simulation needs."""

from collections.abc import Iterable

from torchrl.envs import Transform

from splatrl.envs.transforms.appearance import Appearance
from splatrl.envs.transforms.latency import Latency
from splatrl.envs.transforms.pose_noise import PoseNoise
from splatrl.envs.transforms.weather import Weather

SIMULATED = (Appearance, Latency, PoseNoise, Weather)
"""Transforms that make the simulation more like reality; with a real camera none of them is needed."""


def simulated(transforms: Iterable[Transform]) -> list[str]:
    """Return the names of the transforms that only a simulation needs, in their order."""
    return [type(each).__name__ for each in transforms if isinstance(each, SIMULATED)]
