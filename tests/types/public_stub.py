"""Types of the lazy package: this script writes `src/trabecula/__init__.pyi`.

A type checker or an editor does not run the package's `__getattr__`, so the stub says with plain
imports what the tables of `__init__.py` say with strings.
"""

import ast
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[2] / "src" / "trabecula" / "__init__.py"
STUB = SOURCE.with_suffix(".pyi")
CALLABLE = {"mesh": "trabecula.mesh.surface", "view": "trabecula.view.page"}
"""Modules that can be called at run time: a type checker knows the function."""


def tables() -> tuple[dict[str, str], dict[str, str]]:
    """Read the names and the modules of the package, without importing it."""
    found = {}
    for node in ast.parse(SOURCE.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            name = node.targets[0].id
            if name in ("_NAMES", "_MODULES"):
                found[name] = ast.literal_eval(node.value)
    return found["_NAMES"], found["_MODULES"]


def stub() -> str:
    """Return the text of the stub."""
    names, modules = tables()
    homes: dict[str, list[str]] = {}
    for name, home in sorted({**names, **CALLABLE}.items()):
        homes.setdefault(home, []).append(name)
    plain = sorted(set(modules) - set(CALLABLE))
    lines = ['"""Types of the public names; written by `python tests/types/public_stub.py`."""', ""]
    lines += _import("trabecula", plain)
    for home, found in sorted(homes.items()):
        lines += _import(home, found)
    public = sorted({"__version__", *names, *modules})
    lines += ["", "__version__: str", "__all__ = [", *(f'    "{name}",' for name in public), "]"]
    return "\n".join(lines) + "\n"


def _import(home: str, names: list[str]) -> list[str]:
    # `name as name` is how a stub says that an import is public.
    return [f"from {home} import {name} as {name}" for name in names]


if __name__ == "__main__":
    STUB.write_text(stub(), encoding="utf-8")
