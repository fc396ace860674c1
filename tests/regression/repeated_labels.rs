//! Two markers with the same label can be chosen by the names that exports give them.

use crate::{cli::Folder, support::assert_mentions};

#[test]
fn the_second_of_two_is_plotted_by_its_exported_name() {
    let folder = Folder::new();
    let row = |i: i32| format!("{i},{},1,2,3,4,5,{i}\n", f64::from(i) / 100.0);
    let rows: String = (0..100).map(row).collect();
    folder.write("a.csv", format!("frame,time_s,K.x,K.y,K.z,K#2.x,K#2.y,K#2.z\n{rows}"));
    folder.run(&["import", "a.csv", "-o", "a.take"]).with_code(0);
    folder.run(&["export", "a.take", "-o", "b.csv"]).with_code(0);
    let header = folder.text("b.csv").lines().next().unwrap().to_owned();
    let second = header.split(',').nth(5).unwrap().trim_end_matches(".x").to_owned();
    let plot = |marker: &str, file: &str| {
        folder.run(&["plot", "trajectory", "a.take", "--marker", marker, "-o", file])
    };
    plot(&second, "second.svg").with_code(0);
    let refused = plot("K#3", "third.svg").with_code(2);
    assert_mentions(&refused.stderr, &["K#3", &second]);
}
