"""Data sets as .parquet, with the metadata in the schema."""

from io import BytesIO
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from nfpde.dataset.dataset import Dataset
from nfpde.dataset.metadata import Metadata
from nfpde.dataset.recording import Recording
from nfpde.dataset.tables import read_header, recording_of_table, table_of_dataset
from nfpde.errors import BadDataset

_KEY = b"nfpde"


def read_parquet(path: Path, *, velocities: bool = True) -> Recording:
    """Read a .parquet file.

    Args:
        path: The file; columns as in a .csv, metadata as JSON under the schema's key `nfpde`.
        velocities: Whether they are read; if not, `qvel` has no columns.

    Returns:
        Its content, time steps not yet checked.

    Raises:
        BadDataset: The file cannot be read, or a column breaks a rule.
    """
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            layout = read_header(file.schema_arrow.names, velocities=velocities)
            table = file.read(columns=[*layout.texts, *layout.numbers])
            facts = (file.schema_arrow.metadata or {}).get(_KEY)
        metadata = Metadata() if facts is None else Metadata.from_json(facts.decode())
        return recording_of_table(table, layout, metadata)
    except (pa.ArrowException, OSError, UnicodeDecodeError, MemoryError) as error:
        raise BadDataset(f"the file cannot be read as Parquet ({str(error).splitlines()[0]}).") from None


def parquet_bytes(dataset: Dataset) -> bytes:
    """A data set as .parquet (see `read_parquet`), numbers unchanged bit by bit.

    Args:
        dataset: The data set.

    Returns:
        The file's content.
    """
    table = table_of_dataset(dataset).replace_schema_metadata({_KEY: dataset.metadata.to_json().encode()})
    file = BytesIO()
    pq.write_table(table, file, write_page_checksum=True)
    return file.getvalue()
