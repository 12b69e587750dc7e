"""Damaged files and strange arguments by the thousand: `make fuzz`.

    python tests/fuzz/run.py files --count 10000 --seed 1
    python tests/fuzz/run.py arguments --count 1000
    python tests/fuzz/run.py files --case 1234        # one of them again, with its traceback

Every case is a function of the seed and of its number. Cases run in a child process, whose address
space is limited and which ends itself where a case takes too long; then another one goes on with
the next case. Wanted is an error of `trabecula.errors` in one line, or a sound result.
"""

import argparse
import contextlib
import faulthandler
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).parent
for place in (HERE, HERE.parent):
    if str(place) not in sys.path:
        sys.path.insert(0, str(place))

SECONDS = {"files": 20, "arguments": 300}
"""Of the processor, for one case: a busy machine does not look like a hang, nor does a kernel that
is compiled."""
WAIT = 600
"""Seconds of the clock, for one case that waits for something."""
FREE = 256 << 20
"""Bytes that the package is told to be free."""
ROOM = 768 << 20
"""Bytes that a child may take beyond what its imports took; more than the package is told, since a
file of a size that fits may be held more than once."""
REFUSED, SOUND = "refused", "sound"


def main(words: list[str] | None = None) -> int:
    """Run, and print what came of it by reader and damage."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("files", "arguments"))
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--case", type=int, help="run this one alone, and show its traceback")
    parser.add_argument("--child", nargs=2, metavar=("FIRST", "REPORT"), help=argparse.SUPPRESS)
    options = parser.parse_args(words)
    if options.case is not None:
        print(json.dumps(_one(options.what, options.seed, options.case, show=True)))
        return 0
    if options.child:
        _work(options, int(options.child[0]), Path(options.child[1]))
        return 0
    start = time.monotonic()
    found = []
    for case in run(options.what, options.count, options.seed):
        found.append(case)
        for line in failures([case]):
            print(line, flush=True)
    print(table(found))
    print(
        f"{len(found)} cases of {options.what} (seed {options.seed}) in "
        f"{time.monotonic() - start:.0f} s: {outcomes(found)}"
    )
    return 1 if failures(found) else 0


def run(what: str, count: int, seed: int) -> Iterator[dict]:
    """Yield what came of every case: its reader, its damage and its outcome."""
    with tempfile.TemporaryDirectory() as folder:
        first = 0
        while first < count:
            report = Path(folder) / f"report-{first}"
            said, ended = _start_child(what, count, seed, first, report)
            done = [json.loads(line) for line in report.read_text().splitlines()]
            lost = done.pop() if done and "outcome" not in done[-1] else None
            yield from (case for case in done if "outcome" in case)
            if lost is not None:
                outcome = "hung" if ended == -signal.SIGPROF or "Timeout" in said else "crashed"
                frames = said.rpartition("most recent call first")[2].splitlines()[1:8]
                yield {**lost, "outcome": outcome, "says": " < ".join(map(str.strip, frames))}
                first = lost["case"] + 1
            elif not done or done[-1]["case"] + 1 < count:
                raise RuntimeError(f"a child ended at case {first}: {said[-2000:]}")
            else:
                return


def _start_child(what: str, count: int, seed: int, first: int, report: Path) -> tuple[str, int]:
    """Run cases in another process until they end, or one ends it; return its standard error and
    its exit status.
    """
    report.touch()
    words = [what, "--count", str(count), "--seed", str(seed), "--child", str(first), str(report)]
    child = subprocess.run(
        [sys.executable, str(HERE / "run.py"), *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        cwd=report.parent,
        env={**os.environ, "TRABECULA_THREADS": "1"},
    )
    return child.stderr.decode("utf-8", "replace"), child.returncode


def _work(options: argparse.Namespace, first: int, report: Path) -> None:
    """Run the cases of a child, and write what comes of each before the next begins."""
    __import__(options.what).prepare()
    _limit_memory()
    stop = sys.stderr.fileno()
    faulthandler.register(signal.SIGPROF, file=stop, chain=True)  # then it ends the process
    with report.open("w") as file:
        for number in range(first, options.count):
            label = _label(options.what, options.seed, number)
            file.write(json.dumps({"case": number, **label}) + "\n")
            file.flush()
            faulthandler.dump_traceback_later(WAIT, exit=True, file=stop)
            signal.setitimer(signal.ITIMER_PROF, SECONDS[options.what])
            found = _one(options.what, options.seed, number)
            signal.setitimer(signal.ITIMER_PROF, 0)
            faulthandler.cancel_dump_traceback_later()
            file.write(json.dumps({"case": number, **label, **found}) + "\n")
            file.flush()


def _limit_memory() -> None:
    """Tell the package of little memory, and take the rest away where the system can."""
    from trabecula.engine import memory

    with contextlib.suppress(ImportError, OSError):
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + ROOM
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    memory._cgroup_available = lambda: FREE


def _label(what: str, seed: int, number: int) -> dict:
    """Return the names under which a case is counted."""
    if what == "files":
        import files

        reader, damage, *_ = files.choose(seed, number)
        return {"reader": reader.name, "damage": damage}
    import arguments

    return {"reader": arguments.choose(seed, number)[0], "damage": "arguments"}


def _one(what: str, seed: int, number: int, *, show: bool = False) -> dict:
    """Run a case; return its outcome and, of a failure, what it says."""
    from trabecula.errors import TrabeculaError

    module = __import__(what)
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    here = Path.cwd()
    os.chdir(folder)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            module.attempt(seed, number, folder)
    except TrabeculaError as error:
        if show:
            traceback.print_exc()
        return _judge(error)
    except BaseException as error:
        if show:
            traceback.print_exc()
        if isinstance(error, KeyboardInterrupt):
            raise
        at = traceback.extract_tb(error.__traceback__)
        where = next((one for one in reversed(at) if "src/trabecula" in one.filename), at[-1])
        place = f"{Path(where.filename).name}:{where.lineno}"
        text = " ".join(str(error).split())
        return {"outcome": type(error).__name__, "says": f"{text[:200]} ({place})"}
    else:
        return {"outcome": SOUND}
    finally:
        os.chdir(here)
        shutil.rmtree(folder, ignore_errors=True)


def _judge(error: BaseException) -> dict:
    """Return the outcome of an error of ours: one line, and not one that memory ran out."""
    text = str(error)
    if not 10 < len(text) < 2000 or "\n" in text:
        return {"outcome": "no line", "says": text[:300]}
    cause: BaseException | None = error
    while cause is not None:
        if type(cause) is MemoryError:
            return {"outcome": "memory", "says": text[:300]}
        cause = cause.__cause__ or cause.__context__
    return {"outcome": REFUSED}


def failures(found: list[dict]) -> list[str]:
    """Return a line for every case that is neither refused nor sound."""
    return [
        f"case {case['case']} ({case['reader']}, {case['damage']}): {case['outcome']}: "
        f"{case.get('says', '')}"
        for case in found
        if case["outcome"] not in (REFUSED, SOUND)
    ]


def outcomes(found: list[dict]) -> str:
    """Return the counts of all cases in a line."""
    counts = Counter(case["outcome"] for case in found)
    return ", ".join(f"{count} {outcome}" for outcome, count in counts.most_common())


def table(found: list[dict]) -> str:
    """Return the counts by reader and by damage."""
    rows = []
    for key in ("reader", "damage"):
        for name in sorted({case[key] for case in found}):
            of_it = [case for case in found if case[key] == name]
            rows.append(f"{key:8} {name:32} {len(of_it):6}  {outcomes(of_it)}")
    return "\n".join(rows)


if __name__ == "__main__":
    sys.exit(main())
