"""Files <-> Images: one module a format, declared in one table (`formats`)."""

from trabecula.io.files import read, write
from trabecula.io.formats import Format
from trabecula.io.lazy import open_slabs
from trabecula.io.metadata import FileContent

__all__ = ["FileContent", "Format", "open_slabs", "read", "write"]
