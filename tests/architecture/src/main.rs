//! Prints figures of the structure for each crate: `cargo run -p mocapd-architecture -- [--all] [CHECKOUT]`.
//!
//! With `--all` it also lists every function over a limit, and every cycle between files.

#![expect(clippy::print_stdout, reason = "a report on standard output")]

use std::{fs, io, path::PathBuf};

use mocapd_architecture::{cycles, product_sources, root, structure};

fn main() -> io::Result<()> {
    let arguments = std::env::args().skip(1);
    let (flags, folders): (Vec<_>, Vec<_>) = arguments.partition(|argument| argument == "--all");
    let lists_all = !flags.is_empty();
    let root = folders.first().map_or_else(root, PathBuf::from);
    let read =
        |path: PathBuf| Ok((path.display().to_string(), fs::read_to_string(root.join(path))?));
    let sources = product_sources(&root).into_iter().map(read).collect::<io::Result<Vec<_>>>()?;
    println!(
        "crate               files  under 60   code lines  over 80 lines  over 6 params   cycles"
    );
    let mut sum = [0; 6];
    for (name, figures) in structure::figures(&sources) {
        let found = cycles::cycles(&cycles::graph(&structure::files_of(&sources, &name)));
        let row = [
            figures.files,
            figures.small_files,
            figures.code_lines,
            figures.long_functions.len(),
            figures.wide_functions.len(),
            found.len(),
        ];
        print_row(&name, row);
        for (sum, value) in sum.iter_mut().zip(row) {
            *sum += value;
        }
        if lists_all {
            for line in figures.long_functions.iter().chain(&figures.wide_functions) {
                println!("    {line}");
            }
            for cycle in found {
                println!("    cycle of {}: {}", cycle.len(), cycle.join(" "));
            }
        }
    }
    print_row("sum", sum);
    Ok(())
}

fn print_row(name: &str, row: [usize; 6]) {
    let [files, small, lines, long, wide, cycles] = row;
    println!("{name:18}{files:7}{small:10}{lines:13}{long:15}{wide:15}{cycles:9}");
}
