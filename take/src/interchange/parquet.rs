//! Export to Apache Parquet, with one row per sample (long) or one row per frame (wide); analog channels and the loads
//! of force plates are files of their own. The key-value metadata (`docs/columns.md`) is that of MCAP files, too.

use std::{io::Write, sync::Arc};

use parquet::{
    basic::{Compression, ConvertedType, Encoding, LogicalType, Repetition, Type as Physical},
    data_type::{ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int64Type},
    errors::{ParquetError, Result as ParquetResult},
    file::{
        metadata::KeyValue,
        properties::WriterProperties,
        writer::{SerializedFileWriter, SerializedRowGroupWriter},
    },
    schema::types::{ColumnPath, Type},
};
use serde_json::json;

use super::{
    InterchangeError, Result,
    sampled_table::{SampledTable, TIME_COLUMN},
    text::column_labels,
};
use crate::{
    motion::{FrameSource, GAP, Position, is_gap},
    record::Ledger,
};

/// Rows of a long row group: 8 MB in memory.
const LONG_GROUP_ROWS: usize = 1 << 17;

const LONG_COLUMNS: [(&str, ColumnType); 6] = [
    ("frame", ColumnType::Int64),
    ("time_s", ColumnType::Double),
    ("marker", ColumnType::Text),
    ("x", ColumnType::Float { nullable: false }),
    ("y", ColumnType::Float { nullable: false }),
    ("z", ColumnType::Float { nullable: false }),
];

/// The rows of the next row group.
#[derive(Default)]
struct LongRows {
    frame: Vec<i64>,
    time_s: Vec<f64>,
    marker: Vec<ByteArray>,
    axes: [Vec<f32>; 3],
}

/// Writes one row for each sample: frame, time, marker, x, y, z. Missing samples have no row.
pub(super) fn write_long(frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<()> {
    let info = frames.info().clone();
    let names: Vec<ByteArray> =
        column_labels(&info).into_iter().map(|label| ByteArray::from(label.into_bytes())).collect();
    let mut file = ParquetFile::new(frames, "long", &LONG_COLUMNS, out)?;
    let mut rows = LongRows::default();
    let mut row = vec![GAP; names.len()];
    let mut index = 0_u64;
    while frames.next_frame(&mut row)? {
        let frame = info.source.first_frame.saturating_add(index);
        for (name, position) in names.iter().zip(&row).filter(|(_, position)| !is_gap(**position)) {
            rows.frame.push(i64::try_from(frame).unwrap_or(i64::MAX));
            rows.time_s.push(index as f64 / info.rate_hz);
            rows.marker.push(name.clone());
            for (axis, value) in rows.axes.iter_mut().zip(position) {
                axis.push(*value);
            }
            if rows.frame.len() == LONG_GROUP_ROWS {
                rows.flush(&mut file)?;
            }
        }
        index += 1;
    }
    rows.flush(&mut file)?;
    file.finish()
}

impl LongRows {
    fn flush(&mut self, file: &mut ParquetFile<'_>) -> Result<()> {
        if self.frame.is_empty() {
            return Ok(());
        }
        file.group(|group| {
            group.column::<Int64Type>(&self.frame, None)?;
            group.column::<DoubleType>(&self.time_s, None)?;
            group.column::<ByteArrayType>(&self.marker, None)?;
            self.axes.iter().try_for_each(|axis| group.column::<FloatType>(axis, None))
        })?;
        self.frame.clear();
        self.time_s.clear();
        self.marker.clear();
        self.axes.iter_mut().for_each(Vec::clear);
        Ok(())
    }
}

/// Coordinates of a wide row group: 16 MB in memory.
const WIDE_GROUP_VALUES: usize = 1 << 22;

/// Maximum number of rows of a wide row group, for takes of few markers.
const WIDE_GROUP_ROWS_MAX: usize = 1 << 17;

/// Writes one row for each frame: frame, time, and three columns for each marker, null for a missing sample.
pub(super) fn write_wide(frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<()> {
    let info = frames.info().clone();
    let names: Vec<String> = column_labels(&info)
        .iter()
        .flat_map(|label| ["x", "y", "z"].map(|axis| format!("{label}.{axis}")))
        .collect();
    let mut columns = vec![("frame", ColumnType::Int64), ("time_s", ColumnType::Double)];
    columns.extend(names.iter().map(|name| (name.as_str(), ColumnType::Float { nullable: true })));
    let mut file = ParquetFile::new(frames, "wide", &columns, out)?;
    let n_markers = info.markers.len();
    let group_rows = (WIDE_GROUP_VALUES / (3 * n_markers).max(1)).clamp(1, WIDE_GROUP_ROWS_MAX);
    let mut positions: Vec<Position> = Vec::new();
    let mut row = vec![GAP; n_markers];
    let (mut first, mut n_rows) = (0_u64, 0_usize);
    loop {
        let more = frames.next_frame(&mut row)?;
        if more {
            positions.extend_from_slice(&row);
            n_rows += 1;
        }
        if n_rows == group_rows || (!more && n_rows > 0) {
            let rows = first..first + n_rows as u64;
            let number = |index: u64| info.source.first_frame.saturating_add(index);
            let numbers: Vec<i64> = rows.clone().map(|i| number(i).cast_signed()).collect();
            let times_s: Vec<f64> = rows.map(|index| index as f64 / info.rate_hz).collect();
            file.group(|group| {
                group.column::<Int64Type>(&numbers, None)?;
                group.column::<DoubleType>(&times_s, None)?;
                let (mut values, mut present) = (Vec::new(), Vec::new());
                for column in 0..3 * n_markers {
                    values.clear();
                    present.clear();
                    for position in positions.iter().skip(column / 3).step_by(n_markers) {
                        let is_there = !is_gap(*position);
                        present.push(i16::from(is_there));
                        values.extend(is_there.then(|| position[column % 3]));
                    }
                    group.column::<FloatType>(&values, Some(&present))?;
                }
                Ok(())
            })?;
            first += n_rows as u64;
            n_rows = 0;
            positions.clear();
        }
        if !more {
            return file.finish();
        }
    }
}

/// Writes a table of sampled channels with one row for each sample: its time, and its values, null where one is missing.
pub(super) fn write_sampled(
    table: &mut SampledTable<'_>,
    frames: &dyn FrameSource,
    out: &mut dyn Write,
) -> Result<()> {
    let (rate_hz, n_columns) = (table.rate_hz(), table.columns().len());
    let described: Vec<_> = table
        .columns()
        .iter()
        .map(|of| json!({ "name": of.name, "unit": of.unit, "description": of.description }))
        .collect();
    let own = [
        ("mocapd.sampled_rate_hz", rate_hz.to_string()),
        ("mocapd.columns", json!(described).to_string()),
    ];
    let names: Vec<String> = table.columns().iter().map(|column| column.name.clone()).collect();
    let mut columns = vec![(TIME_COLUMN, ColumnType::Double)];
    columns.extend(names.iter().map(|name| (name.as_str(), ColumnType::Float { nullable: true })));
    let mut file = ParquetFile::with_metadata(frames, &table.kind().name(), &own, &columns, out)?;
    let group_rows = (WIDE_GROUP_VALUES / n_columns.max(1)).clamp(1, WIDE_GROUP_ROWS_MAX);
    let mut values: Vec<f32> = Vec::new();
    let mut times_s: Vec<f64> = Vec::new();
    let mut flush = |values: &mut Vec<f32>, times_s: &mut Vec<f64>| -> std::io::Result<()> {
        file.group(|group| {
            group.column::<DoubleType>(times_s, None)?;
            for column in 0..n_columns {
                let of_column = || values.iter().skip(column).step_by(n_columns).copied();
                let present: Vec<i16> = of_column().map(|v| i16::from(!v.is_nan())).collect();
                let there: Vec<f32> = of_column().filter(|v| !v.is_nan()).collect();
                group.column::<FloatType>(&there, Some(&present))?;
            }
            Ok(())
        })
        .map_err(std::io::Error::other)?;
        times_s.clear();
        values.clear();
        Ok(())
    };
    table.for_each_row(frames, |time, row| {
        values.extend_from_slice(row);
        times_s.push(time.time_s);
        if times_s.len() == group_rows { flush(&mut values, &mut times_s) } else { Ok(()) }
    })?;
    if !times_s.is_empty() {
        flush(&mut values, &mut times_s)?;
    }
    file.finish()
}

/// The type of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ColumnType {
    /// Frame numbers.
    Int64,
    /// Seconds.
    Double,
    /// Millimetres.
    Float { nullable: bool },
    /// Marker labels: few distinct values, so they get a dictionary.
    Text,
}

/// A Parquet file with a flat schema. Each row group is in memory until it is complete.
struct ParquetFile<'a> {
    file: SerializedFileWriter<Vec<u8>>,
    out: &'a mut dyn Write,
}

impl<'a> ParquetFile<'a> {
    /// Begins a file with these columns and the metadata of the take; `layout` goes into the metadata.
    fn new(
        frames: &dyn FrameSource,
        layout: &str,
        columns: &[(&str, ColumnType)],
        out: &'a mut dyn Write,
    ) -> Result<Self> {
        let units = [("mocapd.units", "positions mm, time_s s".to_owned())];
        Self::with_metadata(frames, layout, &units, columns, out)
    }

    /// Begins a file with `own` in its metadata, too.
    fn with_metadata(
        frames: &dyn FrameSource,
        layout: &str,
        own: &[(&str, String)],
        columns: &[(&str, ColumnType)],
        out: &'a mut dyn Write,
    ) -> Result<Self> {
        let fields = columns.iter().map(|(name, kind)| field(name, *kind).map(Arc::new));
        let fields = fields.collect::<Result<_, _>>().map_err(parquet_error)?;
        let schema = Type::group_type_builder("mocapd").with_fields(fields).build();
        let mut metadata = metadata(frames);
        metadata.push(("mocapd.layout".to_owned(), layout.to_owned()));
        metadata.extend(own.iter().map(|(key, value)| ((*key).to_owned(), value.clone())));
        let metadata = metadata.into_iter().map(|(key, value)| KeyValue::new(key, value)).collect();
        let mut properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_dictionary_enabled(false)
            .set_created_by(concat!("mocapd version ", env!("CARGO_PKG_VERSION")).to_owned())
            .set_key_value_metadata(Some(metadata));
        for (name, kind) in columns {
            let column = ColumnPath::from(vec![(*name).to_owned()]);
            properties = match kind {
                ColumnType::Int64 => {
                    properties.set_column_encoding(column, Encoding::DELTA_BINARY_PACKED)
                }
                // Neighbouring numbers share their high bytes, which this encoding stores next to each other.
                ColumnType::Double | ColumnType::Float { .. } => {
                    properties.set_column_encoding(column, Encoding::BYTE_STREAM_SPLIT)
                }
                ColumnType::Text => properties.set_column_dictionary_enabled(column, true),
            };
        }
        let schema = Arc::new(schema.map_err(parquet_error)?);
        let file = SerializedFileWriter::new(Vec::new(), schema, Arc::new(properties.build()));
        Ok(Self { file: file.map_err(parquet_error)?, out })
    }

    /// Writes a row group; `fill` writes all of its columns in order.
    fn group(&mut self, fill: impl FnOnce(&mut RowGroup<'_>) -> ParquetResult<()>) -> Result<()> {
        {
            let mut group = RowGroup(self.file.next_row_group().map_err(parquet_error)?);
            fill(&mut group).map_err(parquet_error)?;
            group.0.close().map_err(parquet_error)?;
        }
        self.file.flush()?;
        self.drain()
    }

    /// Writes the footer.
    fn finish(mut self) -> Result<()> {
        self.drain()?;
        let rest = self.file.into_inner().map_err(parquet_error)?;
        self.out.write_all(&rest)?;
        Ok(self.out.flush()?)
    }

    /// Moves finished bytes to `out`. The library counts what it wrote, so the footer has the right offsets.
    fn drain(&mut self) -> Result<()> {
        let written = self.file.inner_mut();
        self.out.write_all(written)?;
        written.clear();
        Ok(())
    }
}

/// A row group, whose columns are written in order.
struct RowGroup<'a>(SerializedRowGroupWriter<'a, Vec<u8>>);

impl RowGroup<'_> {
    /// Writes the next column. For a nullable column `present` has a 1 for each row with a value and a 0 for each null.
    fn column<T: DataType>(
        &mut self,
        values: &[T::T],
        present: Option<&[i16]>,
    ) -> ParquetResult<()> {
        let Some(mut column) = self.0.next_column()? else {
            return Err(ParquetError::General("more columns than the schema has".to_owned()));
        };
        column.typed::<T>().write_batch(values, present, None)?;
        column.close()
    }
}

fn field(name: &str, kind: ColumnType) -> ParquetResult<Type> {
    let (physical, nullable) = match kind {
        ColumnType::Int64 => (Physical::INT64, false),
        ColumnType::Double => (Physical::DOUBLE, false),
        ColumnType::Float { nullable } => (Physical::FLOAT, nullable),
        ColumnType::Text => (Physical::BYTE_ARRAY, false),
    };
    let repetition = if nullable { Repetition::OPTIONAL } else { Repetition::REQUIRED };
    let builder = Type::primitive_type_builder(name, physical).with_repetition(repetition);
    match kind {
        ColumnType::Text => builder
            .with_logical_type(Some(LogicalType::String))
            .with_converted_type(ConvertedType::UTF8)
            .build(),
        _ => builder.build(),
    }
}

fn parquet_error(error: ParquetError) -> InterchangeError {
    std::io::Error::other(error).into()
}

/// Keys and values that describe the trajectories and, if they come from one, the take. Lists and records are JSON.
pub(super) fn metadata(frames: &dyn FrameSource) -> Vec<(String, String)> {
    let info = frames.info();
    let labels: Vec<&str> = info.markers.iter().map(|marker| &*marker.label).collect();
    let mut all = vec![
        ("rate_hz", info.rate_hz.to_string()),
        ("frames", info.n_frames.to_string()),
        ("first_frame", info.source.first_frame.to_string()),
        ("labels", json!(labels).to_string()),
        ("up_axis", info.up.name().unwrap_or("unknown").to_owned()),
    ];
    if let Some(take) = frames.take() {
        let header = &take.header;
        all.push(("software", header.software.clone()));
        all.push(("take_id", header.take_id_text()));
        all.push(("created_unix_ms", header.created_unix_ms.to_string()));
        all.push(("resampler", header.resampler.clone()));
        all.push(("tolerance_mm", header.tolerance_mm.to_string()));
        all.push(("finished", take.finished.to_string()));
        let problems: Vec<String> = take.problems.iter().map(ToString::to_string).collect();
        all.push(("problems", json!(problems).to_string()));
        if let Some(device) = &header.device {
            let device = json!({ "model": device.model, "serial": device.serial });
            all.push(("device", device.to_string()));
        }
        if let Some(found) = &take.ledger {
            all.push(("ledger", ledger(found).to_string()));
        }
    }
    all.into_iter().map(|(name, value)| (format!("mocapd.{name}"), value)).collect()
}

/// The counters of the whole take under the names of `info --json`.
fn ledger(ledger: &Ledger) -> serde_json::Value {
    json!({
        "frames_sent": ledger.frames_sent,
        "recorded": ledger.recorded,
        "lost_on_link": ledger.lost_on_link,
        "dropped_by_device": ledger.dropped_by_device,
        "lost_ring_full": ledger.lost_ring_full,
        "lost_other": ledger.lost_other,
        "duplicates": ledger.duplicates,
        "unknown_after_disconnect": ledger.unknown_after_disconnect,
        "samples_announced": ledger.samples_announced,
        "samples_present": ledger.samples_present,
        "samples_occluded": ledger.samples_occluded,
        "contradictions": ledger.contradictions,
        "closes": ledger.closes(),
    })
}
