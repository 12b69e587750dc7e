"""What a voxel of the output can be besides a label: not made yet, not to be made, or given."""

EMPTY = 255
"""Not made yet."""
OUT = 254
"""Outside the volume, or outside the form."""
FIXED = 16
"""Added to the label of a measured voxel; labels run below it."""
