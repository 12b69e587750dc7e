"""Execution of work: compiled kernels, threads over slabs, random numbers by coordinate, declared
memory, memory-mapped arrays, checkpoints, blocks on workers, stores.
"""

__all__ = [
    "blocks",
    "checkpoint",
    "chunking",
    "cluster",
    "compile",
    "files",
    "gaussian_random",
    "lazy_volume",
    "lock",
    "memmap",
    "memory",
    "multiscale",
    "parallel",
    "random",
    "storage",
    "store",
    "tensors",
    "timing",
]
