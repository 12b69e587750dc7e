"""Pore networks: pores, the throats between them, and flow through them."""

from trabecula.measure.network.extract import coordination, network, throat_radius
from trabecula.measure.network.pore_network import PoreNetwork, Throats

__all__ = ["PoreNetwork", "Throats", "coordination", "network", "throat_radius"]
