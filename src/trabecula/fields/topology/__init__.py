"""Density from topology optimisation (SIMP): least compliance for a given volume, matrix-free."""

from trabecula.fields.topology.cases import CASES, Case, FixedRegion, Load, LoadSet, Support, case
from trabecula.fields.topology.optimise import simp
from trabecula.fields.topology.places import Place
from trabecula.fields.topology.response import part_stress
from trabecula.fields.topology.stress import PrincipalStress, principal_stress

__all__ = [
    "CASES",
    "Case",
    "FixedRegion",
    "Load",
    "LoadSet",
    "Place",
    "PrincipalStress",
    "Support",
    "case",
    "part_stress",
    "principal_stress",
    "simp",
]
