"""Text of a file: its encoding, and what it is instead where it is no text."""

from __future__ import annotations

import codecs
import re
from pathlib import Path

from bayesdrill.basics.errors import InputError
from bayesdrill.record.formats.table import read_bytes

_MAGIC = {
    b"PK\x03\x04": "is a spreadsheet or zip archive; export it as CSV",
    b"MATLAB": "is a MATLAB file; give it the ending .mat, or say the format: mat",
    b"\x89HDF": "is an HDF5 file; give it the ending .h5, or .mat if MATLAB wrote it",
    b"PAR1": "is a Parquet file; give it the ending .parquet, or say the format: parquet",
    b"\xd0\xcf\x11\xe0": "is a spreadsheet (.xls); export it as CSV",
    b"\x93NUMPY": "is a NumPy array; save it with numpy.savez('run.npz', t=t, w_1=w_1)",
    b"version https://git-lfs": "is a pointer of Git LFS, not the file; run git lfs pull",
    b"\x1f\x8b": "is compressed (gzip); unpack it first: gunzip, or 7-Zip",
}
_LINES_OF_TEXT = 2  # after which a file is a text, whatever follows


def decode(path: Path) -> str:
    """Read a text in UTF-8, UTF-16 or Latin-1; raises InputError for what is no table."""
    raw = read_bytes(path)
    for magic, message in _MAGIC.items():
        if raw.startswith(magic):
            raise InputError.at(str(path), message)
    try:
        if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            return raw.decode("utf-16")
        if len(raw) > 2 and not raw[1:400:2].strip(b"\0"):  # without its mark
            return raw.decode("utf-16-le")
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    _check_text(path, text)
    return text


def _check_text(path: Path, text: str) -> None:
    odd = re.search(r"[\x00-\x08\x0e-\x19\x1b-\x1f]", text)
    line = text.count("\n", 0, odd.start()) + 1 if odd else 0
    if line > _LINES_OF_TEXT:
        message = "holds bytes that are no text, as where writing was cut; remove them"
        raise InputError.at(f"{path} line {line}", message)
    if odd:
        raise InputError.at(str(path), "is a binary file, not text; export it as CSV in UTF-8")
