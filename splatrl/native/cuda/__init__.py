"""CUDA kernels, compiled where they run: nobody needs a CUDA toolkit."""
