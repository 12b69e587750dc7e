"""What a flow holds is no more than what is forecast."""

import tracemalloc

import numpy as np
import pytest

from trabecula.synth.bubbles.flow import FlowConfig, flow_of
from trabecula.synth.bubbles.flow.field import bytes_of_flow

SIDE = 72
FIELD = np.random.default_rng(1).normal(size=(8, 9, 10, 3))


@pytest.fixture(scope="module")
def form():
    return np.linalg.norm((np.indices((SIDE,) * 3) - (SIDE - 1) / 2) / (SIDE / 2), axis=0) < 1


@pytest.mark.whole
@pytest.mark.parametrize("step", [1, 4])
@pytest.mark.parametrize(
    "settings",
    [
        {"flow": "roll"},
        {"flow": "roll", "silhouette": 6.0},
        {"flow": "roll", "silhouette": 24.0, "crust": 3.0, "flow_axis": "y"},
        {"flow": "roll", "flow_centre": "piece"},
        {"crust": 9.0},
        {"flow": "x, y, z", "flow_regions": [["x > 0", "roll"]]},
        {"flow": FIELD},
        {"flow": lambda z, y, x: (x, y, z)},
    ],
)
def test_the_forecast_holds(form, settings, step):
    config, box = FlowConfig(**settings), ((0, SIDE),) * 3
    small = flow_of(config, (40,) * 3, 1.0, form[16:56, 16:56, 16:56])
    small.directions(((0, 9),) * 3)
    small.room(((0, 9),) * 3)  # kernels are compiled, tables read
    tracemalloc.start()
    flow = flow_of(config, form.shape, 1.0, form)
    found = flow.directions(box, step)
    for start in range(0, SIDE, 36):
        room = flow.room(((start, start + 36), *box[1:]))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    forecast = bytes_of_flow(config, form.shape, 1.0, masked=True, step=step) + found.nbytes
    assert peak <= forecast <= 3 * peak + 300_000
    assert (room is None) == ("crust" not in settings)
