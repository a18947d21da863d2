"""Packs a folder of fuzz inputs, one folder a target, into corpus.zip: python3 fuzz/pack.py FOLDER

The archive depends on names and contents alone, so packing the same inputs again gives the same bytes.
"""

import sys
import zipfile
from pathlib import Path


def pack(folder, archive):
    """Writes every file of `folder/TARGET/` to the archive as `TARGET/NAME`, in the order of their names."""
    with zipfile.ZipFile(archive, "w") as packed:
        for path in sorted(folder.glob("*/*")):
            entry = zipfile.ZipInfo(path.relative_to(folder).as_posix())
            packed.writestr(entry, path.read_bytes(), zipfile.ZIP_DEFLATED, compresslevel=9)


if __name__ == "__main__":
    pack(Path(sys.argv[1]), Path(__file__).parent / "corpus.zip")
