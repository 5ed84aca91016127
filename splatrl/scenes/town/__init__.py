"""A generated town: streets, houses and yards on square plots, as a scene in blocks."""

from splatrl.scenes.town.source import town

__all__ = ["town"]
