"""What an import costs: counted in modules, since seconds depend on the machine. Each runs in a
fresh interpreter.
"""

import subprocess
import sys

import pytest

HEAVY = (
    "numba",
    "zarr",
    "PIL",
    "tifffile",
    "nibabel",
    "nrrd",
    "scipy",
    "torch",
    "filelock",
    "psutil",
)


def modules_after(code, watched):
    """List which of `watched` a fresh interpreter has loaded after `code`."""
    script = (
        f"{code}\nimport sys\n"
        f"sys.stderr.write(' '.join(name for name in {watched!r} if name in sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    return done.stderr.split()


def command(words):
    """Return code that runs a command line."""
    run = f"try:\n    main({words!r})\nexcept SystemExit:\n    pass"
    return f"from trabecula.cli.main import main\n{run}"


def test_importing_the_package_loads_nothing():
    assert modules_after("import trabecula", ("numpy", *HEAVY)) == []


@pytest.mark.whole
def test_every_public_name_is_there():
    assert modules_after(
        "import trabecula as tb\nfor name in tb.__all__: getattr(tb, name)",
        ("trabecula.pipeline.outputs",),
    ) == ["trabecula.pipeline.outputs"]


def test_the_nouns_need_numpy_alone():
    assert (
        modules_after(
            "import trabecula as tb; tb.Image([[0, 1]], 'labels'); tb.Recipe(); tb.Request(3)",
            HEAVY,
        )
        == []
    )


@pytest.mark.parametrize("words", [["--help"], [], ["--version"], ["generat"], ["--bogus"]])
def test_help_and_typing_errors_need_no_numpy(words):
    assert not {"numpy", *HEAVY} & set(modules_after(command(words), ("numpy", *HEAVY)))


@pytest.mark.parametrize(
    "verb",
    [
        "generate",
        "verify",
        "export",
        "render",
        "measure",
        "rerun",
        "demo",
        "plan",
        "field",
    ],
)
def test_help_of_a_verb_loads_nothing_heavy(verb):
    # The options of `finish` stand in the table of operations, beside their functions.
    assert modules_after(command([verb, "--help"]), ("numpy", *HEAVY)) == []


def test_the_public_names_are_those_of_the_plan():
    import trabecula as tb

    assert {
        "read",
        "write",
        "segment",
        "samples",
        "method",
        "describe",
        "verify",
        "export",
        "render",
    } <= set(dir(tb))
    assert callable(tb.finish.connect) and callable(tb.measure.porosity) and callable(tb.mesh)
    assert issubclass(tb.errors.TrabeculaError, Exception)
    with pytest.raises(AttributeError, match="has no attribute 'raed'"):
        tb.raed  # noqa: B018


def test_the_command_line_runs_without_its_script():
    done = subprocess.run(
        [sys.executable, "-m", "trabecula", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("trabecula ")
