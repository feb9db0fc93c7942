"""Put the file's name in front of an error that was found deeper down."""

from collections.abc import Iterator
from contextlib import contextmanager

from nfpde.errors import BadDataset


@contextmanager
def naming(source: object | None) -> Iterator[None]:
    """Within the block a `BadDataset` begins with `source:`, unless it does already or `source` is None.

    Args:
        source: The file, or None.
    """
    try:
        yield
    except BadDataset as error:
        if source is None or str(error).startswith(str(source)):
            raise
        raise BadDataset(f"{source}: {error}") from error.__cause__
