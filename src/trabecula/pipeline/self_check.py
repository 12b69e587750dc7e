"""Check that this machine makes the voxels of the release: tiny volumes, compared by their SHA-256.

They are made in a process of its own, which is stopped when the time is over: where kernels are
compiled first, that may take longer. What is compiled by then is kept for the next time.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import trabecula

RELEASED = {
    "noise": "02e505f2c814ffea526b875eecd622f1deab75e97a2c9ece7ed9a2d41e2d26fe",
    "texture": "95c24fe2369406e7b886a87feb950114f95644709bf09816b2123492120105c1",
}
"""SHA-256 of the volume of every method, as `core.recipe.digest` gives it."""

SAME, OTHER, UNFINISHED = "same", "other", "unfinished"


def self_check(*, limit: float = 10.0) -> dict[str, str]:
    """Make a tiny volume by each method of `RELEASED`, and compare it.

    Parameters
    ----------
    limit : float
        Time for all of them, seconds.

    Returns
    -------
    dict
        Method -> "same", "other", "unfinished" (the time was over), or "failed: " and why.
    """
    home = str(Path(trabecula.__file__).resolve().parents[1])
    code = (
        f"import sys; sys.path.insert(0, {home!r})\n"
        "from trabecula.pipeline.self_check import print_digests\n"
        "print_digests()"
    )
    rest = UNFINISHED
    try:
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, timeout=limit, check=False
        )
        output = done.stdout
        if done.returncode:
            last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
            rest = " ".join(["failed:", *last])
    except subprocess.TimeoutExpired as error:
        output = error.stdout or b""
    except OSError as error:
        output, rest = b"", f"failed: {error}"
    made = dict(json.loads(line) for line in output.decode().splitlines())
    return {
        name: rest if name not in made else SAME if made[name] == released else OTHER
        for name, released in RELEASED.items()
    }


def print_digests() -> None:
    """Print a line of JSON, the method and its digest, for every volume as it is made."""
    from trabecula.core.recipe import digest
    from trabecula.synth.api.registry import method

    exemplar = method("noise", length=4).fit().generate((20, 20, 20), seed=2)
    _print("noise", digest(exemplar.values))
    settings: dict[str, Any] = {
        "neighbourhood": 4,
        "first_rounds": 2,
        "rounds": [1],
        "levels": 2,
        "novelty": 0,
    }
    made = method("texture", **settings).fit(exemplar).generate((16, 18, 20), seed=1)
    _print("texture", digest(made.values))


def _print(name: str, value: str) -> None:
    sys.stdout.write(json.dumps([name, value]) + "\n")
    sys.stdout.flush()
