"""Is it the same material? The certificate: numbers of two images, what the exemplar's own parts
differ by, a verdict."""

from trabecula.report.certificate import verify
from trabecula.report.verdict import Certificate, Metric
from trabecula.report.page import page, write_page

__all__ = ["Certificate", "Metric", "page", "verify", "write_page"]
