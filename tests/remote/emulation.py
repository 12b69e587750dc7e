"""A local emulation of an object store: the same protocol as the real one, over a socket of this
machine.
"""

import pytest

fsspec = pytest.importorskip("fsspec", reason="addresses need the extra remote")
pytest.importorskip("s3fs", reason="s3:// needs the extra remote")
moto = pytest.importorskip(
    "moto.server", reason="the emulation of an object store is in requirements/remote.txt"
)


class Service:
    """The emulation; what it holds outlives a stop."""

    def __init__(self):
        self.port = 0
        self.start()

    def start(self):
        """Start to listen, again at the same port."""
        self._server = moto.ThreadedMotoServer(
            ip_address="127.0.0.1", port=self.port, verbose=False
        )
        self._server.start()
        self.port = self._server.get_host_and_port()[1]

    def stop(self):
        """Stop listening."""
        self._server.stop()


def forget_connections():
    """Forget connections, which fsspec keeps with their keys and endpoint."""
    fsspec.get_filesystem_class("s3").clear_instance_cache()
