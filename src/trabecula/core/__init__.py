"""Nouns and small tools. This room imports NumPy and nothing else."""

__all__ = [
    "brief",
    "checks",
    "display",
    "errors",
    "expression",
    "image",
    "indexing",
    "optional",
    "progress",
    "recipe",
    "request",
    "seeds",
    "target",
]
