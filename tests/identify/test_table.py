"""The table: what is written is read, what is damaged is named, what does not conform is listed."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.table import format as table_format
from seqsweep.identify.table import read as table
from seqsweep.identify.table import write as table_write
from seqsweep.identify.table.format import TableError
from seqsweep.identify.table.read import iter_responses, read_table, validate_table
from seqsweep.identify.table.write import write_table

F1_HZ = 50.0
F_HZ = np.array([1.5, 23.7, 76.3, 100.0, 150.0, 999.5])
DOCS = Path(__file__).parents[2] / "docs" / "table-format.md"

Change = Callable[[pa.Table], pa.Table]
MetaChange = Callable[[dict[str, Any]], Any]


def metadata(*op_ids: str) -> dict[str, Any]:
    points = [
        {"op_id": op_id, "active_power_mw": 0.65, "terminal_voltage_pu": 1.0, "settle_residual": 1e-11}
        for op_id in op_ids
    ]
    return {
        "f1_hz": F1_HZ,
        "bases": {"rated_voltage_v": 690.0, "rated_power_va": 1.5e6},
        "power_meaning": "at the PCC, out of the device",
        "operating_points": points,
        "configuration": {"campaign": {"name": "test"}, "sweep": {"f_hz": F_HZ.tolist()}},
        "plant": {"id": "branch-v1"},
        "seeds": {"signal": 7},
    }


def response(op_id: str, f_hz: np.ndarray = F_HZ, seed: int = 0) -> FrequencyResponse:
    """Random values, a random covariance, and a last row that failed."""
    rng = np.random.default_rng(seed)
    n = len(f_hz)
    y = rng.normal(size=(n, 2, 2)) + 1j * rng.normal(size=(n, 2, 2))
    root = rng.normal(size=(n, 8, 8))
    product = root @ root.transpose(0, 2, 1)
    covariance = 0.5 * (product + product.transpose(0, 2, 1))
    y[-1], covariance[-1] = complex(np.nan, np.nan), np.nan
    return FrequencyResponse(
        f_hz=f_hz,
        y=y,
        f1_hz=F1_HZ,
        covariance=covariance,
        status=np.array(["ok"] * (n - 1) + ["failed"]),
        reason=np.array([""] * (n - 1) + ["the plant said nein, ä"]),
        quality={"cond_v": 1.0 + rng.random(n), "n_periods": np.full(n, 3.0)},
        meta={"op_id": op_id},
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A conforming table of two operating points."""
    file = tmp_path / "y.parquet"
    write_table(file, [response("p065", seed=1), response("p130", seed=2)], metadata("p065", "p130"))
    return file


def assert_equal(one: FrequencyResponse, other: FrequencyResponse) -> None:
    assert one.f1_hz == other.f1_hz
    for name in ("f_hz", "y", "covariance", "status", "reason"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


# Round trip


def test_what_is_written_is_read_to_the_last_bit(path: Path) -> None:
    found = read_table(path)
    assert found.op_ids == ("p065", "p130")
    for seed, one in enumerate(found.responses, start=1):
        original = response(one.meta["op_id"], seed=seed)
        assert_equal(one, original)
        np.testing.assert_array_equal(one.quality["cond_v"], original.quality["cond_v"])
        assert np.all(np.isnan(one.quality["linearity"]))  # never given, so unknown


def test_metadata_survives_and_is_completed(path: Path) -> None:
    meta = read_table(path).meta
    given = metadata("p065", "p130")
    assert {key: meta[key] for key in given if key != "bases"} == {k: v for k, v in given.items() if k != "bases"}
    assert meta["bases"].items() > given["bases"].items()
    assert (meta["format"], meta["version"], meta["frame"]) == ("seqsweep-admittance", "1.1.0", "pn")
    assert meta["configuration_sha256"] == table_format.content_hash(given["configuration"])
    assert table.read_metadata(path) == meta


def test_a_response_remembers_its_operating_point(path: Path) -> None:
    assert read_table(path).response("p130").meta == metadata("p130")["operating_points"][0]
    with pytest.raises(TableError, match=r"no operating point 'p99' in the table; it has p065, p130"):
        read_table(path).response("p99")


def test_a_table_that_was_read_can_be_written_again(path: Path, tmp_path: Path) -> None:
    found = read_table(path)
    write_table(tmp_path / "again.parquet", found.responses, found.meta)
    assert (tmp_path / "again.parquet").read_bytes() == path.read_bytes()


def test_a_written_table_conforms(path: Path) -> None:
    assert validate_table(path) == []


def test_the_covariance_mapping_returns() -> None:
    covariance = np.asarray(response("p").covariance)
    cov = table_format.pack_covariance(covariance)
    assert cov.shape == (len(F_HZ), 36)
    np.testing.assert_array_equal(table_format.unpack_covariance(cov), covariance)
    np.testing.assert_array_equal(cov[:, :3], covariance[:, 0, :3])  # row after row ...
    np.testing.assert_array_equal(cov[:, 8], covariance[:, 1, 1])  # ... each from its diagonal on


def test_the_standard_deviation_is_that_of_the_complex_value() -> None:
    covariance = np.diag([9.0, 16.0, 1.0, 0.0, 0.0, 4.0, 0.25, 0.0])[np.newaxis]
    np.testing.assert_array_equal(table_format.std_of(covariance), [[5.0, 1.0, 2.0, 0.5]])


def test_the_mirror_is_signed(path: Path) -> None:
    mirror_hz = pq.read_table(path)["f_mirror_hz"].to_numpy()[: len(F_HZ)]
    np.testing.assert_array_equal(mirror_hz, 2.0 * F1_HZ - F_HZ)
    assert mirror_hz.min() < 0.0 < mirror_hz.max()
    assert 0.0 in mirror_hz  # 2 f1 itself is allowed: its mirror is DC


# Bytes


def test_equal_campaigns_give_equal_bytes(path: Path, tmp_path: Path) -> None:
    meta = metadata("p065", "p130")
    turned = dict(reversed(meta.items()))  # the order of keys is nobody's business
    write_table(tmp_path / "b.parquet", [response("p065", seed=1), response("p130", seed=2)], turned)
    assert (tmp_path / "b.parquet").read_bytes() == path.read_bytes()


def test_where_a_nan_came_from_leaves_no_trace(tmp_path: Path) -> None:
    for name, nan in (("plus", np.nan), ("minus", -np.nan)):
        one = response("p")
        y = one.y.copy()
        y[-1] = complex(nan, nan)
        again = FrequencyResponse(one.f_hz, y, F1_HZ, status=one.status, reason=one.reason, meta=one.meta)
        write_table(tmp_path / name, [again], metadata("p"))
    assert (tmp_path / "plus").read_bytes() == (tmp_path / "minus").read_bytes()


def test_streaming_equals_at_once_across_row_groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (table, table_write):
        monkeypatch.setattr(module, "ROW_GROUP_ROWS", 16)  # 5 x 6 rows: operating points straddle groups
    op_ids = [f"p{k}" for k in range(5)]
    responses = [response(op_id, seed=k) for k, op_id in enumerate(op_ids)]
    write_table(tmp_path / "list.parquet", responses, metadata(*op_ids))
    write_table(tmp_path / "stream.parquet", iter(responses), metadata(*op_ids))
    assert (tmp_path / "list.parquet").read_bytes() == (tmp_path / "stream.parquet").read_bytes()
    groups = pq.ParquetFile(tmp_path / "stream.parquet").metadata
    assert [groups.row_group(k).num_rows for k in range(groups.num_row_groups)] == [16, 14]
    for one, original in zip(iter_responses(tmp_path / "stream.parquet"), responses, strict=True):
        assert_equal(one, original)


def test_units_stand_in_the_fields(path: Path) -> None:
    schema = pq.read_schema(path)
    assert schema.field("f_hz").metadata[b"unit"] == b"Hz"
    assert schema.field("y_np_im").metadata[b"unit"] == b"S"
    assert schema.field("cov").metadata[b"unit"] == b"S^2"


def test_doubles_are_stored_for_compression_and_pages_have_checksums(path: Path) -> None:
    column = pq.ParquetFile(path).metadata.row_group(0).column(1)
    assert (column.path_in_schema, column.compression) == ("f_hz", "ZSTD")
    assert "BYTE_STREAM_SPLIT" in column.encodings


def test_the_table_knows_no_time_host_or_path(path: Path) -> None:
    content = path.read_bytes()
    assert str(path.parent).encode() not in content
    with pytest.raises(TableError, match="metadata has no place for host"):
        table_format.complete_metadata(metadata("p") | {"host": "here"})


# Atomicity


def test_a_writer_that_raises_half_way_leaves_nothing(tmp_path: Path) -> None:
    def half() -> Iterator[FrequencyResponse]:
        yield response("p065")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_table(tmp_path / "y.parquet", half(), metadata("p065", "p130"))
    assert list(tmp_path.iterdir()) == []


def test_a_failed_writer_leaves_the_old_table_alone(path: Path) -> None:
    before = path.read_bytes()
    with pytest.raises(TableError, match="'p130' is missing"):
        write_table(path, [response("p065")], metadata("p065", "p130"))
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_a_missing_folder_is_the_machine_s_error_and_not_the_table_s(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        write_table(tmp_path / "nowhere" / "y.parquet", [response("p")], metadata("p"))


# Wrong calls


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"op_id": "other"}, r"response 1 is of operating point 'other'; the metadata has 'p' there"),
        ({"frame": "dq"}, r"holds the pn frame, the response is in 'dq'"),
        ({"f1_hz": 60.0}, r"f1 is 60.0 Hz, the metadata says 50.0 Hz"),
        ({"quality": {"mood": F_HZ}}, r"no column 'mood'"),
        ({"f_hz": np.empty(0), "y": np.empty((0, 2, 2))}, r"0 frequencies"),
    ],
)
def test_a_response_that_does_not_fit_is_refused(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    arguments = {"f_hz": F_HZ, "y": np.ones((len(F_HZ), 2, 2)), "f1_hz": F1_HZ, "op_id": "p"} | change
    wrong = FrequencyResponse(meta={"op_id": arguments.pop("op_id")}, **arguments)
    with pytest.raises(TableError, match=words):
        write_table(tmp_path / "y.parquet", [wrong], metadata("p"))


def test_operating_points_of_different_length_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TableError, match="b: 3 frequencies; every operating point needs the same 6"):
        write_table(tmp_path / "y.parquet", [response("a"), response("b", F_HZ[:3])], metadata("a", "b"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"f1_hz": None}, "metadata lacks f1_hz"),
        ({"version": "2.0.0"}, "metadata version is '2.0.0'"),
        ({"operating_points": []}, "no operating points"),
        ({"operating_points": [{"op_id": "a"}]}, "lacks active_power_mw, terminal_voltage_pu"),
        ({"operating_points": 2 * metadata("a")["operating_points"]}, "'a' is listed twice"),
        ({"bases": {"rated_voltage_v": 690.0}}, "bases are rated_power_va, rated_voltage_v"),
        ({"configuration": {"x": float("nan")}}, "must be JSON"),
        ({"plant": {"x": object()}}, "must be JSON"),
    ],
)
def test_metadata_that_cannot_be_kept_is_refused(change: dict[str, Any], words: str) -> None:
    meta = {key: value for key, value in (metadata("a") | change).items() if value is not None}
    with pytest.raises(TableError, match=re.escape(words)):
        table_format.complete_metadata(meta)


# Damaged and foreign files


def test_a_flipped_bit_is_an_error_or_changes_nothing(path: Path) -> None:
    content = path.read_bytes()
    original = read_table(path)
    refused = 0
    for position in range(5, len(content), 97):
        damaged = bytearray(content)
        damaged[position] ^= 1 << position % 8
        path.write_bytes(damaged)
        try:
            found = read_table(path)
        except TableError:
            refused += 1
            continue
        # Statistics and the name of the writing library may take a bit without harm.
        assert found.meta == original.meta, position
        for one, other in zip(found.responses, original.responses, strict=True):
            assert_equal(one, other)
    assert refused > 100


def test_a_flipped_byte_of_a_number_is_told_by_its_page_checksum(path: Path) -> None:
    content = bytearray(path.read_bytes())
    column = pq.ParquetFile(path).metadata.row_group(0).column(3)
    content[column.data_page_offset + column.total_compressed_size - 3] ^= 0x10
    path.write_bytes(content)
    with pytest.raises(TableError, match=r"damaged, its data cannot be read .*CRC"):
        read_table(path)
    assert any("damaged" in violation for violation in validate_table(path))


@pytest.mark.parametrize("kept", [0, 3, 100, 0.5, 0.999])
def test_a_truncated_file_is_told(path: Path, kept: float) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: kept if isinstance(kept, int) else int(kept * len(content))])
    with pytest.raises(TableError, match="not a Parquet file, or a truncated one"):
        read_table(path)
    assert len(validate_table(path)) == 1


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(TableError, match="no such file"):
        read_table(tmp_path / "y.parquet")
    with pytest.raises(TableError, match="not a file"):
        read_table(tmp_path)


def test_text_is_no_parquet(tmp_path: Path) -> None:
    (tmp_path / "y.parquet").write_text("f_hz,y\n1,2\n" * 50)
    with pytest.raises(TableError, match="not a Parquet file"):
        next(iter_responses(tmp_path / "y.parquet"))


def test_someone_else_s_parquet_is_told(tmp_path: Path) -> None:
    pq.write_table(pa.table({"a": [1, 2]}), tmp_path / "y.parquet")
    with pytest.raises(TableError, match="Parquet, but not a table of seqsweep"):
        read_table(tmp_path / "y.parquet")
    assert len(validate_table(tmp_path / "y.parquet")) == 1


# Conformance: one change to a conforming table, one violation found


def rewrite(path: Path, change: Change = lambda rows: rows, change_meta: MetaChange = lambda meta: None) -> None:
    """Write a table as another program would, changed."""
    rows = pq.read_table(path)
    meta = json.loads(pq.read_metadata(path).metadata[b"seqsweep"])
    change_meta(meta)
    changed = change(rows)
    meta["sha256"] = table_format.metadata_hash(meta)
    pq.write_table(changed.replace_schema_metadata({b"seqsweep": json.dumps(meta)}), path)


def put(name: str, row: int, value: Any) -> Change:
    """Change one cell."""

    def change(rows: pa.Table) -> pa.Table:
        values = rows[name].to_pylist()
        values[row] = value
        field = rows.schema.field(name)
        return rows.set_column(rows.schema.get_field_index(name), field, pa.array(values, field.type))

    return change


def swap_operating_points(rows: pa.Table) -> pa.Table:
    return pa.concat_tables([rows.slice(len(F_HZ)), rows.slice(0, len(F_HZ))])


def as_float(rows: pa.Table) -> pa.Table:
    return rows.set_column(1, pa.field("f_hz", pa.float32()), rows["f_hz"].cast(pa.float32()))


def without_unit(rows: pa.Table) -> pa.Table:
    return rows.set_column(1, pa.field("f_hz", pa.float64()), rows["f_hz"])


def with_null(rows: pa.Table) -> pa.Table:
    values = pa.array([None, *rows["f_hz"].to_pylist()[1:]])
    return rows.set_column(1, pa.field("f_hz", pa.float64(), metadata={b"unit": b"Hz"}), values)


def indefinite() -> list[float]:
    covariance = np.eye(8)
    covariance[0, 2] = covariance[2, 0] = 2.0
    return list(covariance[np.triu_indices(8)])


NAN = float("nan")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rows: rows.drop_columns(["y_nn_im"]), "column 'y_nn_im' is missing"),
        (as_float, "column 'f_hz' has type float, not double"),
        (without_unit, "column 'f_hz' has unit '', not 'Hz'"),
        (with_null, "column 'f_hz' holds nulls"),
        (lambda rows: rows.append_column("cond_v", rows["cond_v"]), "column 'cond_v' is there twice"),
        (lambda rows: rows.slice(0, 0), "'p065' is in the metadata, not in the rows"),
        (lambda rows: rows.select(list(reversed(rows.column_names))), "columns must begin with op_id"),
        (lambda rows: rows.slice(len(F_HZ)), "'p065' is in the metadata, not in the rows"),
        (put("op_id", 0, "p999"), "'p999' is in the rows, not in the metadata"),
        (swap_operating_points, "rows are not in the order of the metadata's operating points"),
        (lambda rows: rows.slice(1), "different numbers of rows: p065 5, p130 6"),
        (put("f_hz", 1, 1.5), "f_hz must increase strictly"),
        (put("f_hz", 2, 20.0), "f_hz must increase strictly"),
        (put("f_hz", 0, -1.5), "f_hz must be finite and above 0"),
        (put("f_hz", 2, F1_HZ), "the fundamental itself has no admittance"),
        (put("f_mirror_hz", 4, 50.0), "f_mirror_hz is not 2 f1 - f"),
        (put("status", 0, "fine"), "p065, 1.5 Hz: unknown status"),
        (put("reason", 5, ""), "not ok, and no reason given"),
        (put("status", 5, "ok"), "p065, 999.5 Hz: y must be finite unless"),
        (put("status", 5, "noisy"), "y must be finite unless"),
        (put("y_pn_im", 5, 1.0), "y must be finite as a whole or NaN as a whole"),
        (put("cov", 0, [0.0] * 35), "column 'cov' must hold 36 doubles"),
        (put("cov", 0, [0.0] * 35 + [NAN]), "cov must be finite as a whole or NaN as a whole"),
        (put("cov", 0, indefinite()), "negative eigenvalue"),
        (put("y_pp_std", 3, 0.0), "p065, 100 Hz: y_*_std is not sqrt(var re + var im)"),
        (put("cond_v", 3, -1.0), "cond_v must not be negative"),
    ],
)
def test_the_validator_finds_a_fault_of_the_rows(path: Path, change: Change, words: str) -> None:
    rewrite(path, change)
    assert any(words in violation for violation in validate_table(path)), validate_table(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda meta: meta.pop("plant"), "metadata $: 'plant' is a required property"),
        (lambda meta: meta.update(host="here"), "metadata $: Additional properties are not allowed ('host'"),
        (lambda meta: meta.update(f1_hz=-50), "metadata $.f1_hz"),
        (lambda meta: meta.update(frame="dq"), "metadata $.frame"),
        (lambda meta: meta["operating_points"][0].pop("active_power_mw"), "metadata $.operating_points[0]"),
        (lambda meta: meta["operating_points"].append(meta["operating_points"][0]), "'p065' is listed twice"),
        (lambda meta: meta["configuration"].update(more=1), "configuration_sha256 is not the hash"),
        (lambda meta: meta.update(version="2.0.0"), "version '2.0.0' of the format; this code reads 1.x"),
        (lambda meta: meta.update(format="other"), "does not name the format"),
    ],
)
def test_the_validator_finds_a_fault_of_the_metadata(path: Path, change: MetaChange, words: str) -> None:
    rewrite(path, change_meta=change)
    assert any(words in violation for violation in validate_table(path)), validate_table(path)


def test_the_validator_lists_all_faults_and_counts_rows(path: Path) -> None:
    def spoil(rows: pa.Table) -> pa.Table:
        return put("f_mirror_hz", 0, 0.0)(put("cond_v", 1, -1.0)(put("cond_v", 7, -2.0)(rows)))

    rewrite(path, spoil, lambda meta: meta.update(power_meaning=""))
    violations = validate_table(path)
    assert len(violations) == 3
    assert violations[-1] == "p065, 23.7 Hz: cond_v must not be negative (NaN where unknown) (and 1 more)"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rows: rows.drop_columns(["y_nn_im"]), "column 'y_nn_im' is missing"),
        (as_float, "column 'f_hz' has type float, not double"),
        (with_null, "column 'f_hz' holds nulls"),
        (swap_operating_points, "rows of 'p130' are not where the metadata has that operating point"),
        (lambda rows: rows.slice(0, len(F_HZ)), "no rows for operating point 'p130'"),
        (put("f_hz", 1, 1.5), "p065: f_hz must increase strictly"),
        (put("status", 0, "fine"), "p065: unknown status 'fine'"),
        (put("cov", 0, [0.0] * 35), "column 'cov' must hold 36 doubles"),
    ],
)
def test_reading_refuses_what_it_cannot_represent(path: Path, change: Change, words: str) -> None:
    rewrite(path, change)
    with pytest.raises(TableError, match=re.escape(words)):
        read_table(path)


def test_reading_refuses_metadata_without_operating_points(path: Path) -> None:
    rewrite(path, change_meta=lambda meta: meta.update(operating_points="two"))
    with pytest.raises(TableError, match="metadata lacks f1_hz or operating_points with op_id"):
        read_table(path)
    assert any("$.operating_points" in violation for violation in validate_table(path))


def test_another_program_s_flavour_of_strings_and_lists_is_read(path: Path) -> None:
    original = read_table(path)

    def flavour(rows: pa.Table) -> pa.Table:
        rows = rows.set_column(0, pa.field("op_id", pa.large_string()), rows["op_id"].cast(pa.large_string()))
        kind = pa.large_list(pa.float64())
        return rows.set_column(15, pa.field("cov", kind, metadata={b"unit": b"S^2"}), rows["cov"].cast(kind))

    rewrite(path, flavour)
    assert validate_table(path) == []
    for one, other in zip(iter_responses(path), original.responses, strict=True):
        assert_equal(one, other)


def test_further_columns_may_follow(path: Path) -> None:
    rewrite(path, lambda rows: rows.append_column("note", pa.array(["x"] * rows.num_rows)))
    assert validate_table(path) == []
    assert len(read_table(path).responses) == 2


# Promises around the module


def test_the_format_page_lists_every_column_with_its_unit() -> None:
    rows = re.findall(
        r"^\| `(\w+)` \| (string|double|list of double) \| ([^|]*) \|", DOCS.read_text(encoding="utf-8"), re.MULTILINE
    )
    expected = [(c.name, c.kind, c.unit) for c in table_format.COLUMNS]
    assert [(name, kind, unit.strip().strip("`")) for name, kind, unit in rows] == expected


def test_importing_the_table_does_not_import_pyarrow() -> None:
    code = (
        "import sys, seqsweep.identify.table.read; sys.exit(any(m in sys.modules for m in ('pyarrow', 'jsonschema')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
