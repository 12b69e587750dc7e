"""Image -> Image: the repairs of a material before it is printed or simulated.

Every operation adds a step to the recipe; `trapped` and `print_check` change nothing.
"""

from trabecula.finish.closed_pores import fill_trapped, trapped
from trabecula.finish.connect import connect
from trabecula.finish.contacts import mend_contacts
from trabecula.finish.crust import add_crust
from trabecula.finish.drain import drain
from trabecula.finish.floaters import remove_floaters
from trabecula.finish.forms import mask_steps, periodic_axes
from trabecula.finish.offset import offset
from trabecula.finish.operations import OPERATIONS
from trabecula.finish.printing import PrintCheck, print_check
from trabecula.finish.prune import prune
from trabecula.finish.scan import ScanModel, fit_scan, scan
from trabecula.finish.slabs import finish_slabs
from trabecula.finish.smooth import smooth
from trabecula.finish.thicken import thicken

__all__ = [
    "OPERATIONS",
    "PrintCheck",
    "ScanModel",
    "add_crust",
    "connect",
    "drain",
    "fill_trapped",
    "finish_slabs",
    "fit_scan",
    "mask_steps",
    "mend_contacts",
    "offset",
    "periodic_axes",
    "print_check",
    "prune",
    "remove_floaters",
    "scan",
    "smooth",
    "thicken",
    "trapped",
]
