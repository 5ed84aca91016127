"""From a phone video to a scene that robots can train in: one module per stage."""
