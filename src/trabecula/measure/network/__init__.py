"""Pore networks: pores, the throats between them, and flow through them."""

from trabecula.measure.network.extract import network
from trabecula.measure.network.pore_network import PoreNetwork, Throats

__all__ = ["PoreNetwork", "Throats", "network"]
