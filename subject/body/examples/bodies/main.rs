//! Meshes with known joints: what is found on them, and the statistics that constants are learned from.
//!
//! `MOCAPD_BODIES=FOLDER cargo run --release -p mocapd-body --features measure --example bodies` prints a row for each mesh below the
//! folder: the extremities, the time, and its ratio to one run of Dijkstra's algorithm along edges. The argument
//! `ratios` adds means and standard deviations of the ratios between extremities of the two average shapes, which are
//! the constants of `extremity/naming.rs`. The argument `paper` adds the results of the method of (Yu et al. 2008) as
//! printed. A part of a path, alone or after these, restricts the meshes.

mod paper;
mod ratios;
mod read;
mod score;
mod table;

use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let Ok(folder) = std::env::var("MOCAPD_BODIES") else {
        return Err(
            "MOCAPD_BODIES names no folder: set it to one of meshes with known joints".into()
        );
    };
    let meshes = read::all(Path::new(&folder))?;
    let mut out = std::io::stdout().lock();
    let filter = std::env::args().nth(2).unwrap_or_default();
    match std::env::args().nth(1).as_deref() {
        Some("ratios") => ratios::print(&meshes, &mut out),
        Some("paper") => paper::print(&meshes, &filter, &mut out),
        Some("ends") | None => table::print(&meshes, &filter, &mut out),
        Some(other) => Err(format!("{other}: ask for ends, ratios or paper").into()),
    }
}
