"""Batches over several scenes: one module whose scene-dependent tensors are selected for each row of a batch.

A motion or task lists in ``of_scene`` which of its tensors belong to the scene, such as bounds, heights and goals. Its
formulas broadcast, so they work alike with a tensor [2] shared by all rows and with a tensor [B, 2], one row each.
"""

import copy
from collections.abc import Sequence
from typing import Any, Self, TypeVar, cast

import torch
from torch import Tensor, nn

Module = TypeVar("Module", bound=nn.Module)


class SelfStacking(nn.Module):
    """A module that joins those of several scenes itself, and selects rows itself, in place of what is below."""

    @classmethod
    def joined(cls, scenes: Sequence[Self]) -> Self:
        """Join the modules of several scenes, one for each, into one of all of them."""
        raise NotImplementedError

    def at(self, scene: Tensor) -> Self:
        """Return the joined module for rows in given scenes, [B] int64."""
        raise NotImplementedError


def stacked(modules: Sequence[Module], name: str = "task") -> Module:
    """Stack modules of several scenes into one: its scene-dependent tensors are [S, ...], everything else is shared.

    Args:
        modules: one module per scene.
        name: config key of the module, for error messages.

    Raises:
        ValueError: if anything else differs; the error names its key.
    """
    first = modules[0]
    if isinstance(first, SelfStacking):
        return cast(Module, first.joined(cast(Any, modules)))
    result = copy.copy(first)
    result._buffers, result._modules = dict(first._buffers), dict(first._modules)
    if any(type(module) is not type(first) for module in modules):
        raise ValueError(f"{name}: expected the same class in all scenes, got {', '.join(_kinds(modules))}")
    own: tuple[str, ...] = getattr(first, "of_scene", ())
    for key in first._modules:
        result._modules[key] = stacked([module.get_submodule(key) for module in modules], f"{name}.{key}")
    for key in (key for key in vars(first) if not key.startswith("_") and key not in own):
        values = [vars(module)[key] for module in modules]
        if not all(_equal(value, values[0]) for value in values):
            raise _differs(f"{name}.{key}", values)
    for key in first._buffers:
        values = [module._buffers[key] for module in modules]
        if key in own:
            result._buffers[key] = torch.stack([value for value in values if value is not None])
        elif not all(_equal(value, values[0]) for value in values):
            raise _differs(f"{name}.{key}", values)
    return result


def rows_of(module: Module, scene: Tensor) -> Module:
    """Select the scene of each row from a ``stacked`` module: its scene-dependent tensors become [B, ...].

    Args:
        module: module made by ``stacked``.
        scene: [B] int64, the scene of each row.
    """
    if isinstance(module, SelfStacking):
        return cast(Module, module.at(scene))
    result = copy.copy(module)
    result._buffers, result._modules = dict(module._buffers), dict(module._modules)
    for key in getattr(module, "of_scene", ()):
        if (values := module._buffers.get(key)) is not None:
            result._buffers[key] = values.index_select(0, scene)
    for key, child in module._modules.items():
        result._modules[key] = child if child is None else rows_of(child, scene)
    return result


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, Tensor) and isinstance(other, Tensor):
        return one.shape == other.shape and bool((one == other).all())
    return bool(one == other)


def _kinds(modules: Sequence[nn.Module]) -> list[str]:
    return list(dict.fromkeys(type(module).__name__ for module in modules))


def _differs(key: str, values: Sequence[Any]) -> ValueError:
    plain = [value.tolist() if isinstance(value, Tensor) else value for value in values]
    got = list(dict.fromkeys(str(value) for value in plain))
    return ValueError(f"{key}: expected the same in all scenes, got {' and '.join(got[:3])}; type {key}=...")
