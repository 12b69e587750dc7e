"""Solvers and transforms that know no physics: Krylov methods, a multigrid cycle, sums over vectors
in a fixed order, Fourier transforms, and bits. Operators and levels come from the caller.
"""
