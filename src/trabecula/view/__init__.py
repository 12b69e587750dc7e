"""Image -> picture: stills of volumes, sheets of slices, a page that turns. One table of looks for
all of them.

`tb.view(image)` is the function `trabecula.view.page.view`; this room has the same name, so the
room can be called and passes the call on (as `trabecula.mesh`).
"""

import sys
from types import ModuleType
from typing import Any


class _Room(ModuleType):
    def __call__(self, *args: Any, **options: Any) -> Any:
        from trabecula.view.page import view

        return view(*args, **options)


sys.modules[__name__].__class__ = _Room
