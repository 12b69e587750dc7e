"""Search and vote: neighbourhoods of the output on a grid, each matched with one of the exemplar,
averaged where they overlap.
"""
