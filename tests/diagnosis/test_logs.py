"""Logs of every kind give the same study, by a mapping of names, units, signs and clocks."""

from __future__ import annotations

import gzip
import json
import struct
import zlib
from time import process_time

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import yaml
from logged import logged_study
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.io import savemat

from orchestrator.base.errors import ConfigError
from orchestrator.config import Places
from orchestrator.diagnosis.rig.checks import check_logs
from orchestrator.diagnosis.rig.study import UNITS as NOMINAL_UNITS
from orchestrator.diagnosis.rig.study import load_study
from orchestrator.diagnosis.study.keys import Logged
from orchestrator.diagnosis.study.logs import LogError, name_and_unit, read_log
from orchestrator.diagnosis.study.mapping import columns_of, read_mapping

SIGNALS = (
    "desired_position", "desired_velocity", "encoder_position", "sensor_force", "compensated_force",
    "stiffness_estimate",
)  # fmt: skip
UNITS = dict(zip(SIGNALS, ("m", "m/s", "m", "N", "N", "N/m"), strict=True))
# How this lab logs: other units, and a force that counts the other way round.
LAB = {"desired_position": ("mm", 1e3), "sensor_force": ("kN", -1e-3)}


@pytest.fixture(scope="module")
def study():
    made = logged_study(ticks=600)
    return made


def lab_values(run):
    return {name: run[name] * LAB.get(name, ("", 1.0))[1] for name in SIGNALS}


def lab_units():
    return {name: LAB.get(name, (UNITS[name], 1.0))[0] for name in SIGNALS}


def write_study(study, folder, suffix, column, **columns):
    """A study file whose signals are called `column.format(name)` in its logs."""
    nominal = {
        name: {"value": float(one.value), "unit": NOMINAL_UNITS[name], "tolerance": float(one.tolerance)}
        for name, one in study.nominal.items()
    }
    mapping = {name: {"column": column.format(name), "unit": lab_units()[name]} for name in SIGNALS}
    mapping["sensor_force"]["sign"] = -1
    runs = [
        {
            "file": run.name + suffix,
            "role": run.role.value,
            "mass": run.mass,
            "approach_speed": run.approach_speed,
        }
        for run in study.runs
    ]
    data = {"format": "gap-study/1", "rig": "docking-1d", "tick": study.tick, "nominal": nominal,
            "runs": runs, "columns": mapping | columns}  # fmt: skip
    (folder / "study.yaml").write_text(yaml.safe_dump(data))
    return folder / "study.yaml"


def same(study, loaded, tolerance=1e-12):
    for run, other in zip(study.runs, loaded.runs, strict=True):
        for name in ("time", *SIGNALS):
            size = np.abs(run[name]).max()
            np.testing.assert_allclose(other[name], run[name], rtol=0, atol=tolerance * size, err_msg=name)


def test_csv(study, tmp_path):
    for run in study.runs:
        header = ",".join(["t [ms]", *(f"{name}_x [{unit}]" for name, unit in lab_units().items())])
        table = np.column_stack([1e3 * run["time"], *lab_values(run).values()])
        np.savetxt(
            tmp_path / f"{run.name}.csv", table, delimiter=",", header=header, comments="", fmt="%.17g"
        )
    same(study, load_study(write_study(study, tmp_path, ".csv", "{}_x", time="t")))
    # As they stand in the header, with their units, too; another unit is no such column.
    as_written = {name: f"{name}_x [{unit}]" for name, unit in lab_units().items()}
    as_written["sensor_force"] = {"column": as_written["sensor_force"], "sign": -1}
    same(study, load_study(write_study(study, tmp_path, ".csv", "", **as_written, time="t [ms]")))
    with pytest.raises(ConfigError, match=r"time: no column t \[s\]\n  .*Did you mean t\?"):
        load_study(write_study(study, tmp_path, ".csv", "", **as_written, time="t [s]"))


def test_parquet(study, tmp_path):
    for run in study.runs:
        fields = [pa.field(name, pa.float64(), metadata={"unit": unit}) for name, unit in lab_units().items()]
        table = pa.table([pa.array(one) for one in lab_values(run).values()], schema=pa.schema(fields))
        pyarrow.parquet.write_table(table, tmp_path / f"{run.name}.parquet")
    same(study, load_study(write_study(study, tmp_path, ".parquet", "{}")))


def test_mat(study, tmp_path):
    for run in study.runs:
        savemat(tmp_path / f"{run.name}.mat", {"rig": {"time": run["time"], **lab_values(run)}})
    time = {"column": "rig.time", "unit": "s"}
    same(study, load_study(write_study(study, tmp_path, ".mat", "rig.{}", time=time)))


def test_hdf5(study, tmp_path):
    for run in study.runs:
        with h5py.File(tmp_path / f"{run.name}.h5", "w") as file:
            for name, values in lab_values(run).items():
                file[f"rig/{name}"] = values
    same(study, load_study(write_study(study, tmp_path, ".h5", "rig.{}")))


def test_hdf5_tables_and_units(tmp_path):
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["a/q"] = np.arange(12.0).reshape(2, 6)
        file["a/f"] = np.arange(3)
        file["a/f"].attrs["units"] = "N"
    log = read_log(tmp_path / "x.h5")
    assert set(log) == {"a.q[0]", "a.q[1]", "a.f"}
    assert log["a.q[1]"].values.tolist() == [6, 7, 8, 9, 10, 11]
    assert log["a.f"].unit == "N"


def test_mcap_of_json(study, tmp_path):
    for run in study.runs:
        values = lab_values(run)
        with (tmp_path / f"{run.name}.mcap").open("wb") as stream:
            writer = Writer(stream)
            writer.start()
            schema = writer.register_schema("x", "jsonschema", b"{}")
            channels = {name: writer.register_channel(f"/{name}", "json", schema) for name in SIGNALS}
            for index, time in enumerate(run["time"]):
                for name in SIGNALS:
                    stamp = 1_700_000_000_000_000_000 + round(time * 1e9)
                    data = json.dumps({"data": {"v": [0.0, values[name][index]]}, "frame": "rod"}).encode()
                    writer.add_message(channels[name], stamp, data, stamp)
            writer.finish()
    same(study, load_study(write_study(study, tmp_path, ".mcap", "/{}.data.v[1]")))


def test_ros_bag_of_messages_that_come_late(study, tmp_path):
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg("float64 value\nbool valid", "lab_msgs/msg/Value"))
    message = store.types["lab_msgs/msg/Value"]
    for run in study.runs:
        values = lab_values(run)
        with BagWriter(tmp_path / run.name, version=9) as writer:
            connections = {
                name: writer.add_connection(f"/{name}", "lab_msgs/msg/Value", typestore=store)
                for name in SIGNALS
            }
            for index, time in enumerate(run["time"]):
                for name in SIGNALS:
                    # The force is stamped 2.0003 ms too late.
                    late = 2_000_300 if name == "sensor_force" else 0
                    data = store.serialize_cdr(message(values[name][index], True), "lab_msgs/msg/Value")
                    writer.write(connections[name], round(time * 1e9) + late, data)
    path = write_study(study, tmp_path, "", "/{}.value")
    data = yaml.safe_load(path.read_text())
    data["columns"]["sensor_force"]["clock"] = "2.0003 ms"
    path.write_text(yaml.safe_dump(data))
    same(study, load_study(path))
    data["columns"]["sensor_force"]["clock"] = "0 s"
    path.write_text(yaml.safe_dump(data))
    refused, _ = check_logs(load_study(path))
    assert len(refused) == 1 and f"the same in {len(study.runs) - 1} more runs" in refused[0].what
    assert all("ticks late" in one.remedy for one in refused)


def test_a_clock_in_a_table(study, tmp_path):
    for run in study.runs:
        values = lab_values(run)
        values["encoder_position"] = np.roll(values["encoder_position"], 3)
        savemat(tmp_path / f"{run.name}.mat", values)
    path = write_study(study, tmp_path, ".mat", "{}")
    data = yaml.safe_load(path.read_text())
    data["columns"]["encoder_position"]["clock"] = "3 ms"
    path.write_text(yaml.safe_dump(data))
    for run, other in zip(study.runs, load_study(path).runs, strict=True):
        assert len(other) == 597
        np.testing.assert_allclose(
            other["encoder_position"], run["encoder_position"][:597], rtol=0, atol=1e-15
        )
        np.testing.assert_allclose(
            other["desired_position"], run["desired_position"][:597], rtol=0, atol=1e-15
        )
    data["columns"]["encoder_position"]["clock"] = "3.5 ms"
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(ConfigError, match=r"clock 0.0035 s is no whole number of ticks of 0.001 s"):
        load_study(path)


def test_what_is_wrong_is_reported_at_once(study, tmp_path):
    for run in study.runs:
        savemat(tmp_path / f"{run.name}.mat", lab_values(run))
    path = write_study(study, tmp_path, ".mat", "{}")
    data = yaml.safe_load(path.read_text())
    data["columns"]["sensor_farce"] = "x"
    del data["columns"]["encoder_position"]
    data["columns"]["sensor_force"]["sign"] = 2
    data["columns"]["desired_position"]["clock"] = 0.002
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(ConfigError) as caught:
        load_study(path)
    said = str(caught.value)
    assert "columns.sensor_farce: unknown" in said and "Did you mean sensor_force?" in said
    assert "no column for encoder_position" in said
    assert "columns.desired_position.clock: 0.002 has no unit" in said and "Write 0.002 s." in said
    assert "columns.sensor_force.sign: got 2\n  1 or -1" in said
    lines = path.read_text().splitlines()
    for name in ("sensor_farce", "desired_position.clock", "sensor_force.sign"):
        key = name.rpartition(".")[2] + ":"
        numbers = [number for number, line in enumerate(lines, 1) if line.strip().startswith(key)]
        assert any(f"study.yaml:{number}: columns.{name}: " in said for number in numbers), name

    path = write_study(study, tmp_path, ".mat", "{}", encoder_position="encoder_positron", compensated_force={
        "column": "compensated_force", "unit": "mm"})  # fmt: skip
    with pytest.raises(ConfigError) as caught:
        load_study(path)
    said = str(caught.value)
    assert (
        "encoder_position: no column encoder_positron" in said and "Did you mean encoder_position or" in said
    )


def test_units_are_needed_and_checked(study, tmp_path):
    for run in study.runs:
        savemat(tmp_path / f"{run.name}.mat", lab_values(run))
    path = write_study(study, tmp_path, ".mat", "{}", encoder_position="encoder_position")
    with pytest.raises(
        ConfigError,
        match=r"column encoder_position has no unit\n  Write `encoder_position \[m\]` in its header, or",
    ):
        load_study(path)
    path = write_study(
        study, tmp_path, ".mat", "{}", encoder_position={"column": "encoder_position", "unit": "N"}
    )
    # The study says so, not the log: reported once, where it stands.
    with pytest.raises(
        ConfigError, match=r"study.yaml:\d+: columns.encoder_position.unit: N .*to m"
    ) as caught:
        load_study(path)
    assert len(caught.value.problems) == 1


def test_files_that_no_reader_knows(tmp_path):
    (tmp_path / "log.xyz").write_text("?")
    with pytest.raises(LogError, match=r"no reader for \.xyz; there are \.csv, \.csv\.gz, \.parquet, "):
        read_log(tmp_path / "log.xyz")
    (tmp_path / "log.mcap").write_bytes(b"not one")
    with pytest.raises(LogError, match="cannot be read"):
        read_log(tmp_path / "log.mcap")


def test_packed_logs_that_expand_too_far_are_refused_in_under_a_second(tmp_path):
    """A text of gigabytes in megabytes; numbers in binary of which a file holds one, and how often."""
    packer = zlib.compressobj(9, zlib.DEFLATED, 31)
    rows = b"".join(packer.compress(b"0,0,0\n" * 2**17) for _ in range(2000))
    (tmp_path / "a.csv.gz").write_bytes(packer.compress(b"t [s],x [m],y\n") + rows + packer.flush())
    (tmp_path / "columns.csv.gz").write_bytes(gzip.compress(b"a" + b",a" * 2**20))
    savemat(tmp_path / "a.mat", {"x": np.zeros(40_000_000)}, do_compression=True)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("x", shape=(10**13,), chunks=(10**6,), dtype="f8")
    table = pa.table({"x": np.zeros(2 * 10**7)})
    with pyarrow.parquet.ParquetWriter(tmp_path / "a.parquet", table.schema, compression="zstd") as writer:
        writer.write_table(table)
        writer.write_table(table)
    for path in sorted(tmp_path.iterdir()):
        begin = process_time()
        with pytest.raises(LogError, match=r"^refused, it(s \d+ bytes expand to| has \d+ columns)"):
            read_log(path)
        assert process_time() - begin < 10.0, path.name


def test_packed_logs_that_are_damaged_are_refused(tmp_path):
    whole = gzip.compress(b"t [s],x [m]\n" + b"0,1\n" * 1000)
    path = tmp_path / "a.csv.gz"
    for data in (
        whole[:-10],
        whole[:12] + b"\xff" * 8 + whole[20:],
        whole[:-8] + bytes(8),
        b"t,x\n0,1\n",
        b"",
    ):
        path.write_bytes(data)
        with pytest.raises(LogError, match=r"^cannot be read: "):
            read_log(path)
    path.write_bytes(whole)
    assert len(read_log(path)["x"].values) == 1000


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
@pytest.mark.parametrize("stated", ["right", "too little", "no summary"])
def test_an_mcap_log_that_expands_too_far_is_refused(compression, stated, tmp_path):
    """Whatever the file states of its size."""
    path = tmp_path / "a.mcap"
    index = IndexType.NONE if stated == "no summary" else IndexType.ALL
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=2**26, compression=compression, index_types=index)
        writer.start()
        channel = writer.register_channel("/x", "json", 0)
        for stamp in range(270):
            writer.add_message(channel, stamp, b'{"v": 1' + b" " * 2**20 + b"}", stamp)
        writer.finish()
    if stated == "too little":
        data = path.read_bytes()
        with path.open("rb") as stream:
            chunks = [one for one in StreamReader(stream, emit_chunks=True).records if isinstance(one, Chunk)]
        for one in chunks:
            # In the chunk and in its index; a frame of LZ4 states the size as well, under a checksum.
            size, crc, packed = one.uncompressed_size, one.uncompressed_crc, len(one.data)
            data = data.replace(struct.pack("<QI", size, crc), struct.pack("<QI", 10, crc))
            data = data.replace(struct.pack("<QQ", packed, size), struct.pack("<QQ", packed, 10))
        path.write_bytes(data)
    begin = process_time()
    with pytest.raises(LogError, match=r"^refused, its \d+ bytes expand to \d+ or more"):
        read_log(path)
    assert process_time() - begin < 30.0


def test_a_log_of_mostly_constant_columns_is_read_however_it_is_packed(tmp_path):
    """A recording at rest: what changes is the time."""
    count = 200_000
    rows = "".join(f"{number / 1000:.3f}{',0.000000' * 20}\n" for number in range(count))
    text = "t [s]," + ",".join(f"x{number} [m]" for number in range(20)) + "\n" + rows
    path = tmp_path / "a.csv.gz"
    path.write_bytes(gzip.compress(text.encode(), 9))
    assert len(text) > 16 * 2**20 and len(read_log(path)["x19"].values) == count


def test_dates_with_times_are_seconds_since_the_first(tmp_path):
    stamps = ["2024-01-01 00:00:00.500", "2024-01-01 00:00:00.501", "2024-01-01 00:00:02.500"]
    (tmp_path / "a.csv").write_text("when,day,x [N]\n" + "".join(f"{one},2024-01-01,1\n" for one in stamps))
    log = read_log(tmp_path / "a.csv")
    assert log["when"].unit == "s" and np.allclose(log["when"].values, [0.0, 0.001, 2.0], atol=1e-12)
    assert np.isnan(log["day"].values).all() and log["x"].values.tolist() == [1.0, 1.0, 1.0]


def test_units_that_do_not_begin_at_zero(tmp_path):
    """Readings are of a scale, noise and offsets are differences: 20 degC are 293.15 K, 2 degC more 2 K."""
    (tmp_path / "a.csv").write_text("time [s],air [degC]\n0,20\n1,25\n")
    entries = {"time": "time", "air": {"column": "air", "noise": "0.1 degC", "offset": "2 degC"}}
    units, problems = {"time": "s", "air": "K"}, []
    mapping = read_mapping(entries, units, Places("study.yaml"), ("columns",), problems, Logged)
    columns = columns_of(tmp_path / "a.csv", mapping, units, 1.0, problems)
    assert problems == [] and mapping["air"].noise == pytest.approx(0.1)
    assert columns["air"] == pytest.approx([295.15, 300.15])


def csv(tmp_path, text, **entries):
    """What is reported about a log with the signal `force`, of the unit N."""
    (tmp_path / "a.csv").write_text(text)
    units, problems = {"time": "s", "force": "N"}, []
    mapping = read_mapping({"force": "f", **entries}, units, Places("study.yaml"), ("columns",), problems)
    assert problems == []
    columns_of(tmp_path / "a.csv", mapping, units, 1e-3, problems)
    return "\n".join(str(one) for one in problems).replace(f"{tmp_path}/", "")


def test_a_folder_that_is_no_bag_is_reported_as_such(tmp_path):
    with pytest.raises(LogError, match=r"is a folder, and no ROS bag .*; name a file, of \.csv"):
        read_log(tmp_path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("f [N]\n1\nabc\n2\nx\n", "a.csv:3: force: row 1 of column f holds 'abc'\n"
         "  a number; 2 such in all. Correct the log there."),
        ("f [N];g\n1;1\n1,5;1\n", "a.csv:3: force: row 1 of column f holds '1,5'\n"
         "  a number; 1 such in all. Write decimal points: 1.5."),
        # An empty line is skipped: then the row does not tell the line.
        ("f [N],g\n1,1\n\n,1\n", "a.csv: force: row 1 of column f holds nothing, or nan\n"
         "  a number; 1 such in all. Correct the log there."),
        ("f [N]\n1\ninf\n", "a.csv:3: force: row 1 of column f holds inf\n"
         "  a number; 1 such in all. Correct the log there."),
        ("f [N]\n1\n1e308\n", "a.csv:3: force: row 1 of column f holds 1e+308\n"
         "  a number below 1e+150; 1 such in all. Correct the log there."),
        ("f [N]\n", "a.csv: holds a header, and no rows below it"),
        ("0.1,2.5e-3\n0.2,1\n", "a.csv: has numbers in its first line (0.1, 2.5e-3); "
         "write the columns' names there: `force [N],...`"),
        ("f [N],f [kN]\n1,2\n", "a.csv: force: several columns are called f; "
         "give each a name of its own in the log's header"),
        ("f [N],g,g\n1,2,3\n", ""),
        ("f [m]\n1\n", "a.csv: force: column f: m [m] cannot be converted to N [kg.m.s-2]\n  Map the column "
         "that is meant, or correct the unit: `unit` in a study file, or in the header."),
    ],
)  # fmt: skip
def test_rows_and_headers_that_cannot_be_read(tmp_path, text, said):
    assert csv(tmp_path, text) == said


def test_decimal_commas_between_commas(tmp_path):
    said = csv(tmp_path, "t [s],f [N]\n0,000,1,5\n0,001,1,6\n")
    assert "cannot be read" in said and "decimal commas, separate the columns by ; and write points" in said


@pytest.mark.parametrize(
    ("header", "step", "said"),
    [
        ("stamp [ms]", 2.0, "column stamp rises by 2 ms from row to row\n  0.001 s, of tick. Map `time: "
         "stamp` under columns, or set tick; rename the column if it holds no time."),
        ("Time", 0.004, "column Time rises by 0.004, without a unit, from row to row\n  0.001 s, of tick. "
         "Map `time: {column: Time, unit: s}` under"),
        # The tick itself, in whatever it is counted; what is no clock; what does not rise evenly.
        ("stamp [ms]", 1.0, ""),
        ("t", 1000.0, ""),
        ("row", 1.0, ""),
        ("t [s]", 0.0, ""),
        ("t [s]", -2.0, ""),
        ("delay [s]", None, ""),
    ],
)  # fmt: skip
def test_a_time_that_is_not_mapped_and_is_another(tmp_path, header, step, said):
    values = [1, 5, 2, 9, 3] if step is None else [1e6 + step * row for row in range(5)]
    text = f"{header},f [N]\n" + "".join(f"{value!r},{row}\n" for row, value in enumerate(values))
    reported = csv(tmp_path, text)
    assert reported.startswith(f"a.csv: time is not mapped, and {said}") if said else reported == ""
    name = header.partition(" ")[0]
    assert csv(tmp_path, text, time={"column": name, "unit": "s"}) == ""


def test_one_clock_that_agrees_is_enough(tmp_path):
    text = "us [us],counter [s],f [N]\n" + "".join(f"{1000 * row},{2 * row},0\n" for row in range(5))
    assert csv(tmp_path, text) == ""


def test_words_of_a_mapping_are_the_product_s_own():
    units, problems = {"force": "N", "way": "m"}, []
    entries = {
        "force": {"column": "f", "noise": "-1 N", "nois": "1 N"},
        "way": {"column": "w", "noise": "2 N"},
    }
    assert read_mapping(entries, units, Places("study.yaml"), ("columns",), problems, Logged) == {}
    assert [str(one) for one in problems] == [
        "study.yaml: columns.force.noise: got '-1 N'\n  above 0. Leave it out where nothing is compared.",
        "study.yaml: columns.force.nois: unknown key 'nois'\n  allowed: column, unit, sign, offset, clock, "
        "noise, feed, start, hold. Did you mean noise?",
        "study.yaml: columns.way.noise: cannot take '2 N', N [kg.m.s-2] cannot be converted to m [m]\n"
        "  its unit is m",
    ]


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [("force [N]", "force", "N"), ("opening [1]", "opening", "1"), ("q[1]", "q[1]", ""),
     ("q[2] [1]", "q[2]", "1"), ("t", "t", "")],
)  # fmt: skip
def test_units_in_headers(header, name, unit, tmp_path):
    (tmp_path / "log.csv").write_text(f"{header},other\n1.5,2\n")
    log = read_log(tmp_path / "log.csv")
    assert log[name].unit == unit and log[name].values.tolist() == [1.5]


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("Time (s)", "Time", "s"), ("flow rate (L/min)", "flow rate", "L/min"), ("force [N]", "force", "N"),
        ("pressure (absolute)", "pressure (absolute)", ""), ("valve (1)", "valve (1)", ""),
        ("f(x)", "f(x)", ""),
    ],
)  # fmt: skip
def test_a_header_gives_name_and_unit(header: str, name: str, unit: str) -> None:
    assert name_and_unit(header) == (name, unit)
