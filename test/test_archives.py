"""Archives and tables that declare less than they hold, or more than the memory has."""

from __future__ import annotations

import bz2
import struct
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path

import numpy as np
import openpyxl
import pytest
from peak_memory import peak_memory

from denoc_ros.decompression import require_bounded_archive
from denoc_ros.errors import BagError, ModelError
from denoc_ros.identification.tables.tables import read_table
from denoc_ros.model.beams import link_file
from denoc_ros.reduction.formats.matrices import read_matrices

HUGE = 1 << 30  # bytes
MEMORY_RISE = 400_000  # KiB, less than half of HUGE


def lying_archive(
    path: Path, name: str, content: bytes, claim: int, zeros: int = 0, bz2_packed: bool = False
) -> Path:
    """Write an archive whose entry holds some content and zeros, and claims a smaller size."""
    packer = bz2.BZ2Compressor() if bz2_packed else zlib.compressobj(1, zlib.DEFLATED, -15)
    packed = packer.compress(content)
    for _ in range(zeros >> 20):
        packed += packer.compress(bytes(1 << 20))
    packed += packer.flush()
    crc = zlib.crc32((content + bytes(claim))[:claim])
    sizes = struct.pack('<3I2H', crc, len(packed), claim, len(name), 0)
    kind = zipfile.ZIP_BZIP2 if bz2_packed else zipfile.ZIP_DEFLATED
    local = b'PK\x03\x04' + struct.pack('<5H', 46, 0, kind, 0, 33) + sizes + name.encode()
    central = b'PK\x01\x02' + struct.pack('<6H', 46, 46, 0, kind, 0, 33) + sizes
    central += struct.pack('<3H2I', 0, 0, 0, 0, 0) + name.encode()
    end = struct.pack('<4H2IH', 0, 0, 1, 1, len(central), len(local) + len(packed), 0)
    path.write_bytes(local + packed + central + b'PK\x05\x06' + end)
    return path


def npy(array: np.ndarray) -> bytes:
    """Return the bytes of an array's file."""
    header = {'descr': array.dtype.str, 'fortran_order': False, 'shape': array.shape}
    text = (repr(header) + '\n').encode()
    return b'\x93NUMPY\x01\x00' + struct.pack('<H', len(text)) + text + array.tobytes()


def test_the_content_counts_and_not_the_declared_size(tmp_path: Path) -> None:
    path = tmp_path / 'a.zip'
    for kind in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        with zipfile.ZipFile(path, 'w', kind) as archive:
            for name in 'ab':
                archive.writestr(name, bytes(range(256)) * 4096)
        require_bounded_archive(path, 2 << 20)
        with pytest.raises(ValueError, match='at most 1 MiB, got more'):
            require_bounded_archive(path, (2 << 20) - 1)
    lying_archive(path, 'a', bytes(1000), 999)
    with pytest.raises(ValueError, match=r"entry 'a' must hold the 999 bytes .* got 1000"):
        require_bounded_archive(path, 1 << 20)
    for other in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        with zipfile.ZipFile(path, 'w', other) as archive:
            archive.writestr('a', b'a')
        with pytest.raises(ValueError, match='must be stored or deflated'):
            require_bounded_archive(path, 1 << 20)


def read_archive(reader: str, path: Path) -> None:
    """Read an archive by one of its readers."""
    if reader == 'spreadsheet':
        read_table(path)
    elif reader == 'link':
        link_file.read(path)
    else:
        read_matrices(path, None, None)


@pytest.mark.parametrize('reader', ['spreadsheet', 'link', 'matrices'])
def test_an_archive_that_lies_does_not_fill_the_memory(tmp_path: Path, reader: str) -> None:
    """Readers unpack up to 2 GiB of an entry at once, and cut it off at the declared size."""
    stiffness = npy(np.eye(3))
    if reader == 'spreadsheet':
        path = lying_archive(tmp_path / 'a.xlsx', '[Content_Types].xml', b'<a/>', 4, HUGE)
        with zipfile.ZipFile(path, 'a') as archive:
            archive.writestr('xl/workbook.xml', '<a/>')
    else:
        held = len(stiffness)
        path = lying_archive(tmp_path / 'a.npz', 'stiffness.npy', stiffness, held, HUGE, True)
    assert path.stat().st_size < HUGE / 100
    before = peak_memory()
    with pytest.raises((BagError, ModelError), match='must'):
        read_archive(reader, path)
    assert peak_memory() - before < MEMORY_RISE


def test_a_cell_far_away_does_not_fill_the_memory(tmp_path: Path) -> None:
    """Empty cells up to it, and up to the declared size of the sheet, were made."""
    path = tmp_path / 'far.xlsx'
    book = openpyxl.Workbook(write_only=True)
    sheet = book.create_sheet()
    for row in (['t', 'y'], [0.0, 1.0], [1.0, 2.0], [2.0, 3.0]):
        sheet.append(row)
    book.save(path)
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    name = next(name for name in parts if 'worksheets/' in name)
    declared = parts[name].replace(
        b'<sheetData>', b'<dimension ref="A1:XFD1048576"/><sheetData>', 1
    )
    far = '<row r="{0}"><c r="XFD{0}"><v>1</v></c></row>'
    rows = ''.join(far.format(k) for k in range(5, 5000)).encode()
    for text, holds in (
        (declared, True),
        (parts[name].replace(b'</sheetData>', rows + b'</sheetData>'), False),
    ):
        with zipfile.ZipFile(path, 'w', zipfile.ZIP_DEFLATED) as archive:
            for each, content in parts.items():
                archive.writestr(each, text if each == name else content)
        if holds:
            np.testing.assert_array_equal(read_table(path)['y'], [1.0, 2.0, 3.0])
        else:
            with pytest.raises(BagError, match=r'must unpack to at most .* cells'):
                read_table(path)


CELLS = """
import struct, sys, resource
from pathlib import Path
from denoc_ros.identification.tables.tables import read_table
from denoc_ros.errors import BagError
def element(kind, data):
    return struct.pack('<2I', kind, len(data)) + data + bytes(-len(data) % 8)
dimensions = element(5, struct.pack('<2i', 4 * 10**8, 1))
cell = element(14, element(6, struct.pack('<2I', 1, 0)) + dimensions + element(1, b'a'))
path = Path(sys.argv[1])
path.write_bytes(b'MATLAB 5.0 MAT-file'.ljust(116) + bytes(8) + b'\\0\\1IM' + cell)
try:
    read_table(path)
except BagError as error:
    print(error)
peak = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, -1))
assert peak < 1_500_000, peak
"""


def test_a_matlab_file_that_declares_many_cells_does_not_fill_the_memory(tmp_path: Path) -> None:
    """A file of 192 bytes took 3.2 GB for its 4e8 cells, and may declare five times as many."""
    ended = subprocess.run(
        [sys.executable, '-c', CELLS, str(tmp_path / 'a.mat')],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert 'a.mat: table must be readable, got:' in ended.stdout
