"""Physics with MuJoCo: robots and things that have bodies in a scene."""

from splatrl.physics.bank import Variation, bank
from splatrl.physics.compose import Composed, compose
from splatrl.physics.courses import draw_courses
from splatrl.physics.gaussians import BodyGaussians, gaussians_from_mjcf
from splatrl.physics.kinematics import Kinematics
from splatrl.physics.mjcf import mjcf_files, read_mjcf
from splatrl.physics.routes import RouteSettings
from splatrl.physics.solids import Solids
from splatrl.physics.state_layout import StateLayout
from splatrl.physics.stepping import Physics, Stepped
from splatrl.physics.terrain import Terrain, level_ground
from splatrl.physics.tracks import TrackSettings

__all__ = [
    "BodyGaussians",
    "Composed",
    "Kinematics",
    "Physics",
    "RouteSettings",
    "Solids",
    "StateLayout",
    "Stepped",
    "Terrain",
    "TrackSettings",
    "Variation",
    "bank",
    "compose",
    "draw_courses",
    "gaussians_from_mjcf",
    "level_ground",
    "mjcf_files",
    "read_mjcf",
]
