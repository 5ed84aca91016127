"""A window into a scene: a page in the browser that shows what is there, lets things be moved, and drives robots."""
