"""CUDA kernels, compiled where they run, so that nobody needs a CUDA toolkit."""
