//! In some formats lost frames look like occluded markers: `export` reports how many were lost.

use crate::{
    cli::Folder,
    support::{assert_mentions, config, dense, jump, record},
};

#[test]
fn an_export_says_how_many_frames_the_recording_lost() {
    let folder = Folder::new();
    let motion = jump(1, 60.0, 3.0);
    let config = config(&motion, dense(1.0));
    let lossy = (0..motion.n_frames()).filter(|seq| seq % 50 != 20);
    folder.write("lossy.take", record(&motion, &config, lossy).1);
    folder.write("whole.take", record(&motion, &config, 0..motion.n_frames()).1);
    let message = folder.run(&["export", "lossy.take", "-o", "lossy.c3d"]).with_code(0).stderr;
    assert_mentions(&message, &["lossy.take", "4 frames"]);
    assert_eq!(folder.run(&["export", "whole.take", "-o", "whole.c3d"]).with_code(0).stderr, "");
}
