"""Run the suite again and again, in random order and beside full load: no test may fail once.

    python tests/soak.py [--runs 10] [pytest's arguments]

Beside the tests each core has a process that computes. The log of each run goes to
`build/soak/N.log`; a line for each is printed, and the exit status is 1 where a run failed.
"""

from __future__ import annotations

import argparse
import multiprocessing
import subprocess
import sys
from pathlib import Path

LOGS = Path("build") / "soak"


def compute() -> None:
    """Use one core until the process ends."""
    while True:
        sum(range(1_000_000))


def run(number: int, arguments: list[str]) -> tuple[int, str]:
    """Run the suite in the order of a seed; return its exit status and its closing line."""
    log = LOGS / f"{number}.log"
    command = [sys.executable, "-m", "pytest", "-n", "auto", "--shuffle", str(number), *arguments]
    with log.open("wb") as file:
        status = subprocess.run(command, stdout=file, stderr=file, check=False).returncode
    return status, log.read_text(encoding="utf-8").rstrip().rpartition("\n")[2]


def main() -> int:
    """Run the suite as often as asked; return 1 where a run failed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=10, help="default: %(default)s")
    chosen, arguments = parser.parse_known_args()
    LOGS.mkdir(parents=True, exist_ok=True)
    load = [
        multiprocessing.Process(target=compute, daemon=True)
        for _ in range(multiprocessing.cpu_count())
    ]
    for process in load:
        process.start()
    failed = 0
    for number in range(1, chosen.runs + 1):
        status, line = run(number, arguments)
        failed += status != 0
        sys.stdout.write(f"{number:3}  {line}\n")
        sys.stdout.flush()
    sys.stdout.write(f"{chosen.runs - failed} of {chosen.runs} runs passed\n")
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
