"""Apparent properties of windows: what each is by itself, however small (Huet 1990,
doi:10.1016/0022-5096(90)90041-2).

The window is taken for a cell of the periodic medium that mirrors of it build, so that nothing
depends on how its faces would fit each other. Thousands are solved, each by itself.
"""

from trabecula.measure.apparent.properties import CONDUCTION, ELASTICITY, apparent_along

__all__ = ["CONDUCTION", "ELASTICITY", "apparent_along"]
