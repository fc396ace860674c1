//! Writes the seeds of the fuzz targets to `fuzz/corpus`, where `cargo fuzz` looks for them:
//! `cargo run -p mocapd-fuzz-targets --example seeds`.

use std::{fs, io, path::Path};

use mocapd_fuzz_targets::seeds::{Target, targets};

fn main() -> io::Result<()> {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus");
    for Target { name, seeds, .. } in targets() {
        let folder = corpus.join(name);
        fs::create_dir_all(&folder)?;
        for (i, seed) in seeds.iter().enumerate() {
            fs::write(folder.join(format!("seed-{i:03}")), seed)?;
        }
        println!("{}: {} seeds", folder.display(), seeds.len());
    }
    Ok(())
}
