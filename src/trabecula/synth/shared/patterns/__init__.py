"""Patterns of labels, voxel by voxel, and the step that brings those of new material to the
exemplar's.

`counts` says what is counted, `kernels` and `balls` count it, `changes` what one voxel changes of
it; `flips` changes voxels, block by block (`flip_block`).
"""
