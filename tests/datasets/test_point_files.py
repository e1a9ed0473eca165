"""Point files (PCD, PLY, LAS, text): every storage, fields, times and places; damaged files are skipped."""

import io
import struct
from contextlib import suppress
from pathlib import Path

import laspy
import numpy as np
import pytest

from datasets.importers.formats import open_recording
from datasets.importers.pcd import unpack_lzf
from datasets.importers.point_text import MIN_ROWS
from messages.errors import LogError
from messages.sensors import LidarScan
from tests.datasets.folder_samples import NS
from tests.datasets.imported import reason_text, scans_of
from tests.recordings import recording

XYZ = np.round(np.random.default_rng(2).uniform(-20, 20, (40, 3)), 3).astype("<f4")
SHADE = np.arange(40, dtype="<f4")
PCD_HEAD = (
    "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z _ intensity\nSIZE 4 4 4 1 4\nTYPE F F F U F\nCOUNT 1 1 1 4 1\n"
    "WIDTH 40\nHEIGHT 1\nPOINTS 40\nDATA "
)


def read_one(path: Path, content: bytes | str) -> LidarScan:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    (scan,) = scans_of(open_recording(path))
    return scan


# --- PCD


def pcd_binary() -> bytes:
    rows = b"".join(p.tobytes() + b"\0" * 4 + s.tobytes() for p, s in zip(XYZ, SHADE, strict=True))
    return PCD_HEAD.encode() + b"binary\n" + rows


def pcd_compressed() -> bytes:
    columns = b"".join(c.tobytes() for c in XYZ.T) + b"\0" * 160 + SHADE.tobytes()
    plain = b"".join(bytes([len(columns[k : k + 32]) - 1]) + columns[k : k + 32] for k in range(0, len(columns), 32))
    return PCD_HEAD.encode() + b"binary_compressed\n" + struct.pack("<II", len(plain), len(columns)) + plain


def text_rows() -> str:
    return "\n".join(" ".join(map(str, p)) for p in XYZ)


def pcd_text() -> bytes:
    return ("FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 40\nDATA ascii\n" + text_rows()).encode()


def test_pcd_storages(tmp_path: Path) -> None:
    for content in (pcd_binary(), pcd_compressed()):
        scan = read_one(tmp_path / "odd.name", content)
        np.testing.assert_array_equal(scan.points_m, XYZ)
        assert scan.intensity.tolist() == list(range(40))
    np.testing.assert_array_equal(read_one(tmp_path / "odd.name", pcd_text()).points_m, XYZ)


def test_can_database_is_no_pcd(tmp_path: Path) -> None:
    (tmp_path / "ThinkCity.dbc").write_text('VERSION ""\n\nNS_ :\n')
    with pytest.raises(LogError, match="no known recording format"):
        open_recording(tmp_path / "ThinkCity.dbc")


def test_lzf_overlapping_references() -> None:
    assert unpack_lzf(bytes([1, 65, 66, (5 << 5) | 0, 1]), 9) == b"ABABABABA"
    assert unpack_lzf(bytes([0, 90, (7 << 5) | 0, 4, 0]), 14) == b"Z" * 14
    with pytest.raises(LogError, match="before its start"):
        unpack_lzf(bytes([0, 65, (1 << 5), 9]), 4)
    with pytest.raises(LogError, match="instead of"):
        unpack_lzf(bytes([0, 65]), 4)


def test_pcd_equals_packed_frame() -> None:
    (_, _, pcd), *_ = open_recording(recording("kitti-seq-pcd") / "frames" / "0000000000.pcd").read()
    (_, _, packed) = next(iter(open_recording(recording("kitti-seq-pcd")).read()))
    returns = packed.points_m[packed.points_m.any(axis=1)]
    assert len(pcd.points_m) == len(returns)
    assert np.abs(pcd.points_m - returns).max() <= 0.0026


# --- PLY

PLY_HEAD = "property float x\nproperty float y\nproperty float z\nproperty uchar scalar_Intensity\n"


def ply(storage: str, body: bytes, before: str = "", after: str = "", count: int = 40) -> bytes:
    head = (
        f"ply\nformat {storage} 1.0\ncomment made here\n{before}element vertex {count}\n{PLY_HEAD}{after}end_header\n"
    )
    return head.encode() + body


def ply_rows(order: str) -> bytes:
    rows = np.zeros(40, [("xyz", f"{order}f4", 3), ("i", "u1")])
    rows["xyz"], rows["i"] = XYZ, SHADE
    return rows.tobytes()


def ply_text() -> bytes:
    return "\n".join(f"{x} {y} {z} {i}" for (x, y, z), i in zip(XYZ, range(40), strict=True)).encode()


VIEW = "element view 1\nproperty double a\nproperty int b\n"
FACES = "element face 1\nproperty list uchar int vertex_indices\n"


@pytest.mark.parametrize(
    "content",
    [
        ply("ascii", ply_text() + b"\n3 0 1 2\n", after=FACES),
        ply("binary_little_endian", ply_rows("<")),
        ply("binary_big_endian", ply_rows(">") + b"\3" + b"\0" * 12, after=FACES),
        ply("binary_little_endian", b"\0" * 12 + ply_rows("<"), before=VIEW),
        ply("ascii", b"1 2\n" + ply_text(), before=VIEW),
        ply("ascii", ply_text()).replace(b"\n", b"\r\n"),
    ],
)  # fmt: skip
def test_ply_storages(tmp_path: Path, content: bytes) -> None:
    scan = read_one(tmp_path / "odd.name", content)
    np.testing.assert_allclose(scan.points_m, XYZ, atol=1e-6)
    assert scan.intensity.tolist() == list(range(40))


def test_ply_point_times(tmp_path: Path) -> None:
    fields = "".join(f"property {kind}\n" for kind in ("double x", "double y", "double z", "float t"))
    head = f"ply\nformat ascii 1.0\nelement vertex 2\n{fields}end_header\n"
    scan = read_one(tmp_path / "a", head + "1 2 3 0.0\n4 5 6 0.1\n")
    assert scan.stamp_ns == pytest.approx(NS // 10, abs=10)
    np.testing.assert_allclose(scan.point_offset_s, (-0.1, 0.0), atol=1e-7)


# --- LAS


def las(xyz: np.ndarray, time_s: np.ndarray | None, is_adjusted: bool = True) -> bytes:
    header = laspy.LasHeader(point_format=0 if time_s is None else 1, version="1.2")
    header.offsets, header.scales = np.floor(xyz.min(axis=0)), np.full(3, 0.001)
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType(int(is_adjusted))
    data = laspy.LasData(header)
    data.x, data.y, data.z = xyz.T
    data.intensity = np.arange(len(xyz)) * 257
    if time_s is not None:
        data.gps_time = time_s
    out = io.BytesIO()
    data.write(out, do_compress=False)
    return out.getvalue()


def test_las_scaled_coordinates_and_intensity(tmp_path: Path) -> None:
    scan = read_one(tmp_path / "odd.name", las(XYZ.astype(float), None))
    np.testing.assert_allclose(scan.points_m, XYZ, atol=0.001)
    assert scan.intensity.tolist() == list(range(40))
    assert scan.stamp_ns == 0


def test_las_folder_in_map_projection_with_gps_time(tmp_path: Path) -> None:
    places = np.array([500_000.0, 5_600_000.0, 100.0])
    for k in range(3):
        times = 3e8 + 0.1 * k + np.linspace(0.0, 0.09, 40)
        (tmp_path / f"scan_{k + 9}.las").write_bytes(las(XYZ + places + (k, 0.0, 0.0), times))
    source = open_recording(tmp_path)
    scans = scans_of(source)
    expected_ns = [round((1.3e9 + 0.1 * k + 0.09) * 1e9) for k in range(3)]
    assert [s.stamp_ns for s in scans] == pytest.approx(expected_ns, abs=200)
    np.testing.assert_allclose(scans[0].point_offset_s, np.linspace(-0.09, 0.0, 40), atol=1e-6)
    (note, times) = source.description.notes
    origin = np.floor(np.round(XYZ + places, 3).min(axis=0))
    assert str(origin.tolist()) in note
    assert "GPS time" in times
    for k, scan in enumerate(scans):
        np.testing.assert_allclose(scan.points_m, XYZ + places + (k, 0.0, 0.0) - origin, atol=0.001)


def test_las_of_a_survey_has_no_point_times(tmp_path: Path) -> None:
    scan = read_one(tmp_path / "a.las", las(XYZ.astype(float), np.linspace(0.0, 900.0, 40), is_adjusted=False))
    assert scan.offset_s.size == 0


def test_laz_is_read_or_refused_with_the_remedy(tmp_path: Path) -> None:
    content = bytearray(las(XYZ.astype(float), None))
    content[104] |= 0x80  # the bit of LASzip in the point format
    (tmp_path / "a.laz").write_bytes(content)
    with pytest.raises(LogError, match=r"a\.laz.*(convert it to LAS|no las scan)"):
        list(open_recording(tmp_path / "a.laz").read())


# --- Text


@pytest.mark.parametrize(
    "content",
    [
        text_rows(),
        "# made here\n\n" + text_rows(),
        "40\n" + text_rows(),
        text_rows().replace(" ", ", "),
        "x;y;z\n" + text_rows().replace(" ", ";"),
        "//X Y Z\n" + text_rows(),
        '"Points_m_XYZ:0","Points_m_XYZ:1","Points_m_XYZ:2"\n' + text_rows().replace(" ", ","),
    ],
)
def test_point_text(tmp_path: Path, content: str) -> None:
    np.testing.assert_allclose(read_one(tmp_path / "odd.name", content).points_m, XYZ, atol=1e-6)


def test_point_text_with_intensity_and_more(tmp_path: Path) -> None:
    scan = read_one(tmp_path / "a", "intensity,x,y,z,laser_id\n10,1,2,3,0\n20,4,5,6,1\n")
    assert (scan.points_m.tolist(), scan.intensity.tolist()) == ([[1, 2, 3], [4, 5, 6]], [10, 20])
    assert read_one(tmp_path / "b", "1 2 3 30\n4 5 6 40\n").intensity.tolist() == [30, 40]


@pytest.mark.parametrize(
    "content",
    ["1 2\n", "1 2 3 4 5\n", "x y z qx qy qz qw\n0 0 0 0 0 0 1\n", "a b c\n1 2 3\n", "1 2 3\n1 2\n", "7\n", "x y z\n"],
)
def test_other_tables_are_no_points(tmp_path: Path, content: str) -> None:
    (tmp_path / "a.csv").write_text(content)
    with pytest.raises(LogError, match="no known recording format"):
        open_recording(tmp_path / "a.csv")


SAMPLES = [f"{k / 100} 0.0{k % 7} -0.02 9.81 0.001 -0.002 0.003" for k in range(40)]


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        (SAMPLES, r"column 1 rises from row to row, from 0.0 to 0.39"),
        ([f"{k - 2 * (k > 20)} {k % 5} 6 65.4" for k in range(40)], "column 1 rises"),  # times that go back once
        ([f"{k % 5} {k % 7} 6 65 0.1 -2.5 9" for k in range(40)], "column 6 is no colour, from -2.5 to -2.5"),
        (
            ["timestamp,x,y,z", *(f"{10**18 + k * 10**8},{k * 0.1},4,1" for k in range(40))],
            r"in 3\.9 s of column 1",
        ),
        (
            ["x,y,z,time", *(f"{k % 7},0.2,9.8,{k / 100}" for k in range(40))],
            r"in 0\.39 s of column 4 \(time\)",
        ),
        (["# lat, lon, h", *(f"{48 + k % 3},11,{k}" for k in range(40))], "its columns are lat, lon, h"),
        ([f"{48.1 + k % 7 * 1e-6} 11.5 {500 + k}" for k in range(40)], "differ by less than 0.1 m"),
        ([f"{k % 7 * 1000} 11.5 500" for k in range(40)], r"columns 1 \(x\), .* are 2000 m from their middle"),
    ],
)
def test_table_of_what_no_lidar_measures_is_refused(tmp_path: Path, rows: list[str], reason: str) -> None:
    (tmp_path / "a.txt").write_text("\n".join(rows))
    with pytest.raises(LogError, match=rf"a\.txt: no points scan \(a table that is no point cloud: .*{reason}"):
        open_recording(tmp_path / "a.txt")
    (tmp_path / "b.txt").write_text("\n".join(rows[: MIN_ROWS - 1]))  # too few to judge
    if not rows[0][0].isalpha():
        assert len(scans_of(open_recording(tmp_path / "b.txt"))) == 1


def test_points_in_any_order_and_density_are_read(tmp_path: Path) -> None:
    far = "\n".join(f"{x + 5e5} {y + 5.7e6} {z}" for x, y, z in XYZ.tolist())  # a map projection
    timed = "x y z time\n" + "\n".join(f"{x} {y} {z} {k * 1e-4}" for k, (x, y, z) in enumerate(XYZ.tolist()))
    falling = "\n".join(f"{-k} {k % 3} 1" for k in range(40))
    for content in (far, timed, falling):
        assert len(read_one(tmp_path / "a.txt", content).points_m) == 40


# --- Folders


def test_times_of_numbered_and_other_files(tmp_path: Path) -> None:
    for folder, names, expected in (
        ("a", ("s2.pcd", "s10.pcd", "s3.pcd"), [2, 3, 10]),
        ("b", ("x.pcd", "y.pcd"), [0, 1]),
        ("c", ("1317042145051199.pcd", "1317042145151199.pcd"), [0, 1]),
        ("d", ("1.pcd", "01.pcd"), [0, 1]),
    ):
        (tmp_path / folder).mkdir()
        for name in names:
            (tmp_path / folder / name).write_bytes(pcd_text())
        source = open_recording(tmp_path / folder)
        assert [t for t, _, _ in source.read()] == [k * NS // 10 for k in expected]


def test_mixed_folder_lists_what_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "a.pcd").write_bytes(pcd_text())
    (tmp_path / "b.ply").write_bytes(ply("ascii", ply_text()))
    (tmp_path / "c.ply").write_bytes(ply("ascii", ply_text()))
    source = open_recording(tmp_path)
    assert len(scans_of(source)) == 1
    assert [(Path(i.source).name, i.count) for i in source.description.ignored] == [("*.ply", 2)]


DAMAGE = [
    (".pcd", pcd_binary()[:-1]),
    (".pcd", pcd_compressed()[:-1]),
    (".pcd", pcd_binary().replace(b" y ", b" q ", 1)),
    (".pcd", pcd_binary().replace(b"POINTS 40", b"POINTS -4")),
    (".pcd", pcd_binary().replace(b"POINTS 40", b"POINTS 99999999999999")),
    (".pcd", pcd_binary().replace(b"SIZE 4 4 4 1 4", b"SIZE 3 4 4 1 4")),
    (".pcd", pcd_binary().replace(b"SIZE 4", b"SIZE -4")),
    (".pcd", b"VERSION 0.7\n"),
    (".ply", ply("binary_little_endian", ply_rows("<")[:-1])),
    (".ply", ply("ascii", ply_text(), count=41)),
    (".ply", ply("ascii", ply_text(), count=-1)),
    (".ply", ply("binary_big_endian", ply_rows(">"), count=10**18)),
    (".ply", ply("ascii", b"\xff\xfe" * 99)),
    (".ply", ply("ascii", ply_text(), after="property list uchar int x\n")),
    (".ply", ply("ascii", ply_text(), after="property quad w\n")),
    (".ply", b"ply\nformat ascii 1.0\nend_header\n"),
    (".ply", b"ply\nproperty float x\nend_header\n"),
    (".las", las(XYZ.astype(float), None)[:-1]),
    (".las", las(XYZ.astype(float), None)[:150]),
    (".las", b"LASF" + b"\xff" * 400),
    (".las", b"LASF"),
    (".xyz", text_rows() + "\n1 2"),
    (".xyz", text_rows() + "\n1 2 x"),
    (".xyz", text_rows().encode() + b"\n1 2 \xff"),
    (".xyz", b""),
]
GOOD = {".pcd": pcd_binary(), ".ply": ply("binary_little_endian", ply_rows("<")), ".las": las(XYZ.astype(float), None),
        ".xyz": text_rows().encode()}  # fmt: skip


@pytest.mark.parametrize(("suffix", "content"), DAMAGE)
def test_damaged_file_in_folder_is_skipped(tmp_path: Path, suffix: str, content: bytes | str) -> None:
    for k in range(3):
        (tmp_path / f"{k}{suffix}").write_bytes(GOOD[suffix])
    (tmp_path / f"1{suffix}").write_bytes(content if isinstance(content, bytes) else content.encode())
    source = open_recording(tmp_path)
    assert [t for t, _, _ in source.read()] == [0, 2 * NS // 10]
    assert f"1{suffix}: no " in reason_text(source)
    assert sum(row.skipped or 0 for row in source.table()) == 1


@pytest.mark.parametrize("suffix", GOOD)
def test_any_damage_ends_without_traceback(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(7)
    path = tmp_path / f"a{suffix}"
    for k in range(150):
        content = bytearray(GOOD[suffix])
        for _ in range(rng.integers(1, 5)):
            content[rng.integers(len(content) if k % 2 else min(len(content), 300))] = rng.integers(256)
        path.write_bytes(content[: rng.integers(1, len(content)) if k % 3 == 0 else None])
        with suppress(LogError):
            list(open_recording(path).read())
