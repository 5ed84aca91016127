"""Voxel occupancy of a scene, and the checkers that test a robot's body against it."""

from splatrl.collision.base import Checker
from splatrl.collision.cuda import CudaChecker
from splatrl.collision.density import DensitySettings
from splatrl.collision.distances import DistanceField
from splatrl.collision.fcl import FclChecker
from splatrl.collision.native import NativeChecker
from splatrl.collision.nothing import NoChecker
from splatrl.collision.occupancy import Occupancy
from splatrl.collision.torch_checker import TorchChecker
from splatrl.collision.verify import Disagreement, Verification, verify, verify_sweeps

__all__ = [
    "Checker",
    "CudaChecker",
    "DensitySettings",
    "Disagreement",
    "DistanceField",
    "FclChecker",
    "NativeChecker",
    "NoChecker",
    "Occupancy",
    "TorchChecker",
    "Verification",
    "verify",
    "verify_sweeps",
]
