"""Patterns of labels, voxel by voxel, and the step that brings those of new material to the
exemplar's.

`counts` says what is counted, `kernels` counts it and what one voxel changes of it, `flips` changes
voxels.
"""
