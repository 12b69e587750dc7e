"""Gaussian random fields of a covariance, the same in every box of an endless volume."""
