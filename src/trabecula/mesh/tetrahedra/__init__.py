"""Tetrahedra that follow the phases: smooth interfaces, shared nodes."""
