//! The printed tables: compression ratios, the change against an earlier build, and the shares of the bits.

use std::{collections::BTreeMap, fmt::Write, path::Path};

use anyhow::{Context, ensure};

use mocapd_codec::training::Tally;

use super::takes::{Cell, TOLERANCES_MM};

fn geometric_mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0), |(sum, n), value| (sum + value.ln(), n + 1));
    (sum / f64::from(n.max(1))).exp()
}

/// The geometric mean of a value over all cells, then over the cells of each tolerance.
fn means(cells: &[Cell], value: impl Fn(&Cell) -> f64) -> Vec<f64> {
    let of = |mm: f64| cells.iter().filter(move |cell| cell.tolerance_mm == mm);
    let all = geometric_mean(cells.iter().map(&value));
    let by_tolerance = TOLERANCES_MM.map(|mm| geometric_mean(of(mm).map(&value)));
    std::iter::once(all).chain(by_tolerance).collect()
}

/// Compression ratios, float32 bytes over payload bytes; with `before`, also the change against the bytes that an
/// earlier build wrote to this file.
///
/// # Errors
/// When `before` cannot be read or lacks a cell.
pub(crate) fn ratios(cells: &[Cell], before: Option<&Path>) -> anyhow::Result<String> {
    let mut text = format!("{:24}     all", "");
    for mm in TOLERANCES_MM {
        write!(text, "{mm:>6} mm")?;
    }
    let ratio = |cell: &Cell| cell.samples as f64 * 12.0 / cell.bytes() as f64;
    write!(text, "\n{:24}", "ratio")?;
    for mean in means(cells, ratio) {
        write!(text, " {mean:8.3}")?;
    }
    if let Some(file) = before {
        let kept = std::fs::read_to_string(file)
            .with_context(|| format!("cannot read {}", file.display()))?;
        let kept: BTreeMap<_, f64> = kept
            .lines()
            .filter_map(|line| line.rsplit_once('\t'))
            .filter_map(|(cell, bytes)| Some((cell.to_owned(), bytes.parse().ok()?)))
            .collect();
        for cell in cells {
            let known = kept.contains_key(&name(cell));
            ensure!(known, "{} has no {} at {} mm", file.display(), cell.file, cell.tolerance_mm);
        }
        let change = |cell: &Cell| kept.get(&name(cell)).unwrap_or(&f64::NAN) / cell.bytes() as f64;
        write!(text, "\n{:24}", "against before, %")?;
        for mean in means(cells, change) {
            write!(text, " {:+8.2}", (mean - 1.0) * 100.0)?;
        }
    }
    text.push('\n');
    Ok(text)
}

fn name(cell: &Cell) -> String {
    format!("{}\t{}", cell.file, cell.tolerance_mm)
}

/// The payload bytes as text for `--keep`, which [`ratios`] reads again: one line per cell, the bytes last.
pub(crate) fn bytes(cells: &[Cell]) -> String {
    cells.iter().map(|cell| format!("{}\t{}\n", name(cell), cell.bytes())).collect()
}

/// Ideal code lengths: the percentage of each kind of decision in the bytes of a cell, as the mean over the cells of
/// each tolerance.
pub(crate) fn lengths(cells: &[Cell]) -> anyhow::Result<String> {
    let mut shares: BTreeMap<(&str, Option<&str>), [f64; TOLERANCES_MM.len()]> = BTreeMap::new();
    for (column, mm) in TOLERANCES_MM.into_iter().enumerate() {
        let cells: Vec<_> = cells.iter().filter(|cell| cell.tolerance_mm == mm).collect();
        for cell in &cells {
            for (what, kind, bits) in cell.tallies.iter().flat_map(Tally::lengths) {
                let share = bits / (cell.bytes() as f64 * 8.0) / cells.len() as f64;
                shares.entry((what, kind)).or_default()[column] += share;
            }
        }
    }
    let mut rows: Vec<_> = shares.into_iter().collect();
    rows.sort_by(|a, b| b.1.iter().sum::<f64>().total_cmp(&a.1.iter().sum()));
    let mut text = String::from("share of the bytes, %\n");
    for ((what, kind), shares) in rows {
        let label = kind.map_or_else(|| what.to_owned(), |kind| format!("{what}, {kind}"));
        write!(text, "{label:33}")?;
        for share in shares {
            write!(text, " {:8.1}", share * 100.0)?;
        }
        text.push('\n');
    }
    Ok(text)
}
