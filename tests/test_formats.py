"""Foreign formats: files written by other programs come in as they are, and a bad file is refused
with one message.
"""

import json
import struct
import sys
import zipfile

import h5py
import nptdms
import numpy as np
import pyarrow as pa
import pytest
from mcap.writer import IndexType
from mcap.writer import Writer as McapWriter
from pyarrow import parquet
from pyulog import ULog
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore
from scipy import io

from tiltcal.cli import main
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.foreign_files import import_file, import_recording
from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.registry import read_raw
from tiltcal.recordings.mapping import FileLayout, parse_mapping
from tiltcal.recordings.proposal.propose import propose_mapping

N, RATE = 400, 100.0
TIME = np.arange(N) / RATE
RNG = np.random.default_rng(17)
FORCE = np.tile([0.3, -0.2, 9.79], (N, 1)) + RNG.normal(0, 0.01, (N, 3))
GYRO = RNG.normal(0, 0.002, (N, 3)) + np.array([0.01, 0.0, -0.01])
NS = 1_777_900_000_000_000_000 + np.round(TIME * 1e9).astype(np.int64)


def proposed(path, **answers):
    """The recording that the proposed mapping makes, with the answers to its open questions."""
    text = propose_mapping(path).toml()
    for old, new in answers.items():
        text = text.replace(f"{old}_?", f"{old}_{new}")
    return import_recording(path, parse_mapping(text, "proposal"))


def assert_same_motion(recording, force=FORCE, gyro=GYRO, rtol=1e-12):
    np.testing.assert_allclose(np.diff(recording.time), np.diff(TIME), atol=1e-9)
    for k, axis in enumerate("xyz"):
        np.testing.assert_allclose(
            recording.column(f"accel_{axis}_m_s2"), force[:, k], rtol=rtol, atol=rtol
        )
        np.testing.assert_allclose(
            recording.column(f"gyro_{axis}_rad_s"), gyro[:, k], rtol=rtol, atol=rtol
        )


# --------------------------------------------------------------------------------------------------
# ---- archives and tables


def test_numpy_archives_of_vectors_and_matrices(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", t=TIME, acc=FORCE, gyro=GYRO, serial=np.array("A7"))
    found = proposed(tmp_path / "a.npz", gyro_x="rad_s", gyro_y="rad_s", gyro_z="rad_s")
    assert_same_motion(found)


def test_matlab_5_by_scipy(tmp_path):
    imu = {"acc": FORCE, "gyro": GYRO, "unit": "SI"}
    io.savemat(tmp_path / "a.mat", {"log": {"time": TIME[:, None], "imu": imu}, "rate": 100.0})
    names = read_raw(tmp_path / "a.mat", FileLayout()).table("").names
    assert names[:2] == ["log.time", "log.imu.acc_1"]
    found = proposed(tmp_path / "a.mat", gyro_x="rad_s", gyro_y="rad_s", gyro_z="rad_s")
    assert_same_motion(found)


def hdf5(path, transposed):
    with h5py.File(path, "w", userblock_size=512 if transposed else 0) as file:
        imu = file.create_group("imu")
        for name, values, unit in (("acc", FORCE, "m/s^2"), ("gyro", GYRO, "rad/s")):
            imu[name] = values.T if transposed else values
            imu[name].attrs["units"] = unit
            if transposed:
                imu[name].attrs["MATLAB_class"] = np.bytes_("double")
        file["time"] = TIME[None, :] if transposed else TIME
        file["comment"] = "turned by hand"
    if transposed:
        with path.open("r+b") as raw:
            raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return path


@pytest.mark.parametrize("transposed", [False, True], ids=["HDF5", "MATLAB 7.3"])
def test_hdf5_and_matlab_7_3_by_h5py(transposed, tmp_path):
    path = hdf5(tmp_path / ("a.mat" if transposed else "a.h5"), transposed)
    assert_same_motion(proposed(path))


def test_two_rates_in_one_hdf5_file_keep_their_own_times(tmp_path):
    slow = np.arange(0, N, 10)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["imu/time"], file["imu/acc"] = TIME, FORCE
        file["table/time"], file["table/outer_deg"] = TIME[slow], slow * 0.5
    found = proposed(tmp_path / "a.h5")
    outer = found.column("table_outer_deg")
    np.testing.assert_allclose(found.time, TIME, atol=1e-12)
    np.testing.assert_array_equal(np.flatnonzero(~np.isnan(outer)), slow)
    np.testing.assert_array_equal(outer[slow], slow * 0.5)


def test_parquet_by_pyarrow(tmp_path):
    table = pa.table({
        "stamp": pa.array(NS, pa.timestamp("ns")),
        **{f"acc_{a}": FORCE[:, k] for k, a in enumerate("xyz")},
        **{f"gyr_{a} [rad/s]": GYRO[:, k] for k, a in enumerate("xyz")},
        "note": ["a"] * N,
        "list": [[1, 2]] * N,
    })  # fmt: skip
    parquet.write_table(table, tmp_path / "a.parquet")
    assert_same_motion(proposed(tmp_path / "a.parquet"))


# --------------------------------------------------------------------------------------------------
# ---- robots and drones


def imu_message(store, k):
    types = store.types
    point = types["geometry_msgs/msg/Vector3"]
    header = types["std_msgs/msg/Header"]
    stamp = types["builtin_interfaces/msg/Time"](
        sec=int(NS[k] // 10**9), nanosec=int(NS[k] % 10**9)
    )
    more = {"seq": k} if "seq" in header.__dataclass_fields__ else {}
    nine = np.zeros(9)
    return types["sensor_msgs/msg/Imu"](
        header=header(stamp=stamp, frame_id="imu", **more),
        orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=nine,
        angular_velocity=point(*GYRO[k]),
        angular_velocity_covariance=nine,
        linear_acceleration=point(*FORCE[k]),
        linear_acceleration_covariance=nine,
    )


def ros1_bag(path):
    store = get_typestore(Stores.ROS1_NOETIC)
    with rosbag1.Writer(path) as writer:
        topic = writer.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=store)
        for k in range(N):
            raw = store.serialize_ros1(imu_message(store, k), "sensor_msgs/msg/Imu")
            writer.write(topic, int(NS[k]) + 12345 * (k % 7), raw)
    return path


def ros2_bag(path, plugin):
    store = get_typestore(Stores.ROS2_HUMBLE)
    with rosbag2.Writer(path, version=9, storage_plugin=plugin) as writer:
        topic = writer.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=store)
        for k in range(N):
            raw = store.serialize_cdr(imu_message(store, k), "sensor_msgs/msg/Imu")
            writer.write(topic, int(NS[k]) + 12345 * (k % 7), raw)
    return path


def test_ros_1_bags_by_rosbags(tmp_path):
    assert_same_motion(proposed(ros1_bag(tmp_path / "a.bag")))


@pytest.mark.parametrize("plugin", list(rosbag2.StoragePlugin), ids=lambda p: p.name)
def test_ros_2_bags_by_rosbags_as_folder_and_as_file(plugin, tmp_path):
    folder = ros2_bag(tmp_path / "bag", plugin)
    assert_same_motion(proposed(folder))
    (inside,) = [p for p in folder.iterdir() if p.suffix != ".yaml"]
    assert_same_motion(proposed(inside))


def test_mcap_of_json_by_its_own_library(tmp_path):
    with (tmp_path / "a.mcap").open("wb") as out:
        writer = McapWriter(out)
        writer.start()
        kind = writer.register_schema("imu", "jsonschema", b"{}")
        topic = writer.register_channel("/imu", "json", kind)
        for k in range(N):
            fields = {"acc": dict(zip("xyz", FORCE[k], strict=True)),
                      "gyro": dict(zip("xyz", GYRO[k], strict=True))}  # fmt: skip
            writer.add_message(topic, int(NS[k]), json.dumps(fields).encode(), int(NS[k]))
        writer.finish()
    found = proposed(tmp_path / "a.mcap", gyro_x="rad_s", gyro_y="rad_s", gyro_z="rad_s")
    assert_same_motion(found)


def ulog_bytes():
    """A ULog of two topics, as the format's description has it."""

    def message(kind, body):
        return struct.pack("<HB", len(body), ord(kind)) + body

    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000)]
    for name, temperature in (("sensor_accel", "float temperature;"), ("sensor_gyro", "")):
        text = f"{name}:uint64_t timestamp;float x;float y;float z;{temperature}"
        parts.append(message("F", text.encode()))
    for k, name in enumerate((b"sensor_accel", b"sensor_gyro")):
        parts.append(message("A", struct.pack("<BH", 0, k) + name))
    for k in range(N):
        stamp = 1000 + round(TIME[k] * 1e6)
        parts.append(message("D", struct.pack("<HQ4f", 0, stamp, *FORCE[k], 41.5)))
        parts.append(message("D", struct.pack("<HQ3f", 1, stamp, *GYRO[k])))
    return b"".join(parts)


def test_ulog_by_pyulog(tmp_path):
    (tmp_path / "raw.ulg").write_bytes(ulog_bytes())
    ULog(str(tmp_path / "raw.ulg")).write_ulog(str(tmp_path / "a.ulg"))
    found = proposed(tmp_path / "a.ulg")
    assert_same_motion(found, rtol=1e-6)
    assert found.column("temperature_degC")[0] == 41.5


def test_tdms_by_nptdms(tmp_path):
    wave = {"wf_increment": 1 / RATE, "wf_start_offset": 0.0}
    channels = [
        nptdms.ChannelObject("run", f"{name} {axis}", values[:, k], wave | {"unit_string": unit})
        for name, values, unit in (("Accel", FORCE, "m/s^2"), ("Gyro", GYRO, "rad/s"))
        for k, axis in enumerate("XYZ")
    ]
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment(channels)
    assert_same_motion(proposed(tmp_path / "a.tdms"))


def test_xsens_text(tmp_path):
    ticks = (4_294_960_000 + np.round(TIME * 1e4).astype(np.int64)) % 2**32
    head = ["// General information:", "//  MT Manager version: 2020.0", "// Update Rate: 100.0Hz"]
    names = ["PacketCounter", "SampleTimeFine", *(f"Acc_{a}" for a in "XYZ"),
             *(f"Gyr_{a}" for a in "XYZ")]  # fmt: skip
    rows = [
        "\t".join([str(k % 65536), str(ticks[k]), *(f"{v:.9f}" for v in (*FORCE[k], *GYRO[k]))])
        for k in range(N)
    ]
    (tmp_path / "a.txt").write_text("\n".join([*head, "\t".join(names), *rows]) + "\n")
    text = propose_mapping(tmp_path / "a.txt").toml().replace("_?", "_rad_s")
    mapping = parse_mapping('repair = ["unwrap_time"]\n' + text, "proposal")
    imported = import_file(tmp_path / "a.txt", mapping)
    assert [f.kind for f in imported.findings] == ["time_wrap"]
    assert_same_motion(imported.recording, rtol=1e-8)
    assert "1 wraps of 429496.73 s" in imported.recording.metadata["repairs"]


# --------------------------------------------------------------------------------------------------
# ---- what cannot be read


def tdms(path):
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject("g", "Accel X", FORCE[:, 0])])


MADE = {
    "a.npz": lambda p: np.savez(p, t=TIME, acc=FORCE),
    "a.mat": lambda p: io.savemat(p, {"t": TIME, "acc": FORCE}, do_compression=True),
    "a.h5": lambda p: hdf5(p, transposed=False),
    "a.parquet": lambda p: parquet.write_table(pa.table({"t": TIME, "ax": FORCE[:, 0]}), p),
    "a.bag": ros1_bag,
    "a.ulg": lambda p: p.write_bytes(ulog_bytes()),
    "a.tdms": tdms,
}  # fmt: skip
MAP = '[time]\nrate_hz = 100\n[[column]]\nfrom = "x"\nto = "a_x_g"\n'


@pytest.mark.parametrize("name", MADE)
@pytest.mark.parametrize("damage", ["cut", "noise", "header only", "another format"])
def test_a_damaged_file_is_refused_with_one_message(name, damage, tmp_path, capfd):
    path = tmp_path / name
    MADE[name](path)
    whole = path.read_bytes()
    spoilt = {
        "cut": whole[: len(whole) // 2],
        "noise": whole[:40] + np.random.default_rng(1).bytes(3000),
        "header only": whole[:16],
        "another format": b"just,some\n1,2\n",
    }[damage]
    path.write_bytes(spoilt)
    (tmp_path / "map.toml").write_text(MAP)
    for words in (["--propose"], ["--map", str(tmp_path / "map.toml"), "-o", "never.csv"]):
        status = main(["import", str(path), *words])
        if (name, damage, words) == ("a.ulg", "cut", ["--propose"]):
            assert status == 0  # a log that lost its end, as after a crash, is read so far
            continue
        assert status == 2
        lines = [x for x in capfd.readouterr().err.splitlines() if x.startswith("tiltcal:")]
        assert len(lines) == 1
        assert all(word in lines[0] for word in ("found", "need", ";"))


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv.gz", b"\x1f\x8b\x08\x00rest", "compressed by gzip"),
        ("a.bin", bytes(4096), "a binary file of no format that is known"),
        ("a.txt", b"", "no table of numbers"),
        ("a.txt", b"only words\nand more words\n", "no table of numbers"),
    ],
)
def test_what_is_no_log_is_named(name, content, words, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(TiltcalError, match=words):
        propose_mapping(tmp_path / name)


@pytest.mark.parametrize("indexed", [True, False])
def test_an_mcap_file_that_expands_is_refused(indexed, tmp_path):
    kinds = IndexType.ALL if indexed else IndexType.NONE
    with (tmp_path / "a.mcap").open("wb") as out:
        writer = McapWriter(out, chunk_size=1 << 22, index_types=kinds, use_statistics=indexed)
        writer.start()
        topic = writer.register_channel("/imu", "json", writer.register_schema("a", "", b""))
        for k in range(3):
            writer.add_message(topic, k, b" " * 5_000_000 + b"{}", k)
        writer.finish()
    assert (tmp_path / "a.mcap").stat().st_size < 100_000
    with pytest.raises(TiltcalError, match=r"found 0\.015 GB of values, need at most 0\.01 GB"):
        read_raw(tmp_path / "a.mcap", FileLayout(), ReadBudget(0.01))


@pytest.mark.parametrize("name", ["a.npz", "a.mat", "a.h5", "a.parquet", "a.bag", "a.tdms"])
def test_more_than_the_budget_is_refused_before_it_is_read(name, tmp_path):
    MADE[name](tmp_path / name)
    with pytest.raises(TiltcalError, match=r"need at most 1e-06 GB; .* --memory-gb"):
        read_raw(tmp_path / name, FileLayout(), ReadBudget(1e-6))


def test_an_archive_that_states_more_than_it_holds_is_refused(tmp_path):
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"
    head = head.ljust(117) + b"\n"
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        body = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + bytes(64)
        archive.writestr("t.npy", body)
    with pytest.raises(TiltcalError, match=r"a shape of \(1000000000000,\) in \d+ bytes"):
        read_raw(tmp_path / "a.npz", FileLayout())


def test_a_small_file_that_expands_is_refused(tmp_path):
    table = pa.table({"t": np.zeros(3_000_000), "ax": np.zeros(3_000_000)})
    parquet.write_table(table, tmp_path / "a.parquet")
    assert (tmp_path / "a.parquet").stat().st_size < 100_000
    with pytest.raises(TiltcalError, match=r"found 0\.048 GB of values, need at most 0\.01 GB"):
        read_raw(tmp_path / "a.parquet", FileLayout(), ReadBudget(0.01))


@pytest.mark.parametrize(
    ("name", "module", "extra"),
    [
        ("a.h5", "h5py", "hdf5"),
        ("a.bag", "rosbags.highlevel", "ros"),
        ("a.ulg", "pyulog", "ulog"),
        ("a.tdms", "nptdms", "tdms"),
    ],
)
def test_a_missing_library_is_named_with_its_extra(name, module, extra, tmp_path, monkeypatch):
    MADE[name](tmp_path / name)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(TiltcalError, match=rf'pip install "tiltcal\[{extra}\]"'):
        read_raw(tmp_path / name, FileLayout())


def test_objects_of_matlab_are_refused_with_the_way_out(tmp_path):
    with h5py.File(tmp_path / "a.mat", "w") as file:
        item = file.create_dataset("TT", data=np.array([[3707764736, 2, 1, 1, 1, 1]], np.uint32))
        item.attrs["MATLAB_class"] = np.bytes_("timetable")
    with pytest.raises(TiltcalError, match="table2struct"):
        read_raw(tmp_path / "a.mat", FileLayout())


# --------------------------------------------------------------------------------------------------
# ---- faults of the data, and repairs


def faulty():
    t, force = TIME.copy(), FORCE.copy()
    t[100:] += 0.5  # a gap
    t[200] = t[199]  # repeated
    t[300:310] -= 1.0  # back
    force[50:90, 0] = force[50, 0]  # frozen
    force[:, 1] = 0.25  # dead
    force[120:130, 2] = np.nan
    force[350:360, 2] = force[:, 2][~np.isnan(force[:, 2])].max() + 1  # clipped
    angle = (np.arange(N) * 5.0) % 360
    return t, force, angle


def imported_with(tmp_path, *repairs):
    t, force, angle = faulty()
    np.savez(tmp_path / "a.npz", t=t, force=force, angle=angle)
    columns = "".join(
        f'[[column]]\nfrom = "{a}"\nto = "{b}"\n'
        for a, b in (
            *((f"force_{k + 1}", f"accel_{x}_m_s2") for k, x in enumerate("xyz")),
            ("angle", "table_outer_deg"),
        )
    )
    text = f'repair = {list(repairs)}\n[time]\ncolumn = "t"\n{columns}'
    return import_file(tmp_path / "a.npz", parse_mapping(text, "m"))


def test_faults_are_found_with_their_places(tmp_path):
    imported = imported_with(tmp_path)
    found = {(f.kind, f.column): (f.count, f.rows[0] + 1) for f in imported.findings}
    assert found == {
        ("time_back", "time_s"): (1, 301),
        ("time_repeated", "time_s"): (1, 201),
        ("gap", "time_s"): (2, 101),
        ("frozen", "accel_x_m_s2"): (39, 52),
        ("dead", "accel_y_m_s2"): (N, 2),
        ("missing", "accel_z_m_s2"): (10, 121),
        ("clipped", "accel_z_m_s2"): (10, 351),
        ("wrap", "table_outer_deg"): (5, 73),
    }
    assert imported.repairs == []
    assert len(imported.recording) == N


def test_a_channel_at_a_slower_rate_is_no_fault(tmp_path):
    slow = np.where(np.arange(N) % 10, np.nan, 20 + np.arange(N) / 100)
    np.savez(tmp_path / "a.npz", t=TIME, temperature=slow)
    text = '[time]\ncolumn = "t"\n[[column]]\nfrom = "temperature"\nto = "temperature_degC"\n'
    assert import_file(tmp_path / "a.npz", parse_mapping(text, "m")).findings == []


def test_sound_data_have_no_findings(tmp_path):
    np.savez(tmp_path / "a.npz", t=TIME, acc=np.round(FORCE, 2), gyro=np.round(GYRO, 3))
    text = propose_mapping(tmp_path / "a.npz").toml().replace("_?", "_rad_s")
    assert import_file(tmp_path / "a.npz", parse_mapping(text, "m")).findings == []


def test_repairs_are_made_on_request_and_stand_in_the_metadata(tmp_path):
    wanted = ("sort_time", "drop_repeated_time", "unwrap_angles", "empty_frozen", "empty_clipped")
    imported = imported_with(tmp_path, *wanted)
    recording = imported.recording.require_increasing()
    assert np.isnan(recording.column("accel_x_m_s2")).sum() == 39
    assert np.isnan(recording.column("accel_z_m_s2")).sum() == 20
    said = recording.metadata["repairs"]
    assert all(f"{name}: " in said for name in wanted)
    assert {f.kind for f in imported.findings} >= {"frozen", "time_back"}  # as the data came


def test_a_repair_can_be_asked_for_on_the_command_line(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("t,x\n0,1\n2,2\n1,3\n")
    (tmp_path / "m.toml").write_text('[time]\ncolumn = "t"\n[[column]]\nfrom = "x"\nto = "a_x_g"\n')
    words = ["import", str(tmp_path / "a.csv"), "--map", str(tmp_path / "m.toml")]
    words += ["-o", str(tmp_path / "r.csv")]
    assert main(words) == 0
    assert "time goes back, once, in data row 3; --repair sort_time" in capsys.readouterr().err
    assert main([*words, "--repair", "sort_time"]) == 0
    assert "# repairs: sort_time: 2 rows moved" in (tmp_path / "r.csv").read_text()
    assert main([*words, "--repair", "sort"]) == 2
    assert "did you mean 'sort_time'?" in capsys.readouterr().err


# --------------------------------------------------------------------------------------------------
# ---- text


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-be", "gb18030", "cp1252"])
def test_an_encoding_is_read_as_it_was_written(encoding, tmp_path):
    name = "Drehung (°)" if encoding == "cp1252" else "角度"
    (tmp_path / "a.csv").write_bytes(f"{name};t\r\n1,5;0\r\n2,5;1\r\n".encode(encoding))
    text = (
        f'[file]\nseparator = "semicolon"\ndecimal = "comma"\nencoding = "{encoding}"\n'
        f'[time]\ncolumn = "t"\n[[column]]\nfrom = "{name}"\nto = "table_outer_deg"\n'
    )
    found = import_recording(tmp_path / "a.csv", parse_mapping(text, "m"))
    assert found.column("table_outer_deg").tolist() == [1.5, 2.5]


def test_a_wrong_encoding_is_refused(tmp_path):
    (tmp_path / "a.csv").write_bytes("x\n°\n".encode("cp1252"))
    for name in ("gb18030", "nonsense"):
        with pytest.raises(TiltcalError, match=r"file\.encoding"):
            read_raw(tmp_path / "a.csv", FileLayout(encoding=name))


def test_labels_come_along(tmp_path):
    (tmp_path / "a.csv").write_text("t,x,pose\n0,1,+x\n1,2,\n2,3,-x\n")
    text = '[time]\ncolumn = "t"\n[[column]]\nfrom = "x"\nto = "a_x_g"\n'
    text += '[[column]]\nfrom = "pose"\nto = "label"\n'
    found = import_recording(tmp_path / "a.csv", parse_mapping(text, "m"))
    assert found.labels.tolist() == ["+x", None, "-x"]


@pytest.mark.parametrize(
    "stamps",
    [
        ("2026-05-04T12:00:00.000Z", "2026-05-04T12:00:00.250Z"),
        ("2026-05-04T14:00:00.000+02:00", "2026-05-04T12:00:00.250Z"),
        ("2026/05/04 12:00:00,000", "2026/05/04 12:00:00,250"),
        ("2026-5-4 12:00:00.0", "2026-5-4 12:00:00.25"),
    ],
)
def test_iso_stamps_with_and_without_zones(stamps, tmp_path):
    (tmp_path / "a.csv").write_text("t;x\n" + "".join(f"{s};1\n" for s in stamps))
    text = '[file]\nseparator = "semicolon"\n[time]\ncolumn = "t"\nunit = "iso"\n'
    text += '[[column]]\nfrom = "x"\nto = "a_x_g"\n'
    found = import_recording(tmp_path / "a.csv", parse_mapping(text, "m"))
    assert found.time.tolist() == [0.0, 0.25]
    assert found.metadata["time zero"] == "1777896000 s"


def test_lines_and_cells_that_are_spoilt_are_named_and_dropped_on_request(tmp_path, capsys):
    lines = ["t,ax,ay,az"] + [f"{k / 10},{k % 2},0.1,9.8" for k in range(60)]
    lines[20], lines[30], lines[40] = "1.9,1,0.1", "2.9,oops,0.1,9.8", "3.9,1,0.1,9.8,7"
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n6.0,1,0.")
    text = propose_mapping(tmp_path / "a.csv").toml()
    assert "# found: lines with another number of cells, left out: 2" in text
    assert "# found: ax: cells that are no numbers, once, in data row 29" in text
    assert "# found: the last line is cut off and left out: '6.0,1,0.'" in text
    (tmp_path / "m.toml").write_text(text.replace("_?", "_m_s2"))
    words = ["import", str(tmp_path / "a.csv"), "--map", str(tmp_path / "m.toml")]
    words += ["-o", str(tmp_path / "r.csv")]
    assert main(words) == 2
    assert "data line 20: found 3 cells, need 4" in capsys.readouterr().err
    dropping = text.replace('ragged_lines = "refuse"', 'ragged_lines = "drop"')
    (tmp_path / "m.toml").write_text(dropping.replace("_?", "_m_s2"))
    assert main(words) == 2
    assert "found the text 'oops'" in capsys.readouterr().err
    assert main([*words, "--repair", "empty_text"]) == 0
    done = (tmp_path / "r.csv").read_text()
    assert "# repairs: empty_text: 1 cells of accel_x_m_s2 emptied; ragged_lines: 2 left" in done
    assert len(done.splitlines()) == 3 + 58


def test_a_row_without_a_time_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("t,x\n0,1\n,2\n2,3\n")
    text = '[time]\ncolumn = "t"\n[[column]]\nfrom = "x"\nto = "a_x_g"\n'
    with pytest.raises(TiltcalError, match="data row 2: found no time in column t"):
        import_recording(tmp_path / "a.csv", parse_mapping(text, "m"))
