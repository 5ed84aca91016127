"""Scenes: Gaussians, the files that they come in, and their metric frame."""

from splatrl.scenes.formats import read_gaussians, write_gaussians
from splatrl.scenes.frame import similarity
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Scene, load_scene

__all__ = ["Gaussians", "Scene", "load_scene", "read_gaussians", "similarity", "write_gaussians"]
read_scene = load_scene
def backyard(seed=0, clutter=0, bounds=None): return load_scene("backyard", None, bounds, None, seed, clutter)
