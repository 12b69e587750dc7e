"""Execution of work: compiled kernels, threads over slabs, random numbers by coordinate, declared
memory, memory-mapped arrays, checkpoints, blocks on workers, stores.
"""
