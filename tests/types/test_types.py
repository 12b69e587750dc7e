"""A user's type checker and editor know the public names, though they are loaded at first use."""

import importlib
import subprocess
import sys
from pathlib import Path

import public_stub
import pytest
import user_script

import trabecula as tb

HERE = Path(__file__).resolve().parent
PACKAGE = public_stub.SOURCE.parent

SIGNATURES = {
    "read": "kind: str | None",
    "method": "-> trabecula.synth.api.method.Method",
    "mesh": "-> trabecula.mesh.base.Mesh",
    "view": "-> trabecula.view.page.document.Page",
    "measure.porosity": "-> float",
    "finish.connect": "-> trabecula.core.image.Image",
    "fields.ramp": "-> trabecula.core.image.Image",
    "errors.FileError": "-> trabecula.core.errors.FileError",
}


def test_the_stub_says_what_the_tables_say():
    written = public_stub.STUB.read_text(encoding="utf-8")
    assert written == public_stub.stub(), "run python tests/types/public_stub.py"


def test_what_the_stub_imports_is_what_is_loaded():
    names, modules = public_stub.tables()
    assert {*names, *modules, "__version__"} == set(tb.__all__)
    for name, home in names.items():
        assert getattr(tb, name) is getattr(importlib.import_module(home), name)
    for name, home in modules.items():
        assert getattr(tb, name) is importlib.import_module(home)
        assert callable(getattr(tb, name)) == (name in public_stub.CALLABLE)


def test_the_types_are_installed_with_the_package():
    assert (PACKAGE / "py.typed").is_file() and public_stub.STUB.is_file()


@pytest.mark.whole
def test_a_type_checker_knows_every_type_in_a_users_script(tmp_path):
    pytest.importorskip("mypy")
    asked = "\n".join(f"reveal_type(tb.{name})" for name in SIGNATURES)
    (tmp_path / "signatures.py").write_text(f"import trabecula as tb\n\n{asked}\n")
    (tmp_path / "mypy.ini").write_text(f"[mypy]\nmypy_path = {PACKAGE.parent}\n")
    words = ["--config-file", tmp_path / "mypy.ini", "--strict", "--follow-imports", "silent"]
    files = [HERE / "user_script.py", tmp_path / "signatures.py"]
    command = [sys.executable, "-m", "mypy", *words, "--cache-dir", tmp_path, *files]
    done = subprocess.run(
        [*map(str, command)], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert done.returncode == 0, done.stdout + done.stderr
    revealed = [line for line in done.stdout.splitlines() if "Revealed type" in line]
    assert len(revealed) == len(SIGNATURES)
    for line, (name, part) in zip(revealed, SIGNATURES.items(), strict=True):
        assert part in line, f"{name}: {line}"


@pytest.mark.whole
def test_the_users_script_runs(tmp_path):
    figures = user_script.main(tmp_path)
    assert figures["porosity"] == pytest.approx(figures["exemplar"], abs=0.1)
    assert figures["field"] == pytest.approx(0.4, abs=1e-3) and figures["faces"] > 0
    assert (tmp_path / "part.html").stat().st_size > 1000
