//! Meshes with known joints: what of them is found, and what the constants are learned from.
//!
//! `MOCAPD_BODIES=FOLDER cargo run --release -p mocapd-body --example bodies` prints a row for each mesh below the
//! folder: the ends, the time and its ratio to one run of Dijkstra along edges. With `ratios` behind it, the means and
//! standard deviations of the ratios between ends of the two average shapes: what `extremity/naming.rs` holds. With
//! `paper`, how far the method of (Yu et al. 2008) comes as it is printed. A part of a path behind `ends` or `paper`
//! leaves all other meshes out.

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
