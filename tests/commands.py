"""The command line, run in this process: `trabecula("generate", ...)` gives what it printed."""

import io
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass

from trabecula.cli.main import main

SMALL = ("--set", "neighbourhood=4", "--set", "first_rounds=2", "--set", "rounds=[1]")
"""Settings of `texture` for which voxels do not matter, only that they are made."""


@dataclass(frozen=True)
class Output:
    """What a run printed, and its exit status."""

    status: int
    out: str
    err: str

    @property
    def lines(self) -> list[str]:
        """Return the lines on standard error, without the notice that kernels are compiled."""
        return [
            line
            for line in self.err.splitlines()
            if not line.startswith("trabecula: compiling kernels")
        ]

    @property
    def sha256(self) -> str:
        """Return the digest that generate and rerun print last."""
        word, digest = self.out.splitlines()[-1].split()
        assert word == "sha256"
        return digest


def attempt(*words: object) -> Output:
    """Run, whatever comes of it. An exception other than argparse's exit is a bug and comes out."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            status = main([str(word) for word in words])
        except SystemExit as leaving:
            status = leaving.code
    return Output(status, out.getvalue(), err.getvalue())


def trabecula(*words: object) -> Output:
    """Run, and fail where the command does."""
    output = attempt(*words)
    assert output.status == 0, output.err
    return output


def refused(*words: object) -> str:
    """Run what should be refused: exit status 2 and one line, which is given back."""
    output = attempt(*words)
    assert output.status == 2, f"exit status {output.status}: {output.out}{output.err}"
    assert len(output.lines) == 1 and output.lines[0].startswith("trabecula: "), output.err
    assert output.out == ""
    return output.lines[0].removeprefix("trabecula: ")


def contents(folder) -> dict[str, bytes]:
    """Read every file below a folder, hidden ones too."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }
