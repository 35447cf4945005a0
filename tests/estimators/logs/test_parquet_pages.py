"""Parquet files of every writer are read, and what their pages take is known before they are unpacked."""

from __future__ import annotations

import io

import numpy as np
import pytest
from fuzz_corpus import crafted

from estimators.logs import read_log
from estimators.logs.parquet import read_parquet
from estimators.logs.parquet_pages import pages
from offroad_env.errors import DataError

COUNT = 3000
WAYS = {
    "as pyarrow does": {},
    "the first version": {"version": "1.0"},
    "the second kind of pages": {"data_page_version": "2.0"},
    "gzip": {"compression": "gzip"},
    "bytes apart": {"use_dictionary": False, "column_encoding": {"t": "BYTE_STREAM_SPLIT"}},
    "with an index and check sums": {"write_page_index": True, "write_page_checksum": True},
    "in many groups": {"row_group_size": 100, "data_page_size": 200},
}


def stored(**way):
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    texts = [str(i % 7) for i in range(COUNT)]
    sink = io.BytesIO()
    parquet.write_table(pyarrow.table({"t": np.arange(COUNT) * 0.01, "steer": texts}), sink, **way)
    sink.seek(0)
    return sink


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
def test_what_other_programs_write_is_read(way):
    table = read_parquet(
        stored(**way), "x", lambda _, __, cells: np.array([float(cell) for cell in cells]), lambda _: False
    )
    assert np.array_equal(table.columns["t"], np.arange(COUNT) * 0.01)
    assert np.array_equal(table.columns["steer"], np.arange(COUNT) % 7)


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
def test_pages_state_all_values_and_sizes(way):
    stream = stored(**way)
    import pyarrow.parquet

    metadata = pyarrow.parquet.ParquetFile(stream).metadata
    values = 0
    for group in range(metadata.num_row_groups):
        column = metadata.row_group(group).column(0)
        start = column.dictionary_page_offset or column.data_page_offset
        found = list(pages(stream, start, start + column.total_compressed_size))
        values += sum(page.values for page in found if page.encoding >= 0)
        size = sum(page.size for page in found)
        assert 0 < column.total_uncompressed_size - size < 200 * len(found)  # the headers
    assert values == COUNT


@pytest.mark.parametrize(
    ("name", "words"), [("lies about the sizes", "pages hold more than"), ("differences", "write it plainly")]
)
def test_pages_that_would_take_gigabytes_are_refused_by_name(name, words, tmp_path):
    pytest.importorskip("pyarrow")
    (file,) = [file for file in crafted() if name in file.name]
    with pytest.raises(DataError, match=words):
        read_log(file.make(tmp_path))
