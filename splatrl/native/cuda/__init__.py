"""CUDA kernels, compiled on the machine where they run, so that no CUDA toolkit is needed."""
