"""Images to learn from: segment, crop, place, views of pictures, and the samples that the package
makes itself.
"""

__all__ = ["crop", "margins", "place", "samples", "sections", "segment", "target", "views"]
