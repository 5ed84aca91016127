"""How actions move a robot."""

from splatrl.envs.motions.drive import DriveMotion
from splatrl.envs.motions.forward import ForwardMotion
from splatrl.envs.motions.lattice import LatticeMotion
from splatrl.envs.motions.orbit import OrbitMotion

__all__ = ["DriveMotion", "ForwardMotion", "LatticeMotion", "OrbitMotion"]
