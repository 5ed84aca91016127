"""A bank of models of one world with different physical parameters, from which each episode takes one."""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splatrl.physics.optional import needed
from splatrl.values import require_number

MUSCLE_SHAPE = [0, 1, 4, 5, 6, 7, 8]
"""Indices of a muscle's parameters that shape its curves; 2 and 3 set its peak force."""


@dataclass(frozen=True)
class Variation:
    """Ranges of the factors by which physics differs between episodes, drawn log-uniformly.

    Attributes:
        models: number of models, the first of which is as the files define it.
        friction: smallest and largest factor of all friction, one per model.
        mass: smallest and largest factor of mass and inertia, one per body.
        motor: smallest and largest factor of an actuator's strength, one per actuator. The ``actuatorfrcrange`` of a
            joint or tendon takes the factor of the actuator that drives it, or the mean of several.
        seed: seed of the draws.

    Raises:
        ValueError: for a number out of range.
    """

    models: int = 1
    friction: Sequence[float] = (1.0, 1.0)
    mass: Sequence[float] = (1.0, 1.0)
    motor: Sequence[float] = (1.0, 1.0)
    seed: int = 0

    def __post_init__(self) -> None:
        require_number("models", self.models, 1, 4096, whole=True)
        require_number("seed", self.seed, 0, 2**63 - 1, whole=True)
        for field in fields(self)[1:4]:
            pair = getattr(self, field.name)
            if len(pair) != 2 or not 0.0 < pair[0] <= pair[1] <= 100.0:
                raise ValueError(f"{field.name}: expected two factors, 0 < lowest ≤ highest ≤ 100, got {list(pair)}")

    @property
    def unused(self) -> bool:
        """Whether ranges are given that change nothing, because the only model is as the files define it."""
        return self.models == 1 and any(tuple(pair) != (1.0, 1.0) for pair in (self.friction, self.mass, self.motor))


def bank(model: Any, variation: Variation) -> list[Any]:
    """Return the model and varied copies of it, ``variation.models`` in all."""
    rng = np.random.default_rng(variation.seed)
    return [model, *(_varied(model, variation, rng) for _ in range(variation.models - 1))]


def _varied(model: Any, variation: Variation, rng: np.random.Generator) -> Any:
    mujoco, own = needed(), copy.copy(model)
    friction, mass, motor = (
        np.exp(rng.uniform(math.log(pair[0]), math.log(pair[1]), size))
        for pair, size in (
            (variation.friction, 1),
            (variation.mass, model.nbody),
            (variation.motor, model.nu),
        )
    )
    own.geom_friction[:] *= friction
    own.body_mass[:] *= mass
    own.body_inertia[:] *= mass[:, None]
    _strengthen(own, motor)
    mujoco.mj_setConst(own, mujoco.MjData(own))
    return own


def _strengthen(model: Any, motor: NDArray[np.float64]) -> None:
    """Multiply the strength of a model's actuators by factors [nu]."""
    mujoco = needed()
    muscle, muscle_bias = mujoco.mjtGain.mjGAIN_MUSCLE, mujoco.mjtBias.mjBIAS_MUSCLE
    gains = (model.actuator_gainprm, model.actuator_gaintype == muscle)
    biases = (model.actuator_biasprm, model.actuator_biastype == muscle_bias)
    for table, muscles in (gains, biases):
        factors = np.tile(motor[:, None], table.shape[1])
        factors[np.ix_(muscles, MUSCLE_SHAPE)] = 1.0
        table *= factors
    model.actuator_forcerange[:] *= motor[:, None]
    kinds = mujoco.mjtTrn
    joints = (model.jnt_actfrcrange, (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT))
    tendons = (model.tendon_actfrcrange, (kinds.mjTRN_TENDON,))
    for ranges, transmissions in (joints, tendons):
        drives = np.isin(model.actuator_trntype, transmissions)
        driven = model.actuator_trnid[drives, 0]
        count, total = (np.bincount(driven, weights, len(ranges)) for weights in (None, motor[drives]))
        ranges *= np.where(count > 0, total / np.maximum(count, 1), 1.0)[:, None]
