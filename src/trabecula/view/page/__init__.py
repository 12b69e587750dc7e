"""`view`: volumes as a page that turns, cuts and shades, in a browser with WebGL 2.

The page is one file: the volumes packed, a ray marcher (`march.frag`, the model of `rays` and
`shading`) and its controls, written by hand. It asks nothing of the network, and its policy forbids
it to.
"""

from trabecula.view.page.document import Page
from trabecula.view.page.show import view

__all__ = ["Page", "view"]
