"""The background of two phases without a void: the other phase."""

import numpy as np
import pytest

import trabecula as tb

OPERATIONS = {
    "add_crust": {"thickness": 2},
    "connect": {},
    "remove_floaters": {},
    "mend_contacts": {},
    "fill_trapped": {},
    "smooth": {"sigma": 0.7},
    "thicken": {"thickness": 3},
    "offset": {"fraction": 0.07},
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_the_other_of_two_phases_is_what_is_left(name):
    values = np.zeros((14, 14, 14), np.uint8)
    values[2:12, 5:9, 5:9], values[0, 0, 0], values[6, 6, 6] = 1, 1, 0
    values[12, 9, 5] = 1  # touches by an edge
    finish = tb.finish.OPERATIONS[name]
    named = finish(tb.Image(values, "labels"), **OPERATIONS[name])
    other = finish(
        tb.Image(values, "labels", phases=("rest", "binder")), phase="binder", **OPERATIONS[name]
    )
    assert np.array_equal(named.values, other.values) and not np.array_equal(named.values, values)
