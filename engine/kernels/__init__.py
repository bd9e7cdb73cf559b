"""Compiled kernels: how they are compiled, kept on disk, loaded, and divided among threads.

Start at `jit`: `kernel`, `parallel_kernel` and `inlined`.
"""
