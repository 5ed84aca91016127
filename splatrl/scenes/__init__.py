"""Scenes: Gaussians, the files that store them, and their metric frame."""

from splatrl.scenes.formats import read_gaussians, write_gaussians
from splatrl.scenes.frame import similarity
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Scene
from splatrl.scenes.sources import backyard, read_scene

__all__ = ["Gaussians", "Scene", "backyard", "read_gaussians", "read_scene", "similarity", "write_gaussians"]
