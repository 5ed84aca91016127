"""The configs of this package."""
