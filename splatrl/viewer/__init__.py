"""The viewer: a browser page that shows a scene, lets goals and bounds be moved, and drives robots."""
