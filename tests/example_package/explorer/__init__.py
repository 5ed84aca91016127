"""An example of your own package, with a task, a transform, a network and a scene."""
