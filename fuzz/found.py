"""Packs inputs that fuzzing found into fuzz/found, which the tests replay, and unpacks them for more fuzzing.

    cargo +nightly fuzz run TARGET CORPUS
    cargo +nightly fuzz run TARGET -- -set_cover_merge=1 MERGED CORPUS
    python3 found.py pack TARGET MERGED
    python3 found.py unpack TARGET FOLDER
"""

import argparse
import gzip
import pathlib
import struct

def pack(packed, folder):
    inputs = [file.read_bytes() for file in sorted(folder.iterdir())]
    # Inputs that begin alike side by side: they compress each other.
    inputs = sorted(inputs, key=lambda data: (data[:64], len(data), data))
    raw = b"".join(struct.pack("<I", len(data)) + data for data in inputs)
    packed.write_bytes(gzip.compress(raw, 9, mtime=0))
    print(f"{packed.name}: {len(inputs)} inputs, {packed.stat().st_size} bytes")


def unpack(packed, folder):
    raw, place, count = gzip.decompress(packed.read_bytes()), 0, 0
    folder.mkdir(parents=True, exist_ok=True)
    while place < len(raw):
        (length,) = struct.unpack_from("<I", raw, place)
        (folder / f"{count:05}").write_bytes(raw[place + 4 : place + 4 + length])
        place, count = place + 4 + length, count + 1
    print(f"{folder}: {count} inputs")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=["pack", "unpack"])
    parser.add_argument("target")
    parser.add_argument("folder", type=pathlib.Path)
    args = parser.parse_args()
    packed = pathlib.Path(__file__).parent / "found" / f"{args.target}.gz"
    {"pack": pack, "unpack": unpack}[args.action](packed, args.folder)


if __name__ == "__main__":
    main()
