"""Density from topology optimisation (SIMP): least compliance for a given volume, matrix-free."""

from trabecula.fields.topology.cases import CASES, Case, Load, Support, case
from trabecula.fields.topology.optimise import simp

__all__ = ["CASES", "Case", "Load", "Support", "case", "simp"]
