"""Readers and writers of splat files: PLY, compressed PLY, SPZ, .splat and SOG."""

from splatrl.scenes.formats.reading import read_gaussians
from splatrl.scenes.formats.writing import write_gaussians

__all__ = ["read_gaussians", "write_gaussians"]
