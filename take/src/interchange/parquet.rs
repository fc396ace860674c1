//! Parquet, written: a row a sample, or a row a frame.

use std::{io::Write, sync::Arc};

use parquet::{
    basic::{Compression, ConvertedType, Encoding, LogicalType, Repetition, Type as Physical},
    data_type::{ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int64Type},
    errors::ParquetError,
    file::{
        metadata::KeyValue,
        properties::WriterProperties,
        writer::{SerializedFileWriter, SerializedRowGroupWriter},
    },
    schema::types::{ColumnPath, Type},
};

use super::{InterchangeError, Result, about::about, text::column_labels};
use crate::motion::{FrameSource, GAP, Position, is_gap};

/// Rows of a group: 8 MB in memory.
const LONG_GROUP_ROWS: usize = 1 << 17;

const LONG_COLUMNS: [(&str, Kind); 6] = [
    ("frame", Kind::Int64),
    ("time_s", Kind::Double),
    ("marker", Kind::Text),
    ("x", Kind::Float { nullable: false }),
    ("y", Kind::Float { nullable: false }),
    ("z", Kind::Float { nullable: false }),
];

/// Rows that wait for their group to be full.
#[derive(Default)]
struct LongRows {
    frame: Vec<i64>,
    time_s: Vec<f64>,
    marker: Vec<ByteArray>,
    axes: [Vec<f32>; 3],
}

/// A row a sample: frame, time, marker, x, y, z. What is missing has no row.
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

/// Coordinates of a row group: 16 MB in memory.
const WIDE_GROUP_VALUES: usize = 1 << 22;

/// Most rows of a row group, of however few markers.
const WIDE_GROUP_ROWS_MAX: usize = 1 << 17;

/// A row a frame: frame, time, and three columns a marker, null where it has no sample.
pub(super) fn write_wide(frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<()> {
    let info = frames.info().clone();
    let names: Vec<String> = column_labels(&info)
        .iter()
        .flat_map(|label| ["x", "y", "z"].map(|axis| format!("{label}.{axis}")))
        .collect();
    let mut columns = vec![("frame", Kind::Int64), ("time_s", Kind::Double)];
    columns.extend(names.iter().map(|name| (name.as_str(), Kind::Float { nullable: true })));
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

/// What a column is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Frame numbers.
    Int64,
    /// Seconds.
    Double,
    /// Millimetres; empty where a sample is missing.
    Float { nullable: bool },
    /// Names, of which there are few.
    Text,
}

/// A file with one flat schema. What is written of it is in memory up to the end of its row group.
struct ParquetFile<'a> {
    file: SerializedFileWriter<Vec<u8>>,
    out: &'a mut dyn Write,
}

impl<'a> ParquetFile<'a> {
    /// With these columns; `layout` is said in the metadata.
    fn new(
        frames: &dyn FrameSource,
        layout: &str,
        columns: &[(&str, Kind)],
        out: &'a mut dyn Write,
    ) -> Result<Self> {
        let fields = columns.iter().map(|(name, kind)| field(name, *kind).map(Arc::new));
        let fields = fields.collect::<Result<_, _>>().map_err(failed)?;
        let schema = Type::group_type_builder("mocapd").with_fields(fields).build();
        let mut about = about(frames);
        about.push(("mocapd.layout".to_owned(), layout.to_owned()));
        about.push(("mocapd.units".to_owned(), "positions mm, time_s s".to_owned()));
        let about = about.into_iter().map(|(name, words)| KeyValue::new(name, words)).collect();
        let mut properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_dictionary_enabled(false)
            .set_created_by(concat!("mocapd version ", env!("CARGO_PKG_VERSION")).to_owned())
            .set_key_value_metadata(Some(about));
        for (name, kind) in columns {
            let column = ColumnPath::from(vec![(*name).to_owned()]);
            properties = match kind {
                Kind::Int64 => {
                    properties.set_column_encoding(column, Encoding::DELTA_BINARY_PACKED)
                }
                // Bytes of one weight together: of numbers that are near each other most are the same.
                Kind::Double | Kind::Float { .. } => {
                    properties.set_column_encoding(column, Encoding::BYTE_STREAM_SPLIT)
                }
                Kind::Text => properties.set_column_dictionary_enabled(column, true),
            };
        }
        let schema = Arc::new(schema.map_err(failed)?);
        let file = SerializedFileWriter::new(Vec::new(), schema, Arc::new(properties.build()));
        Ok(Self { file: file.map_err(failed)?, out })
    }

    /// A row group; `fill` writes every column of it in order.
    fn group(
        &mut self,
        fill: impl FnOnce(&mut Group<'_>) -> Result<(), ParquetError>,
    ) -> Result<()> {
        {
            let mut group = Group(self.file.next_row_group().map_err(failed)?);
            fill(&mut group).map_err(failed)?;
            group.0.close().map_err(failed)?;
        }
        self.file.flush()?;
        self.pass_on()
    }

    /// The footer.
    fn finish(mut self) -> Result<()> {
        self.pass_on()?;
        let rest = self.file.into_inner().map_err(failed)?;
        self.out.write_all(&rest)?;
        Ok(self.out.flush()?)
    }

    /// The library counts what it wrote; where it lies then is no concern of its.
    fn pass_on(&mut self) -> Result<()> {
        let written = self.file.inner_mut();
        self.out.write_all(written)?;
        written.clear();
        Ok(())
    }
}

/// A row group whose columns come one after another.
struct Group<'a>(SerializedRowGroupWriter<'a, Vec<u8>>);

impl Group<'_> {
    /// The next column; `present` says which rows have a value, where some may not.
    fn column<T: DataType>(
        &mut self,
        values: &[T::T],
        present: Option<&[i16]>,
    ) -> Result<(), ParquetError> {
        let Some(mut column) = self.0.next_column()? else {
            return Err(ParquetError::General("more columns than the schema has".to_owned()));
        };
        column.typed::<T>().write_batch(values, present, None)?;
        column.close()
    }
}

fn field(name: &str, kind: Kind) -> Result<Type, ParquetError> {
    let (physical, nullable) = match kind {
        Kind::Int64 => (Physical::INT64, false),
        Kind::Double => (Physical::DOUBLE, false),
        Kind::Float { nullable } => (Physical::FLOAT, nullable),
        Kind::Text => (Physical::BYTE_ARRAY, false),
    };
    let repetition = if nullable { Repetition::OPTIONAL } else { Repetition::REQUIRED };
    let builder = Type::primitive_type_builder(name, physical).with_repetition(repetition);
    match kind {
        Kind::Text => builder
            .with_logical_type(Some(LogicalType::String))
            .with_converted_type(ConvertedType::UTF8)
            .build(),
        _ => builder.build(),
    }
}

fn failed(error: ParquetError) -> InterchangeError {
    std::io::Error::other(error).into()
}
