"""Is it the same material? The certificate: numbers of two images, the spread between the
exemplar's own parts, a verdict. And `inspect`, the look at a scan before any work."""

from trabecula.report.certificate import verify
from trabecula.report.ensemble import verify_ensemble
from trabecula.report.ensemble_certificate import EnsembleCertificate
from trabecula.report.inspection import Inspection, inspect
from trabecula.report.metrics import Metric
from trabecula.report.page import page, write_page
from trabecula.report.recommend import Recommendation, recommend
from trabecula.report.verdict import Certificate

__all__ = [
    "Certificate",
    "EnsembleCertificate",
    "Inspection",
    "Metric",
    "Recommendation",
    "inspect",
    "page",
    "recommend",
    "verify",
    "verify_ensemble",
    "write_page",
]
