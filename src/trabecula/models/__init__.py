"""Trained models that come with the package: NAME.safetensors, and NAME.md with its training data
and quality.
"""

from __future__ import annotations

from pathlib import Path

SUFFIX = ".safetensors"
_HERE = Path(__file__).parent


def shipped_models() -> dict[str, Path]:
    """Return the files of the models that come with the package, by name."""
    return {path.stem: path for path in sorted(_HERE.glob(f"*{SUFFIX}"))}


def card(name: str) -> str:
    """Return the card of a shipped model; empty where there is none."""
    path = _HERE / f"{name}.md"
    return path.read_text(encoding="utf-8") if path.exists() else ""


def summary(name: str) -> str:
    """Return the first line of text of a shipped model's card."""
    lines = [line.strip() for line in card(name).splitlines()]
    return next((line for line in lines if line and not line.startswith("#")), "")
