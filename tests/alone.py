"""Functions of test modules in a process of their own: counts of allocations see what ran before,
and globals that they change stay changed.
"""

import json
import subprocess
import sys
from pathlib import Path

_CALL = """
import importlib, json, sys
sys.path[:0] = json.loads(sys.argv[1])
function = getattr(importlib.import_module(sys.argv[2]), sys.argv[3])
print(json.dumps(function(*json.loads(sys.argv[4]))))
"""


def call_alone(function, *values):
    """Return what a module's function gives for plain values, as JSON."""
    place = Path(sys.modules[function.__module__].__file__)
    words = [json.dumps([str(place.parent), *sys.path]), place.stem, function.__name__]
    done = subprocess.run(
        [sys.executable, "-c", _CALL, *words, json.dumps(values)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])
