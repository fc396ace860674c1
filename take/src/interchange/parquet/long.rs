//! A row a sample: frame, time, marker, x, y, z. What is missing has no row.

use std::io::Write;

use parquet::data_type::{ByteArray, DoubleType, FloatType, Int64Type};

use super::file::{Kind, ParquetFile};
use crate::{
    interchange::{InterchangeError, text::column_labels},
    motion::{FrameSource, GAP, is_gap},
};

/// Rows of a group: 8 MB in memory.
const GROUP_ROWS: usize = 1 << 17;

const COLUMNS: [(&str, Kind); 6] = [
    ("frame", Kind::Int64),
    ("time_s", Kind::Double),
    ("marker", Kind::Text),
    ("x", Kind::Float { nullable: false }),
    ("y", Kind::Float { nullable: false }),
    ("z", Kind::Float { nullable: false }),
];

/// Rows that wait for their group to be full.
#[derive(Default)]
struct Rows {
    frame: Vec<i64>,
    time_s: Vec<f64>,
    marker: Vec<ByteArray>,
    axes: [Vec<f32>; 3],
}

pub(crate) fn write(
    frames: &mut dyn FrameSource,
    out: &mut dyn Write,
) -> Result<(), InterchangeError> {
    let info = frames.info().clone();
    let names: Vec<ByteArray> =
        column_labels(&info).into_iter().map(|label| ByteArray::from(label.into_bytes())).collect();
    let mut file = ParquetFile::new(frames, "long", &COLUMNS, out)?;
    let mut rows = Rows::default();
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
            if rows.frame.len() == GROUP_ROWS {
                rows.flush(&mut file)?;
            }
        }
        index += 1;
    }
    rows.flush(&mut file)?;
    file.finish()
}

impl Rows {
    fn flush(&mut self, file: &mut ParquetFile<'_>) -> Result<(), InterchangeError> {
        if self.frame.is_empty() {
            return Ok(());
        }
        file.group(|group| {
            group.column::<Int64Type>(&self.frame, None)?;
            group.column::<DoubleType>(&self.time_s, None)?;
            group.text(&self.marker)?;
            self.axes.iter().try_for_each(|axis| group.column::<FloatType>(axis, None))
        })?;
        self.frame.clear();
        self.time_s.clear();
        self.marker.clear();
        self.axes.iter_mut().for_each(Vec::clear);
        Ok(())
    }
}
