"""Motions, which define how actions move a robot."""

from splatrl.motions.base import Motion, Move, PlannedMotion, Steering, Taps
from splatrl.motions.drive import DriveMotion
from splatrl.motions.finite import FiniteMotion
from splatrl.motions.forward import ForwardMotion
from splatrl.motions.lattice import LatticeMotion
from splatrl.motions.legs import LegsMotion, StridesMotion, WalkMotion
from splatrl.motions.module import MotionModule, SweptMotion
from splatrl.motions.navigate import NavigateMotion
from splatrl.motions.orbit import OrbitMotion
from splatrl.motions.physics import PhysicsMotion
from splatrl.motions.planar import PlanarMotion, StoppingMotion
from splatrl.motions.site import Fits, Site, narrowed
from splatrl.motions.steps import StepMotion

__all__ = [
    "DriveMotion",
    "FiniteMotion",
    "Fits",
    "ForwardMotion",
    "LatticeMotion",
    "LegsMotion",
    "Motion",
    "MotionModule",
    "Move",
    "NavigateMotion",
    "OrbitMotion",
    "PhysicsMotion",
    "PlanarMotion",
    "PlannedMotion",
    "Site",
    "Steering",
    "StepMotion",
    "StoppingMotion",
    "StridesMotion",
    "SweptMotion",
    "Taps",
    "WalkMotion",
    "narrowed",
]
