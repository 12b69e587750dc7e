"""Statistics that a field is brought to without copying a voxel: distributions of neighbourhoods,
two-point functions, long waves.
"""
