"""Volumes as printers build them, layer by layer and without a mesh: stacks of pictures for
material jetting and for masked light, and contours.
"""
