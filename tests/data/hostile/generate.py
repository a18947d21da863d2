"""Makes the hostile files that cannot be written by hand: python tests/data/hostile/generate.py

The others beside it were written by hand. `expected.json` says what each must get.
"""

import io
import json
import math
import struct
import zipfile
from pathlib import Path

from snake_training.model import NetworkConfig, SnakeNetwork

HERE = Path(__file__).resolve().parent


# The smallest network: one channel, one block, one level.
CONFIG = NetworkConfig((2,) * 3, c_dim=1, hidden_dim=1, decoder_hidden_dim=1, resnet_blocks=1, unet_levels=1,
                       unet_base_channels=1, group_norm_groups=1)  # fmt: skip
SHAPES = {name: list(tensor.shape) for name, tensor in SnakeNetwork(CONFIG).state_dict().items()}
METADATA = {key: value for key, value in CONFIG.to_metadata().items() if key != "scatter"}  # as older files
NAME = "encoder.fc_c.weight"


def weight_file(metadata=None, header=None, values=None, rename=None):
    """The bytes of a weight file with changes.

    `metadata`: other values of metadata keys, None to leave one out; `header`: {tensor: changes of its entry};
    `values`: {tensor: its numbers}; `rename`: {tensor: another name}.
    """
    entries, data = {}, b""
    for name, shape in SHAPES.items():
        numbers = (values or {}).get(name, [0.5] * math.prod(shape))
        start = len(data)
        data += struct.pack(f"<{len(numbers)}f", *numbers)
        entry = {"dtype": "F32", "shape": shape, "data_offsets": [start, len(data)]}
        entries[(rename or {}).get(name, name)] = entry | (header or {}).get(name, {})
    metadata = {key: value for key, value in (METADATA | (metadata or {})).items() if value is not None}
    return with_header({"__metadata__": metadata} | entries, data)


def with_header(header, data):
    text = header if isinstance(header, bytes) else json.dumps(header, separators=(",", ":")).encode()
    return struct.pack("<Q", len(text)) + text + data


def options(recommended, metadata=None):
    """A weight file that recommends these options."""
    return weight_file((metadata or {}) | {"recommended_options": json.dumps(recommended)})


def weight_files():
    good = weight_file()
    length = 8 + int.from_bytes(good[:8], "little")
    return {
        "good": good,
        "empty": b"",
        "truncated_header": good[: length // 2],
        "truncated_data": good[:-2],
        "trailing_byte": good + b"\0",
        "header_length_1e18": struct.pack("<Q", 10**18) + good[8:],
        "header_not_json": with_header(b"[" * 1000, b""),
        "header_not_utf8": with_header(b'{"\xff": 1}', b""),
        "no_metadata": with_header({}, b""),
        "wrong_name": weight_file(rename={NAME: "encoder.fc_d.weight"}),
        "name_with_control_characters": weight_file(rename={NAME: "encoder\x1b[31m\n.fc_c.weight"}),
        "long_name": weight_file(rename={NAME: "n" * 3000}),
        "wrong_shape": weight_file(header={NAME: {"shape": [1]}}),
        "shape_beyond_data": weight_file(header={NAME: {"shape": [1000000, 1000000]}}),
        "shape_overflow": weight_file(header={NAME: {"shape": [2**32, 2**32]}}),
        "wrong_dtype": weight_file(header={NAME: {"dtype": "I32"}}),
        "unknown_dtype": weight_file(header={NAME: {"dtype": "F33"}}),
        "overlapping_offsets": weight_file(header={NAME: {"data_offsets": [0, 4]}}),
        "offsets_beyond_data": weight_file(header={NAME: {"data_offsets": [10**12, 10**12 + 4]}}),
        "offsets_backwards": weight_file(header={NAME: {"data_offsets": [8, 4]}}),
        "nan": weight_file(values={NAME: [float("nan")]}),
        "infinity": weight_file(values={NAME: [float("-inf")]}),
        "huge_values": weight_file(values={NAME: [3e38], "encoder.unet3d.final_conv.weight": [3e38]}),
        "format_of_another": weight_file({"format": "pt"}),
        "newer_version": weight_file({"format_version": "2"}),
        "resolution_1e9": weight_file({"resolution": "[1000000000, 1000000000, 1000000000]"}),
        "resolution_512_channels_1024": weight_file({"resolution": "[512, 512, 512]", "c_dim": "1024"}),
        "resolution_not_numbers": weight_file({"resolution": "[a\n, b, \x1b]"}),
        "channels_0": weight_file({"c_dim": "0"}),
        "channels_1e9": weight_file({"c_dim": "1000000000"}),
        "groups_0": weight_file({"group_norm_groups": "0"}),
        "padding_nan": weight_file({"padding": "nan"}),
        "z_bounds_infinite": weight_file({"z_max": "inf"}),
        "options_not_json": weight_file({"recommended_options": "{potato"}),
        "options_unknown": weight_file({"recommended_options": '{"detect": {"potatoes": 1}}'}),
        "options_out_of_range": weight_file({"recommended_options": '{"detect": {"query_resolution": 100000}}'}),
        "options_of_encoding_out_of_range": weight_file({"recommended_options": '{"encode": {"rotations": 1000000}}'}),
        "resolution_512": weight_file({"resolution": "[512, 512, 512]"}),
        "options_query_resolution_1024": options({"detect": {"query_resolution": 1024}}),
        "options_rotations_64_on_128": options({"encode": {"rotations": 64}}, {"resolution": "[128, 128, 128]"}),
        "options_rotations_in_a_cube": options({"encode": {"rotations": 2, "normalization": "unit-cube"}}),
        "options_refine_steps_10000": options({"detect": {"refine_steps": 10000}}),
        "options_steps_times_rotations": options({"encode": {"rotations": 64}, "detect": {"refine_steps": 100}}),
        "metadata_not_text": with_header({"__metadata__": {"format": 3}}, b""),
    }


def npy(shape, data, dtype="<f4"):
    header = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header) + 1) + header.encode() + b"\n" + data


def npz(arrays):
    """A compressed archive of {name: bytes}."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in arrays.items():
            archive.writestr(zipfile.ZipInfo(name + ".npy"), content, zipfile.ZIP_DEFLATED)
    return out.getvalue()


def las(num_points, records, scale=0.01, record_length=20, point_format=0, records_offset=227):
    """A LAS 1.2 file: the header, whatever it claims, and the bytes of the points."""
    header = bytearray(227)
    header[:4], header[24:26] = b"LASF", b"\x01\x02"
    struct.pack_into("<HII", header, 94, records_offset, 227, 0)
    struct.pack_into("<BHI", header, 104, point_format, record_length, num_points)
    struct.pack_into("<6d", header, 131, *[scale] * 3, *[0.0] * 3)
    return bytes(header) + records


def laz(changes=(), good="format_3.laz"):
    """A good compressed file of ours with other bytes at some offsets."""
    content = bytearray((HERE / "../io/good" / good).read_bytes())
    for offset, value in changes:
        content[offset : offset + len(value)] = value
    return bytes(content)


def cloud_files():
    stl = b"solid C:\\parts\\cube".ljust(80, b" ")
    points = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
    good_npz = npz({"points": npy("(3, 3)", points)})
    record = struct.pack("<3i", 1, 2, 3) + bytes(8)
    laszip = laz().index(b"laszip encoded") - 2 + 54
    ply = b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    nan = struct.pack("<12f", 0, 0, 0, 1, 0, 0, float("nan"), 1, 0, 0, 1, 0)
    return {
        "header_of_4e9.npy": b"\x93NUMPY\x02\x00" + struct.pack("<I", 4_000_000_000) + b"{'descr': '<f4'",
        "truncated.npz": good_npz[: len(good_npz) // 2],
        "rows_1e12.npz": npz({"points": npy("(1000000000000, 3)", points)}),
        "bomb.npz": npz({"points": npy("(1000000, 3)", bytes(12_000_000))}),
        "two_clouds.npz": npz({"a": npy("(3, 3)", points), "b": npy("(3, 3)", points)}),
        "name_with_control_characters.npz": npz({"a\x1b[31m\nb": npy("(3,)", bytes(12))}),
        "not_a.npz": b"PK\x03\x04potato",
        "binary_solid.stl": stl + struct.pack("<I", 1) + bytes(12) + points + bytes(2),
        "count_4e9.stl": b"binary".ljust(80, b" ") + struct.pack("<I", 4_000_000_000) + bytes(12) + points + bytes(2),
        "count_4e9.las": las(4_000_000_000, record),
        "truncated_header.las": las(1, record)[:100],
        "truncated.las": las(2, record),
        "scale_nan.las": las(1, record, scale=float("nan")),
        "record_of_2_bytes.las": las(1, record, record_length=2),
        "offset_beyond_file.las": las(1, b"")[:220],
        "no_compression_record.laz": las(1, record, point_format=0x80),
        "truncated.laz": laz()[:-60],
        "count_4e9.laz": laz([(107, struct.pack("<I", 4_000_000_000))]),
        "items_of_no_point.laz": laz([(laszip + 34, struct.pack("<H", 9))]),
        "chunks_of_0.laz": laz([(laszip + 12, bytes(4))]),
        # The first layer: header and table of chunks, the first point, number of points, nine sizes.
        "beyond_interval.laz": laz([(469 + 8 + 30 + 4 + 36, b"\xff" * 4 + b"U" * 14)], "format_6.laz"),
        "unpacks_to_4e9.pcd": b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 333333333\nDATA binary_compressed\n"
        + struct.pack("<II", 3, 3_999_999_996)
        + b"\xe0\xff\x00",
        "nan.ply": ply.replace(b"vertex 3", b"vertex 4") + b"property float z\nend_header\n" + nan,
    }


if __name__ == "__main__":
    for name, content in (
        {f"{name}.safetensors": file for name, file in weight_files().items()} | cloud_files()
    ).items():
        (HERE / name).write_bytes(content)
