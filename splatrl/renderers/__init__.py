"""Renderers, which turn cameras into images of a scene or of several placed models."""

from splatrl.renderers.base import Renderer, RenderOutput
from splatrl.renderers.blocks import BlockRenderer
from splatrl.renderers.cuda import CudaRenderer
from splatrl.renderers.device_cache import DeviceLatticeRenderer
from splatrl.renderers.gsplat import GsplatRenderer
from splatrl.renderers.native import Effort, NativeRenderer
from splatrl.renderers.nothing import NoRenderer
from splatrl.renderers.parts import ABSENT, Parts
from splatrl.renderers.reference import ReferenceRenderer
from splatrl.renderers.view_cache import LatticeRenderer

__all__ = [
    "ABSENT",
    "BlockRenderer",
    "CudaRenderer",
    "DeviceLatticeRenderer",
    "Effort",
    "GsplatRenderer",
    "LatticeRenderer",
    "NativeRenderer",
    "NoRenderer",
    "Parts",
    "ReferenceRenderer",
    "RenderOutput",
    "Renderer",
]
