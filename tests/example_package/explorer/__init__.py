"""A task, a transform, a network and a scene of one's own, in a package of one's own."""
