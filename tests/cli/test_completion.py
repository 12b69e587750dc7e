"""Scripts of completion, as a shell reads them."""

import shutil
import subprocess
import sys

import pytest

from commands import attempt, refused, trabecula
from trabecula.cli.completion import SHELLS
from trabecula.cli.main import VERBS


def complete(folder, *words):
    """Return what bash offers for the last of some words."""
    (folder / "script.bash").write_text(trabecula("completion", "bash").out)
    line = " ".join(f"'{word}'" for word in words)
    ask = (
        f"source script.bash; COMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; COMPREPLY=();"
        "$(complete -p trabecula | sed 's/.* -F \\([^ ]*\\) .*/\\1/'); "
        'printf "%s\\n" "${COMPREPLY[@]}"'
    )
    done = subprocess.run(
        ["bash", "-c", ask], cwd=folder, capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


def test_without_the_extra_it_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert "pip install 'trabecula[completion]'" in refused("completion", "bash")


def test_other_shells_are_refused():
    assert "invalid choice: 'csh'" in attempt("completion", "csh").err


@pytest.mark.parametrize("shell", SHELLS)
def test_every_verb_and_method_is_in_the_script(shell):
    pytest.importorskip("shtab")
    text = trabecula("completion", shell).out
    assert all(word in text for word in (*VERBS, "quilt", "simp", "resume"))


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not there")
def test_bash_completes(tmp_path):
    pytest.importorskip("shtab")
    assert complete(tmp_path, "trabecula", "ver") == {"verify"}
    assert complete(tmp_path, "trabecula", "generate", "--met") == {"--method"}
    assert complete(tmp_path, "trabecula", "generate", "--method", "q") == {"quilt"}
    assert complete(tmp_path, "trabecula", "field", "ra") == {"ramp", "radial"}
    (tmp_path / "scan.tif").touch()
    assert complete(tmp_path, "trabecula", "measure", "sc") >= {"scan.tif"}
