"""Exporting a trained policy to a single ONNX file that needs neither PyTorch nor splatrl."""

from splatrl.export.onnx_file import export_policy
from splatrl.export.policy import StandalonePolicy

__all__ = ["StandalonePolicy", "export_policy"]
