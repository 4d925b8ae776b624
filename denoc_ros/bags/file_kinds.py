"""Kinds of files that are no recordings, by their first bytes: what to do with each."""

from __future__ import annotations

import zipfile
from pathlib import Path

_HEAD_BYTES = 512
_KINDS = (  # first bytes of a file, what it is, and what to do with it
    (b'#ROSBAG', 'a bag of ROS 1', 'convert it (rosbags-convert --src BAG --dst FOLDER)'),
    (b'\x89MCAP0', 'an MCAP file', 'give it a name that ends in .mcap'),
    (b'SQLite format 3\0', 'an SQLite file', 'give it a name that ends in .db3'),
    (b'ULog\x01\x12\x35', 'a ULog file of PX4', 'convert it (ulog2csv FILE, of pyulog)'),
    (b'\xd0\xcf\x11\xe0', 'an old spreadsheet (.xls)', 'save it as .csv'),
    (b'PAR1', 'a Parquet file', 'save it as .csv (pandas.read_parquet, to_csv)'),
    (b'\x89HDF', 'an HDF5 file', 'save its signals as .csv or as .mat of version 7'),
    (b'\x93NUMPY', 'an array of NumPy (.npy)', 'save it as .csv (numpy.savetxt)'),
    (b'\x28\xb5\x2f\xfd', 'a file compressed by zstd', 'unpack it (zstd -d FILE)'),
    (b'\x1f\x8b', 'a compressed file', 'unpack it (gunzip FILE)'),
    (b'BZh', 'a compressed file', 'unpack it (bunzip2 FILE)'),
    (b'\xfd7zXZ', 'a compressed file', 'unpack it (unxz FILE)'),
    (b'7z\xbc\xaf', 'an archive (.7z)', 'unpack it'),
    (b'TDSm', 'a TDMS file of LabVIEW', 'save it as .lvm or .csv'),
    (b'MDF ', 'an MDF file', 'save it as .csv or as .mat of version 7'),
    (b'fLaC', 'a FLAC file', 'save its samples as .csv'),
    (b'OggS', 'an Ogg file', 'save its samples as .csv'),
    (b'%PDF', 'a PDF document', 'export the numbers as .csv'),
)
_WORKBOOK = 'xl/workbook.xml'


def other_kind(path: Path) -> str:
    """Return what a file is and what to do with it, such as `a bag of ROS 1: convert it`.

    '' for a file that no first bytes give away: text, and a workbook (.xlsx), may be a table.
    """
    with path.open('rb') as stream:
        head = stream.read(_HEAD_BYTES)
    if head[:4] in (b'RIFF', b'RF64') and head[8:12] == b'WAVE':
        return 'a sound file (.wav): save its samples as .csv and give their rate with --rate'
    if head.startswith(b'PK\x03\x04'):
        return _archive_kind(path)
    return next((f'{kind}: {what}' for start, kind, what in _KINDS if head.startswith(start)), '')


def _archive_kind(path: Path) -> str:
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, OSError):
        return 'a damaged archive (.zip)'
    if _WORKBOOK in names:
        return ''
    if names and all(name.endswith('.npy') for name in names):
        return (
            'arrays of NumPy (.npz): save them as .csv (numpy.savetxt) or .mat (scipy.io.savemat)'
        )
    if 'content.xml' in names:
        return 'an OpenDocument spreadsheet (.ods): save it as .xlsx or .csv'
    return 'a zip archive: unpack it, or save its table as .csv'
