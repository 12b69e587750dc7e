"""Image -> picture: stills of volumes, sheets of slices, a page that turns. One table of looks for
all of them.

`tb.view(image)` is the function `trabecula.view.page.view`; this room has the same name, so the
room can be called and passes the call on (as `trabecula.mesh`).
"""

from trabecula.core.lazy import make_callable

make_callable(__name__, "trabecula.view.page:view")
