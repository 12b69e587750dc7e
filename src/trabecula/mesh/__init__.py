"""Image -> closed surface -> file for the printer.

`tb.mesh(image)` is the function `trabecula.mesh.surface.mesh`, and this package has the same name.
Importing a module of the package first would leave `tb.mesh` a plain module, so the package itself
can be called and passes the call on.
"""

import sys
from types import ModuleType
from typing import Any


class _Room(ModuleType):
    def __call__(self, *args: Any, **options: Any) -> Any:
        from trabecula.mesh.surface import mesh

        return mesh(*args, **options)


sys.modules[__name__].__class__ = _Room
