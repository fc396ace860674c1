//! A row a frame: frame, time, and three columns a marker, null where it has no sample.

use std::io::Write;

use parquet::data_type::{DoubleType, FloatType, Int64Type};

use super::file::{Kind, ParquetFile};
use crate::{
    interchange::{InterchangeError, text::column_labels},
    motion::{FrameSource, GAP, Position, is_gap},
};

/// Coordinates of a row group: 16 MB in memory.
const GROUP_VALUES: usize = 1 << 22;

/// Most rows of a row group, of however few markers.
const GROUP_ROWS_MAX: usize = 1 << 17;

pub(crate) fn write(
    frames: &mut dyn FrameSource,
    out: &mut dyn Write,
) -> Result<(), InterchangeError> {
    let info = frames.info().clone();
    let names: Vec<String> = column_labels(&info)
        .iter()
        .flat_map(|label| ["x", "y", "z"].map(|axis| format!("{label}.{axis}")))
        .collect();
    let mut columns = vec![("frame", Kind::Int64), ("time_s", Kind::Double)];
    columns.extend(names.iter().map(|name| (name.as_str(), Kind::Float { nullable: true })));
    let mut file = ParquetFile::new(frames, "wide", &columns, out)?;
    let n_markers = info.markers.len();
    let group_rows = (GROUP_VALUES / (3 * n_markers).max(1)).clamp(1, GROUP_ROWS_MAX);
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
