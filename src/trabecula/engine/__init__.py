"""How work runs: compiled kernels, threads over tiles, random numbers by coordinate, memory
budgets, stores.
"""
