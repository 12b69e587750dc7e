"""Tools that methods share: the coarse-to-fine loop, the content of images as fields, search and
vote on neighbourhoods, statistics of fields, and solid texture from pictures. They know no method.
"""
