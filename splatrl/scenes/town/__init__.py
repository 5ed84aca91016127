"""A generated town: streets of houses and yards in square blocks, as a scene in blocks."""

from splatrl.scenes.town.source import town

__all__ = ["town"]
