"""The fit of Gaussians to photos whose poses are known: the stage ``fit``, its parts, and its kernels on a GPU."""
