"""A family of generated yards, each another place by its seed, all as hard as the backyard, with a red egg to find."""

from splatrl.scenes.yards.source import Yard, made_yards, proposals, yard, yards

__all__ = ["Yard", "made_yards", "proposals", "yard", "yards"]
