"""The scripts of the page in Node, without a browser: for tests that hold them against Python."""

import json
import shutil
import subprocess
from importlib import resources

import numpy as np

MISSING = "node was not found: install Node.js (apt-get install nodejs) to run the page's scripts"
_READ = """
const fs = require("fs"), given = JSON.parse(fs.readFileSync(process.argv[2], "utf8"));
const array = (name, kind) => {
  const { buffer, byteOffset, length } = fs.readFileSync(`${process.argv[3]}/${name}`);
  return new kind(buffer.slice(byteOffset, byteOffset + length));
};
const write = (name, values) => {
  fs.writeFileSync(`${process.argv[3]}/${name}`, Buffer.from(values.buffer));
};
"""


def find_node():
    """Return the path of Node, or None."""
    return shutil.which("node")


def run_scripts(folder, names, body, *, given=None, arrays=None):
    """Run `body` after the page's scripts of these names: it reads `given`, `array(name, kind)`,
    and writes by `write(name, values)`. Return what it prints, as JSON.
    """
    page = resources.files("trabecula.view.page")
    source = [page.joinpath(name).read_text(encoding="utf-8") for name in names]
    (folder / "run.js").write_text("\n".join([*source, _READ, body]), encoding="utf-8")
    (folder / "given.json").write_text(json.dumps(given))
    for name, values in (arrays or {}).items():
        (folder / name).write_bytes(np.ascontiguousarray(values).tobytes())
    words = [find_node(), str(folder / "run.js"), str(folder / "given.json"), str(folder)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
