"""Renderers: from cameras to images of one scene."""

from splatrl.renderers.base import Renderer, RenderOutput
from splatrl.renderers.cuda import CudaRenderer
from splatrl.renderers.gsplat import GsplatRenderer
from splatrl.renderers.lattice import LatticeRenderer
from splatrl.renderers.native import Effort, NativeRenderer
from splatrl.renderers.reference import ReferenceRenderer

__all__ = [
    "CudaRenderer",
    "Effort",
    "GsplatRenderer",
    "LatticeRenderer",
    "NativeRenderer",
    "ReferenceRenderer",
    "RenderOutput",
    "Renderer",
]
