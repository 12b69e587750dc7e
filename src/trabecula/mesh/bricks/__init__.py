"""Voxels as bricks for solvers: finite elements and finite volumes, written plane by plane."""
