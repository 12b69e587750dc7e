"""Solvers and transforms that know no physics: Krylov methods, a multigrid cycle, sums over vectors
in a fixed order, and Fourier transforms. Operators and levels come from the caller.
"""
