"""`network` and `bodies`: the figures and files of the library."""

import json
from pathlib import Path

import numpy as np
import pytest

import trabecula as tb
from commands import refused, trabecula


@pytest.fixture
def rooms(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    values = np.ones((8, 9, 20), np.uint8)
    values[:, 1:8, 1:8] = values[1:7, 1:8, 11:18] = values[3:6, 3:6, 8:11] = 0
    image = tb.Image(values, "labels", spacing=2.0, unit="um", phases=("void", "solid"))
    tb.write(image, "rooms.zarr")
    return image


def test_figures_are_those_of_the_library(rooms):
    net = tb.measure.network(rooms)
    words = ("network", "rooms.zarr", "--direct", "--json", "--out", "net.npz")
    found = json.loads(trabecula(*words).out)
    assert {name: found[name] for name in net.summary()} == net.summary()
    assert found["permeability"]["z"] == net.permeability(0).value
    assert found["permeability"]["y"] == found["diffusivity"]["x"] == "does not percolate"
    direct = tb.measure.permeability(rooms, axis=0)
    assert found["direct_permeability"]["z"] == pytest.approx(direct.value)
    assert found["direct_permeability"]["y"] == "does not percolate"
    assert found["out"] == ["net.npz"]
    assert len(np.load("net.npz")["throat.conns"]) == len(net.throats) + len(net.openings)
    assert "coordination" in trabecula("network", "rooms.zarr", "--reach", "3").out


def test_options_reach_the_watershed(rooms):
    words = ("network", "rooms.zarr", "--json")
    own = json.loads(trabecula(*words, "--periodic", "z").out)
    assert own["openings"] == 0 < json.loads(trabecula(*words).out)["openings"]
    solid = json.loads(trabecula(*words, "--phase", "solid").out)
    assert solid["pores"] == len(tb.measure.network(rooms, phase="solid"))


def test_bodies(rooms):
    found = json.loads(
        trabecula("bodies", "rooms.zarr", "--phase", "void", "--json", "--out", "b.csv").out
    )
    own = tb.measure.bodies(rooms, phase="void")
    assert found["bodies"] == len(own) == 2
    assert found["out"] == ["b.csv"] and len(Path("b.csv").read_text().splitlines()) == 3
    joined = ("bodies", "rooms.zarr", "--phase", "void", "--components", "--json")
    assert json.loads(trabecula(*joined).out)["bodies"] == 1


def test_what_does_not_go_is_refused(rooms):
    assert "among z, y, x" in refused("network", "rooms.zarr", "--periodic", "w")
    assert "format of a network" in refused("network", "rooms.zarr", "--out", "a.pnm")
    assert "pores and throats" in refused("bodies", "rooms.zarr", "--out", "a.dat")
    assert "--reach" in refused("network", "rooms.zarr", "--reach", "far")
    np.save("flat.npy", rooms.values[:, 4])
    flat = ("flat.npy", "--kind", "labels", "--phases", "void", "solid")
    assert "2-D" in refused("network", *flat) and "2-D" in refused("bodies", *flat)
