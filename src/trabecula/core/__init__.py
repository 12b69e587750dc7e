"""Nouns and small tools. This room imports NumPy and nothing else."""
