"""Density from topology optimisation (SIMP): least compliance for a given volume, matrix-free."""

from trabecula.fields.topology.cases import CASES, Case, Load, LoadSet, FixedRegion, Support, case
from trabecula.fields.topology.optimise import simp
from trabecula.fields.topology.places import Place
from trabecula.fields.topology.stress import PrincipalStress, principal_stress

__all__ = [
    "CASES",
    "Case",
    "Load",
    "LoadSet",
    "Place",
    "PrincipalStress",
    "FixedRegion",
    "Support",
    "case",
    "principal_stress",
    "simp",
]
