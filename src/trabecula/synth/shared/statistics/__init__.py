"""What a field and an exemplar have in common without a voxel copied: distributions of
neighbourhoods, two-point functions.
"""
