"""Tables of a study as files: CSV for everybody, Parquet with the types of columns."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scso_nlp.exceptions import ScsoError
from scso_nlp.files import write_whole
from scso_nlp.messages import COUNTS

if TYPE_CHECKING:
    import pandas as pd


def pandas() -> Any:
    """Import pandas with what writes Parquet.

    Returns
    -------
    module

    Raises
    ------
    ScsoError
        They are not installed.
    """
    try:
        import pandas as pd
        import pyarrow  # noqa: F401
    except ImportError:
        raise ScsoError(
            "tables of studies need pandas and pyarrow, which are not installed: pip install "
            "'scso_nlp[studies]'"
        ) from None
    return pd


def write_frames(tables: Mapping[str, pd.DataFrame], folder: Path) -> tuple[Path, ...]:
    """Write data frames, each as CSV and as Parquet, each file whole or not at all.

    Parameters
    ----------
    tables : mapping of str to DataFrame
        By the name of their files.
    folder : Path
        Exists.

    Returns
    -------
    tuple of Path
        The files.

    Raises
    ------
    DataError
        A file cannot be written.
    """
    from pyarrow import Table, csv, parquet

    files = []
    for name, frame in tables.items():
        table = Table.from_pandas(frame, preserve_index=False)
        for ending, write in (("csv", csv.write_csv), ("parquet", parquet.write_table)):
            files.append(folder / f"{name}.{ending}")
            COUNTS.info("writing %s", files[-1].name)
            with write_whole(files[-1]) as temporary:
                write(table, str(temporary))
    return tuple(files)
