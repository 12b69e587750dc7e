"""Image -> Image: what a material needs before it is printed or simulated. Every operation adds a step to the
recipe."""

from trabecula.finish.connect import connect

# By the name that stands in a recipe's step, so that the step can be done again.
OPERATIONS = {"connect": connect}

__all__ = ["OPERATIONS", "connect"]
