"""A family of generated yards: a different place for every seed, as hard as the backyard, with a red egg to find."""

from splatrl.scenes.yards.source import Yard, made_yards, proposals, yard, yards

__all__ = ["Yard", "made_yards", "proposals", "yard", "yards"]
