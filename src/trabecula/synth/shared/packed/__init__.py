"""Bodies in a box that repeats, pushed apart and drawn: what packing and fibres share."""
