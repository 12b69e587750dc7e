"""Is it the same material? The certificate: numbers of two images, the spread between the
exemplar's own parts, a verdict. And `inspect`, the look at a scan before any work."""

from trabecula.report.certificate import verify
from trabecula.report.inspection import Inspection, inspect
from trabecula.report.metrics import Metric
from trabecula.report.page import page, write_page
from trabecula.report.recommend import Recommendation, recommend
from trabecula.report.verdict import Certificate

__all__ = [
    "Certificate",
    "Inspection",
    "Metric",
    "Recommendation",
    "inspect",
    "page",
    "recommend",
    "verify",
    "write_page",
]
