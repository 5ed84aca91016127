"""What is solid in a scene, and whether a robot's body touches it."""

from splatrl.collision.base import Checker
from splatrl.collision.distances import DistanceField
from splatrl.collision.fcl import FclChecker
from splatrl.collision.occupancy import Occupancy

__all__ = ["Checker", "DistanceField", "FclChecker", "Occupancy"]
