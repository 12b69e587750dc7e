"""The steps of `docs/build.py`."""
