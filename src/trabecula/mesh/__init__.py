"""Image -> closed surface -> file for the printer.

`tb.mesh(image)` is the function `trabecula.mesh.surface.mesh`, and this package has the same name,
so the package can be called and passes the call on.
"""

from trabecula.core.lazy import make_callable

make_callable(__name__, "trabecula.mesh.surface:mesh")
