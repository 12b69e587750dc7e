"""Networks and bodies as files: tables of named columns for other programs."""

from trabecula.io.networks.formats import FORMATS, write_tables

__all__ = ["FORMATS", "write_tables"]
