"""Buckets of an emulated object store."""

import logging
import os
import uuid

import pytest


@pytest.fixture(scope="session")
def service():
    """Run the emulation, and set its place in the environment as a user would."""
    from emulation import Service, forget_connections

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    made = Service()
    with pytest.MonkeyPatch.context() as patch:
        for name in [name for name in os.environ if name.startswith(("AWS_", "FSSPEC_"))]:
            patch.delenv(name)
        patch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{made.port}")
        patch.setenv("AWS_ACCESS_KEY_ID", "someone")
        patch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        patch.setenv("AWS_EC2_METADATA_DISABLED", "true")
        for name in ("AWS_CONFIG_FILE", "AWS_SHARED_CREDENTIALS_FILE"):
            patch.setenv(name, os.devnull)
        forget_connections()
        yield made
    made.stop()


@pytest.fixture
def bucket(service, tmp_path, monkeypatch):
    """Return the address of an empty bucket; the working directory is an empty folder."""
    import fsspec

    name = f"bucket-{uuid.uuid4().hex[:8]}"
    fsspec.filesystem("s3").mkdir(name)
    monkeypatch.chdir(tmp_path)
    return f"s3://{name}"


@pytest.fixture
def objects(bucket):
    """List the names of all objects in the bucket."""
    import fsspec

    def names():
        fs = fsspec.filesystem("s3", use_listings_cache=False)
        return {name.partition("/")[2] for name in fs.find(bucket)}

    return names
