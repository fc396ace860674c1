//! A Parquet file written to anything that takes bytes, a row group at a time.

use std::{io::Write, sync::Arc};

use parquet::{
    basic::{Compression, ConvertedType, Encoding, LogicalType, Repetition, Type as Physical},
    data_type::{ByteArrayType, DataType},
    errors::ParquetError,
    file::{
        metadata::KeyValue,
        properties::WriterProperties,
        writer::{SerializedFileWriter, SerializedRowGroupWriter},
    },
    schema::types::{ColumnPath, Type},
};

use crate::{interchange::InterchangeError, motion::FrameSource};

/// What a column is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
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
pub(super) struct ParquetFile<'a> {
    file: SerializedFileWriter<Vec<u8>>,
    out: &'a mut dyn Write,
}

impl<'a> ParquetFile<'a> {
    /// With these columns; `layout` is said in the metadata.
    pub(super) fn new(
        frames: &dyn FrameSource,
        layout: &str,
        columns: &[(&str, Kind)],
        out: &'a mut dyn Write,
    ) -> Result<Self, InterchangeError> {
        let fields = columns.iter().map(|(name, kind)| field(name, *kind).map(Arc::new));
        let fields = fields.collect::<Result<_, _>>().map_err(failed)?;
        let schema = Type::group_type_builder("mocapd").with_fields(fields).build();
        let mut about = super::super::about::about(frames);
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
    pub(super) fn group(
        &mut self,
        fill: impl FnOnce(&mut Group<'_>) -> Result<(), ParquetError>,
    ) -> Result<(), InterchangeError> {
        {
            let mut group = Group(self.file.next_row_group().map_err(failed)?);
            fill(&mut group).map_err(failed)?;
            group.0.close().map_err(failed)?;
        }
        self.file.flush()?;
        self.pass_on()
    }

    /// The footer.
    pub(super) fn finish(mut self) -> Result<(), InterchangeError> {
        self.pass_on()?;
        let rest = self.file.into_inner().map_err(failed)?;
        self.out.write_all(&rest)?;
        Ok(self.out.flush()?)
    }

    /// The library counts what it wrote; where it lies then is no concern of its.
    fn pass_on(&mut self) -> Result<(), InterchangeError> {
        let written = self.file.inner_mut();
        self.out.write_all(written)?;
        written.clear();
        Ok(())
    }
}

/// A row group whose columns come one after another.
pub(super) struct Group<'a>(SerializedRowGroupWriter<'a, Vec<u8>>);

impl Group<'_> {
    /// The next column; `present` says which rows have a value, where some may not.
    pub(super) fn column<T: DataType>(
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

    /// The next column, of names.
    pub(super) fn text(
        &mut self,
        values: &[parquet::data_type::ByteArray],
    ) -> Result<(), ParquetError> {
        self.column::<ByteArrayType>(values, None)
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
