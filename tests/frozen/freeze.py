"""Write the hashes of the cases anew, and say which changed.

    python tests/frozen/freeze.py [--dry-run] [WORD ...]

Words pick the cases whose names contain one of them. Cases that need a package that is not
installed keep their hashes.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
from pathlib import Path
from time import perf_counter

HERE = Path(__file__).parent
HASHES = HERE / "hashes.json"

if __name__ == "__main__":
    sys.path.insert(0, str(HERE))
    from cases import CASES, digest

    import trabecula as tb

    parser = argparse.ArgumentParser(description="Write the hashes of the frozen cases anew.")
    parser.add_argument("words", nargs="*", metavar="WORD", help="cases whose names contain one")
    parser.add_argument("--dry-run", action="store_true", help="compare, and write nothing")
    options = parser.parse_args()
    old = json.loads(HASHES.read_text(encoding="utf-8")) if HASHES.exists() else {}
    new = {name: sha256 for name, sha256 in old.items() if name in CASES}
    changed, first = [], perf_counter()
    for name, function in CASES.items():
        if options.words and not any(word in name for word in options.words):
            continue
        start = perf_counter()
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                new[name] = digest(function())
        except tb.errors.MissingExtraError as error:
            sys.stdout.write(f"{name:36} skipped: {error}\n")
            continue
        same = new[name] == old.get(name)
        changed += [] if same else [name]
        word = "" if same else "new" if name not in old else "CHANGED"
        sys.stdout.write(f"{name:36} {new[name][:12]} {perf_counter() - start:6.2f} s {word}\n")
        sys.stdout.flush()
    sys.stdout.write(f"{len(changed)} of {len(CASES)} changed, {perf_counter() - first:.0f} s\n")
    if not options.dry_run:
        text = json.dumps(dict(sorted(new.items())), indent=1) + "\n"
        HASHES.write_text(text, encoding="utf-8")
